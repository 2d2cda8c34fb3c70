"""Slip of an object that turns about the normal of the skin, from its turn alone: most objects' torque does not show in the gel.

From the rim inwards the skin is left behind. A contact of area A and radius a that bears the load N has the tangential stiffness
K = G (16/3 a + A/h) on a gel of thickness h and shear modulus G; by friction μ it slides along the skin at μ N/K, and a part of
1/(1 + (a θ K/(0.8 μ N))^1.5) of its area still sticks after a turn by θ. The two constants were chosen on a simulated key, gear
and cross. The middle of a contact always sticks, so that
a turn alone is never gross slip.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr

from ninedtact.design import Gel
from ninedtact.tracking.sliding_springs import FRICTION_PRIOR, FRICTION_PRIOR_WIDTH, KNOWN_FRICTION_WIDTH

_SEEN_STD_RAD = 0.05
"""Standard deviation of a turn up to which it is seen."""
_HALF_STICKS, _EXPONENT = 0.8, 1.5
_MOST_TURNS = 8.0
"""Turn beyond that at which half of the area sticks up to which a turn is counted: then next to nothing sticks, and a turn back
begins to stick at once."""


@dataclass
class TurningSlip:
    """Follows the part of an object's turn that twists the skin; give it every image of a contact in turn."""

    gel: Gel = field(default_factory=Gel)
    """Its modulus and thickness are those of the published design: friction is known far less."""
    _yaw_rad: float | None = field(default=None, init=False)
    _skin_rad: float = field(default=0.0, init=False)

    def release(self) -> None:
        """Forget the contact."""
        self._yaw_rad, self._skin_rad = None, 0.0

    def update(self, yaw_rad: float, yaw_std_rad: float, area_mm2: float, normal_n: float, friction: float) -> float:
        """Return the share of the contact that sticks at the likeliest friction, NaN where the turn is not seen.

        yaw_rad: turn of the object since its path began. friction: coefficient; not a number where it is not known.
        """
        if not yaw_std_rad < _SEEN_STD_RAD or not normal_n > 0 or not area_mm2 > 0:
            self._yaw_rad = None
            return float("nan")
        step, self._yaw_rad = 0.0 if self._yaw_rad is None else yaw_rad - self._yaw_rad, yaw_rad
        radius_mm = float(np.sqrt(area_mm2 / np.pi))
        stiffness = self.gel.shear_modulus_mpa * (16 / 3 * radius_mm + area_mm2 / self.gel.thickness_mm)
        coefficient = friction if np.isfinite(friction) else FRICTION_PRIOR
        half_rad = _HALF_STICKS * coefficient * normal_n / (stiffness * radius_mm)
        most_rad = _MOST_TURNS * half_rad
        self._skin_rad = float(np.clip(self._skin_rad + step, -most_rad, most_rad))
        return 1 / (1 + (abs(self._skin_rad) / half_rad) ** _EXPONENT)


def probability_below(share: float, limit: float, is_friction_known: bool) -> float:
    """Return the probability that less than a limit sticks, given the share at the likeliest friction."""
    width = KNOWN_FRICTION_WIDTH if is_friction_known else FRICTION_PRIOR_WIDTH
    odds = [np.log((1 - part) / part) / _EXPONENT for part in (min(max(share, 1e-6), 1 - 1e-6), limit)]
    return float(ndtr((odds[0] - odds[1]) / width))

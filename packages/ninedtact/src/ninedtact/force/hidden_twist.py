"""The torque about z of a twist that no image shows, which every estimator states in its error of T_z.

A shear field that turns about z raises no gel in a linear layer, so that images before and after a twist are alike. What is
estimated of T_z is the moment of the force, and what the shape of a contact that is not round reveals. The rest depends on the
force, the friction and the size of the contact; its share was found on simulated presses.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.reading import Reading

_ANY_CONTACT = 0.08
"""Hidden torque of any contact, over the force times the radius of gyration."""
_ROUND_CONTACT = 0.3
"""The same of a round contact, added in squares: the skin around it rises the same whichever way the object is twisted. The torque
of a ball that is twisted by 10° is 0.3 to 0.6."""


@dataclass(frozen=True)
class PressureRmsRadii:
    """The extent of a contact: root mean square distances of its pressure from the centre."""

    short_mm: float
    """Along the short axis."""
    long_mm: float
    """Along the long axis."""

    @property
    def radius_of_gyration_mm(self) -> float:
        """Return the radius of gyration about either axis, the root mean square of both."""
        return float(np.sqrt((self.short_mm**2 + self.long_mm**2) / 2))

    @property
    def roundness(self) -> float:
        """Return the squared ratio of the short to the long axis: 1 for a round contact, 0 for a line."""
        return (self.short_mm / self.long_mm) ** 2 if self.long_mm > 0 else 0.0

    def hidden_torque_nm(self, force_n: float) -> float:
        """Return one standard deviation of the hidden torque about z, in N·m, under this normal force."""
        return float(hidden_torque_share(self.roundness) * abs(force_n) * self.radius_of_gyration_mm / 1e3)


def hidden_torque_share(roundness: Any) -> Any:
    """Return the hidden torque over the force times the radius of gyration, for one contact or an array of contacts."""
    return (_ANY_CONTACT**2 + (_ROUND_CONTACT * roundness) ** 2) ** 0.5


def pressure_rms_radii(
    weight: Float[Array, "rows cols"], x_mm: Float[Array, "..."], y_mm: Float[Array, "..."]
) -> PressureRmsRadii:
    """Return the extent of a contact from its pressure, or from its indentation where the pressure is not known; 0 without one.

    x_mm, y_mm: coordinates that broadcast to the shape of the weight.
    """
    total = float(weight.sum())
    if total <= 0:
        return PressureRmsRadii(0.0, 0.0)
    x, y = (mm - float((weight * mm).sum()) / total for mm in (x_mm, y_mm))
    across = float((weight * x * y).sum()) / total
    moments = np.array(
        [[float((weight * x * x).sum()) / total, across], [across, float((weight * y * y).sum()) / total]]
    )
    short, long = np.sqrt(np.maximum(np.linalg.eigvalsh(moments), 0.0)).tolist()
    return PressureRmsRadii(short, long)


def hidden_torque_nm(reading: Reading, force_n: float) -> float:
    """Return one standard deviation of the torque about z, in N·m, that the image of a contact under this normal force hides."""
    x_mm, y_mm = reading.height.axes_mm
    pressed_mm = np.where(reading.contact, reading.height.indentation_mm, 0)
    return pressure_rms_radii(pressed_mm, x_mm[None, :], y_mm[:, None]).hidden_torque_nm(force_n)

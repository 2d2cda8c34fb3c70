"""What a member is made of besides gel, light and lens."""

from dataclasses import dataclass

import numpy as np

from ninedtact.errors import NinedtactError
from ninedtact.simulation.population.mechanics import Kind
from ninedtact.simulation.population.spread import within_reach


class PopulationImpossible(NinedtactError):
    """Members that cannot be drawn."""


@dataclass(frozen=True)
class Kinds:
    """The part of all members whose mechanics are not the gel on a rigid base that estimators assume."""

    compliant_base: float = 0.2
    finite_strain: float = 0.3

    def __post_init__(self) -> None:
        if not (min(self.compliant_base, self.finite_strain) >= 0 and self.compliant_base + self.finite_strain <= 1):
            raise PopulationImpossible(
                f"expected shares of members from 0 to 1, together at most 1, got {self.compliant_base} on a compliant base "
                f"and {self.finite_strain} with finite strain; correct them"
            )

    def at(self, part: float) -> Kind:
        """The kind at this part of the unit."""
        if part < self.compliant_base:
            return "compliant_base"
        return "finite_strain" if part < self.compliant_base + self.finite_strain else "bonded"


@dataclass(frozen=True)
class Untouched:
    """What the untouched image is made from; see `untouched_image`."""

    mean_grey: float
    unevenness: float
    cast: tuple[float, float, float]
    seed: int


@dataclass(frozen=True)
class Misreading:
    """The error of this sensor's board calibration: how the rectified grid lies on the skin."""

    scale: float = 1.0
    """True mm per mm of the grid."""
    turn_rad: float = 0.0
    offset_mm: tuple[float, float] = (0.0, 0.0)


def drawn_untouched(rng: np.random.Generator) -> Untouched:
    """Mean grey of nine real sensors; white LEDs with a slight cast."""
    red, blue = (0.02 * within_reach(rng, 2)).tolist()
    grey, unevenness = rng.uniform(135, 162), rng.uniform(0.01, 0.03)
    return Untouched(float(grey), float(unevenness), (1 + blue, 1.0, 1 + red), int(rng.integers(2**31)))


def drawn_misreading(rng: np.random.Generator) -> Misreading:
    """Of a board that was found to a few hundredths of a millimetre."""
    scale, turn, x, y = (within_reach(rng, 4) * (0.005, 0.005, 0.1, 0.1)).tolist()
    return Misreading(1 + scale, turn, (x, y))

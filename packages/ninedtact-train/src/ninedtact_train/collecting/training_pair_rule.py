"""The sampling rule of the paper: which wrenches of a contact are kept as training pairs.

A contact begins when F_z falls below `contact_below_n`. Its first pair is kept below a load that is sampled for each contact;
after that, each pair is kept whose wrench is far from every wrench kept in the same contact. Far means that the differences,
each as a fraction of the range of its axis, sum to more than a quarter (docs/references.md; the original code
writes Σ s|Δ| > 12 with s = 12/(range/4)).
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from jaxtyping import Float64
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import require_within_bounds
from ninedtact.errors import InputError
from ninedtact.quantities import Wrench

SixFloats = tuple[float, float, float, float, float, float]
PAPER_RANGES: SixFloats = (6.0, 6.0, 12.0, 0.4, 0.4, 0.1)
"""Width of the range of each axis of the wrenches that the paper collected, N and N·m."""
_NegativeN = Annotated[float, Meta(ge=-1e3, lt=0)]
_Range = Annotated[float, Meta(gt=0, le=1e6)]
_Weight = Annotated[float, Meta(ge=0, le=1e6)]


def wrench_limits(ranges: SixFloats = PAPER_RANGES) -> Float64[Array, "2 6"]:
    """Return the lowest and the highest wrench of ranges of this width: symmetric about zero, F_z from zero inwards."""
    widths = np.array(ranges)
    low = -widths / 2
    low[2] = -widths[2]
    return np.array([low, low + widths])


@dataclass(frozen=True)
class SamplingRuleSettings:
    """The parameters of the rule; the defaults are those of the paper. Raises `InputError`."""

    contact_below_n: _NegativeN = -0.3
    """F_z below which a contact begins for the sampling rule."""
    first_below_n: tuple[_NegativeN, _NegativeN] = (-3.3, -0.3)
    """The first pair of a contact is saved below a random F_z between these."""
    ranges: tuple[_Range, _Range, _Range, _Range, _Range, _Range] = PAPER_RANGES
    """Width of the range of each axis, N and N·m."""
    weights: tuple[_Weight, _Weight, _Weight, _Weight, _Weight, _Weight] = (1.0, 1.0, 1.0, 0.0, 0.0, 1.0)
    """Weight of each axis when two wrenches are compared."""
    min_difference: Annotated[float, Meta(gt=0, le=1e3)] = 0.25
    """Smallest difference between saved wrenches: the weighted sum of the differences as fractions of the ranges."""

    def __post_init__(self) -> None:
        require_within_bounds(self)
        if self.first_below_n[0] > self.first_below_n[1] or not any(self.weights):
            raise InputError(
                expected="first pairs between two forces in rising order, and an axis that counts",
                got=f"{self.first_below_n} and weights {self.weights}",
                remedy="correct them",
            )


@dataclass(frozen=True)
class PairKindShares:
    """The shares of pairs without contact and with a light touch, which the paper's sampling rule would not collect."""

    no_contact: Annotated[float, Meta(ge=0)] = 0.03
    """Share of pairs in which nothing touches and the wrench is zero."""
    light_touch: Annotated[float, Meta(ge=0)] = 0.05
    """Share of pairs whose load is below that of a light touch."""

    def __post_init__(self) -> None:
        require_within_bounds(self, "shares")
        if self.no_contact + self.light_touch > 1:
            raise InputError(
                expected="shares that are together at most 1",
                got=f"{self.no_contact} without contact and {self.light_touch} touching lightly",
                remedy="correct them",
            )


@dataclass
class SamplingRule:
    """The rule applied to a sequence of wrenches; it remembers the wrenches that it kept in the current contact.

    rule = SamplingRule(rng=np.random.default_rng(0))
    kept = [wrench for wrench in wrenches if rule.keeps(wrench)]
    """

    settings: SamplingRuleSettings = SamplingRuleSettings()
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    kept_wrenches: list[Float64[Array, "6"]] = field(default_factory=list, init=False)
    """Wrenches kept in the current contact."""
    contact_count: int = field(default=0, init=False)
    """Contacts that have begun so far."""
    touching: bool = field(default=False, init=False)
    first_below_n: float = field(default=0.0, init=False)

    def keeps(self, wrench: Wrench) -> bool:
        """Return whether to keep this wrench; its torque may be about any point of the sensor's axis."""
        touching = bool(wrench.force_n[2] < self.settings.contact_below_n)
        if touching and not self.touching:
            self.kept_wrenches.clear()
            self.contact_count += 1
            self.first_below_n = float(self.rng.uniform(*self.settings.first_below_n))
        self.touching = touching
        if not touching or not self._is_new(wrench):
            return False
        self.kept_wrenches.append(wrench.six)
        return True

    def end_contact(self) -> None:
        """End the current contact: the object left the skin, even if no wrench has shown it."""
        self.touching = False

    def _is_new(self, wrench: Wrench) -> bool:
        """Return whether the wrench is far enough from all that were kept in this contact."""
        if not self.kept_wrenches:
            return bool(wrench.force_n[2] < self.first_below_n)
        fractions = np.abs(np.array(self.kept_wrenches) - wrench.six) / np.array(self.settings.ranges)
        return bool((fractions @ np.array(self.settings.weights)).min() > self.settings.min_difference)

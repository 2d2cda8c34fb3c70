"""Which moments of a contact are worth keeping: the rule by which the paper's pairs were collected.

A contact begins when it presses harder than `contact_below_n`. Its first pair is kept below a load drawn anew for each
contact; after that, each whose wrench is far from every wrench kept in the same contact. Far: the differences, each as a
part of its axis's range, together exceed a quarter (docs/references.md; the original
code writes Σ s|Δ| > 12 with s = 12/(range/4)).
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.quantities import Wrench

SixFloats = tuple[float, float, float, float, float, float]


class SamplingRuleInvalid(NinedtactError):
    """A rule that keeps nothing, or everything."""


@dataclass(frozen=True)
class SamplingRuleSettings:
    """The paper's numbers."""

    contact_below_n: float = -0.3
    """F_z below which something touches."""
    first_below_n: tuple[float, float] = (-3.3, -0.3)
    """F_z of the first pair of a contact: below a random number between these."""
    ranges: SixFloats = (6.0, 6.0, 12.0, 0.4, 0.4, 0.1)
    """Width of each axis's range, N and N·m."""
    weights: SixFloats = (1.0, 1.0, 1.0, 0.0, 0.0, 1.0)
    apart: float = 0.25
    """Part of the ranges by which kept wrenches differ at least."""

    def __post_init__(self) -> None:
        if not (self.contact_below_n < 0 < self.apart and self.first_below_n[0] <= self.first_below_n[1] < 0):
            raise SamplingRuleInvalid(
                f"expected a contact below zero newtons, first pairs between two such forces in rising order, and a "
                f"difference above zero, got {self.contact_below_n}, {self.first_below_n} and {self.apart}; correct them"
            )
        if not (min(self.ranges) > 0 and min(self.weights) >= 0 < max(self.weights)):
            raise SamplingRuleInvalid(
                f"expected six ranges above zero and six weights of zero or more, not all zero, got {self.ranges} and "
                f"{self.weights}; correct them"
            )


@dataclass
class SamplingRule:
    """The rule at work: asked about every wrench in turn, it remembers what it kept."""

    settings: SamplingRuleSettings = SamplingRuleSettings()
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    kept: list[Float64[Array, "6"]] = field(default_factory=list, init=False)
    """Of this contact."""
    contacts: int = field(default=0, init=False)
    """Begun so far."""
    touching: bool = field(default=False, init=False)
    first_below_n: float = field(default=0.0, init=False)

    def keeps(self, wrench: Wrench) -> bool:
        """Whether this one is worth keeping; its torque about any point of the sensor's axis."""
        touching = bool(wrench.force_n[2] < self.settings.contact_below_n)
        if touching and not self.touching:
            self.begin()
        self.touching = touching
        if not touching or not self.is_new(wrench):
            return False
        self.kept.append(wrench.six)
        return True

    def lifted(self) -> None:
        """The object left the skin, whether or not a wrench has told."""
        self.touching = False

    def begin(self) -> None:
        """A new contact: nothing of it is kept yet."""
        self.kept.clear()
        self.contacts += 1
        self.first_below_n = float(self.rng.uniform(*self.settings.first_below_n))

    def is_new(self, wrench: Wrench) -> bool:
        """Whether it is far enough from all that were kept."""
        if not self.kept:
            return bool(wrench.force_n[2] < self.first_below_n)
        parts = np.abs(np.array(self.kept) - wrench.six) / np.array(self.settings.ranges)
        return bool((parts @ np.array(self.settings.weights)).min() > self.settings.apart)

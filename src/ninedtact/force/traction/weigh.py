"""How much each cell of the image is believed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

View = Float32[Array, "rows cols"]


@dataclass(frozen=True)
class Weigh:
    """Independent errors of the cells, and one of the level that they share."""

    per_error: View
    """One over the standard deviation of every cell; zero where nothing is seen."""
    level: float
    """Standard deviation of the common level."""

    def __call__(self, rest: View) -> View:
        """The inverse covariance times a field."""
        return self.whitened(rest) * self.per_error

    def whitened(self, rest: View) -> View:
        """A field over its errors, what is common to all cells taken off as far as its error allows."""
        weighed = rest * self.per_error
        common = self.level * self.per_error
        weighed -= common * (float(np.vdot(common, weighed)) * self.kept)
        return weighed

    @cached_property
    def kept(self) -> float:
        """One over one plus how much better than its prior the level is seen."""
        return 1 / (1 + self.level**2 * float(np.vdot(self.per_error, self.per_error)))

    def gram(self, columns: Float32[Array, "n seen"]) -> Float32[Array, "n n"]:
        """Products of fields that are divided by their errors already."""
        common = columns @ (self.level * self.per_error.ravel())
        gram = columns @ columns.T
        gram -= np.outer(common, common) * np.float32(self.kept)
        return gram

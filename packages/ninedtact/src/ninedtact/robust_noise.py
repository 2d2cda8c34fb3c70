"""The standard deviation of Gaussian noise by medians, which few large deviations (edges, contacts, outliers) hardly change
(Rousseeuw & Croux 1993, docs/references.md)."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

STD_PER_MEDIAN = 1.4826
"""Standard deviation of Gaussian noise over the median of its magnitude."""


def robust_std(deviations: Float[Array, "..."], axis: int | None = None) -> Float[Array, "..."]:
    """Return the standard deviation of deviations from zero, along an axis or of all."""
    return np.asarray(STD_PER_MEDIAN * np.median(np.abs(deviations), axis=axis))


def noise_by_second_differences(values: Float[Array, "..."], axis: int) -> float:
    """Return the standard deviation of the noise of one value, by second differences along an axis, to which what changes smoothly
    does not contribute; zero for fewer than three values.

    The variance of the second difference of independent values is six times theirs.
    """
    if values.shape[axis] < 3:
        return 0.0
    return float(robust_std(np.diff(values, n=2, axis=axis)) / np.sqrt(6))

"""Errors that cover what they claim, as images of held-out sensors and objects show.

A network's own scale b knows which images are hard, but not how large errors are where it was not trained. What is told is
gain · b^power, both by axis: the power so that errors over it are distributed like Laplace's, their 90 % quantile ln 10 / ln 2
times the median; the gain so that the quantiles are right themselves.
"""

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

SHARES = (0.5, 0.9)
LAPLACE = -np.log1p(-np.array(SHARES))
"""|error| / scale below which these shares of a Laplace distribution lie."""
POWERS = np.linspace(0.5, 1.3, 33)
FEWEST = 20
"""Images that quantiles need."""

Six = Float64[Array, "6"]


def gain_and_power(off: Float64[Array, "n 6"], scale: Float64[Array, "n 6"]) -> tuple[Six, Six]:
    """From absolute errors and untouched scales, both in units of the labels."""
    if len(off) < FEWEST:
        return np.ones(6), np.ones(6)
    both = np.array([best(off[:, axis], scale[:, axis]) for axis in range(off.shape[1])])
    return both[:, 0], both[:, 1]


def best(off: Float64[Array, " n"], scale: Float64[Array, " n"]) -> tuple[float, float]:
    """Gain and power of one axis; where several powers do as well, the nearest to one."""
    misses = [np.log(quantiles(off, scale, power) / LAPLACE) for power in POWERS]
    wrong = [abs(miss[1] - miss[0]) + 0.01 * abs(power - 1) for miss, power in zip(misses, POWERS, strict=True)]
    chosen = int(np.argmin(wrong))
    return float(np.exp(misses[chosen].mean())), float(POWERS[chosen])


def quantiles(off: Float64[Array, " n"], scale: Float64[Array, " n"], power: float) -> Float64[Array, "2"]:
    """Of errors over scales."""
    return np.maximum(np.quantile(off / scale**power, SHARES), 1e-12)

"""Pairs of darkening and depth → a curve that rises, has no gaps and starts at zero."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import isotonic_regression

from ninedtact.shape.depth import DepthCurve, Signal

LEVEL: dict[Signal, float] = {"difference": 1.0, "ratio": 1 / 160}
"""Width of one entry of the list: a grey level, and what a grey level is in an image of usual brightness."""
FIRST_LEVEL = 4
"""Below this the curve is a straight line from zero: the edge of the disc is blurred, so its own first levels would
turn one grey level of drifting light into a tenth of a millimetre."""


def monotone_curve(signal: Signal, darkening: Float[Array, " n"], depth_mm: Float[Array, " n"]) -> DepthCurve:
    """Mean depth of every level of darkening, made monotone by isotonic regression (weights: pixels per level).

    Levels that no pixel has are interpolated; brightening pixels near the edge count as level zero.
    """
    level = np.maximum(np.round(darkening / LEVEL[signal]), 0).astype(int)
    count = np.bincount(level)
    known = np.flatnonzero(count)
    known = known[known >= min(FIRST_LEVEL, known[-1])]
    mean = np.bincount(level, depth_mm)[known] / count[known]
    spread = np.sqrt(np.maximum(np.bincount(level, depth_mm**2)[known] / count[known] - mean**2, 0))
    rising = np.asarray(isotonic_regression(mean, weights=count[known]).x)
    return anchored(signal, known * LEVEL[signal], rising, spread)


def anchored(
    signal: Signal, darkening: Float[Array, " k"], depth_mm: Float[Array, " k"], error_mm: Float[Array, " k"]
) -> DepthCurve:
    """No darkening is no depth."""
    above = darkening > 0
    return DepthCurve(
        signal,
        (0.0, *darkening[above].tolist()),
        (0.0, *depth_mm[above].tolist()),
        (float(error_mm[0]), *error_mm[above].tolist()),
    )

"""How often the truth lies where the predictions' own errors say that it should."""

from dataclasses import dataclass

import numpy as np

from ninedtact.force.evaluation.predictions import Predictions, Six

SHARES = (0.5, 0.9)


@dataclass(frozen=True)
class IntervalCoverage:
    """Of the intervals that should hold the truth in `share` of all pairs."""

    share: float
    covered: Six
    """Part of the pairs whose truth they hold; NaN for an axis without errors."""


def coverage(predictions: Predictions, shares: tuple[float, ...] = SHARES) -> tuple[IntervalCoverage, ...]:
    """For each share; nothing where no errors are claimed."""
    if predictions.error is None:
        return ()
    return tuple(IntervalCoverage(share, covered(predictions, share)) for share in shares)


def covered(predictions: Predictions, share: float) -> Six:
    """Part of the pairs whose truth is inside the middle interval of this share.

    Where nothing touches and exactly nothing is predicted, the answer is right by design: such pairs would only flatter.
    """
    assert predictions.error is not None
    counts = predictions.truth.any(1) | predictions.predicted.any(1)
    if not counts.any():
        return np.full(6, np.nan)
    half_width = predictions.distribution.half_width(share) * predictions.error[counts]
    inside = (np.abs(predictions.off[counts]) <= half_width).mean(0)
    return np.where(np.isnan(half_width).any(0), np.nan, inside)

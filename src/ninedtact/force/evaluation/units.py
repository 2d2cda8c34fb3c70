"""Predictions that look as if they were not in N and N·m about a point near the skin."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.force.evaluation.predictions import FORCES, TORQUES, Predictions, PredictionsUnusable, Wrenches

LARGEST_N = 200.0
"""The sensor is used to 12 N."""
LONGEST_ARM_M = 0.3
"""Torque per force; the paper's arm is 0.035 m."""
SMALLEST_N = 0.02
MOST = 95
"""Percentile that stands for the size of a column: a few outliers are no wrong unit."""
UNIT_LOW = -1.0
"""Forces reach below this where predictions between 0 and 1 cannot be in N."""


def require_units(predictions: Predictions) -> None:
    """Raise `PredictionsUnusable` with the first suspicion."""
    for suspicion in suspicions(predictions):
        raise PredictionsUnusable(
            f"expected forces in N and torques in N·m, got {suspicion}, or pass --trust-units if they are right"
        )


def suspicions(predictions: Predictions) -> Iterator[str]:
    """What looks wrong, and what to do about it."""
    true, predicted = predictions.truth, predictions.predicted
    if is_normalised(predicted) and true[:, 2].min() < UNIT_LOW:
        yield (
            "predictions that all lie between 0 and 1, as the original's network gives them; turn them back into "
            "min + p · (max \N{MINUS SIGN} min) with the ranges that it was trained with"
        )
    for name, six in (("true", true), ("predicted", predicted)):
        force_n, torque_nm = size(six[:, FORCES]), size(six[:, TORQUES])
        if force_n > LARGEST_N:
            yield f"{name} forces of {force_n:.0f}, as of mN or gram-force; convert them"
        elif force_n and torque_nm > LONGEST_ARM_M * max(force_n, SMALLEST_N):
            yield (
                f"{name} torques {torque_nm / force_n:.2g} m times the forces, as of N·mm or of forces that are scaled; "
                "convert them"
            )


def is_normalised(six: Wrenches) -> bool:
    """Every number between 0 and 1, and not merely small."""
    return bool(six.min() >= 0 and six.max() <= 1 and six.max() > 0)


def size(vectors: Float64[Array, "n 3"]) -> float:
    """How long nearly all of them are at most."""
    return float(np.percentile(np.linalg.norm(vectors, axis=1), MOST))

"""Six numbers for each question about the errors of all pairs."""

from dataclasses import dataclass

import numpy as np

from ninedtact.force.evaluation.predictions import FORCES, TORQUES, Predictions, Six


@dataclass(frozen=True)
class Scores:
    """By axis, N and N·m where they have a unit; NaN where the truth does not vary and a question has no answer."""

    mae: Six
    """Mean absolute error."""
    std: Six
    """Standard deviation of the absolute error, as the paper has it."""
    rmse: Six
    bias: Six
    """Mean of predicted minus true."""
    median_mae: Six
    """Mean absolute error of always answering the median of these truths."""
    skill: Six
    """1 − mae / median_mae: 0 is no better than that answer, 1 is perfect. Compares fairly across ranges of force."""
    r2: Six
    """1 − squared errors / squared deviations of the truth from its mean."""
    slope: Six
    """Least squares of predicted = slope · true, through the origin: below 1, forces are read too small."""
    slope_with_offset: Six
    """Least squares of predicted = slope · true + offset: also lowered by answers that keep near the mean."""


@dataclass(frozen=True)
class Means:
    """Over the three forces and over the three torques, as the paper averages."""

    force_n: float
    torque_nm: float


def scores(predictions: Predictions) -> Scores:
    """All of them."""
    true, predicted, off = predictions.truth, predictions.predicted, predictions.off
    spread, follows = true - true.mean(0), predicted - predicted.mean(0)
    mae, median_mae = np.abs(off).mean(0), np.abs(true - np.median(true, axis=0)).mean(0)
    return Scores(
        mae=mae,
        std=np.abs(off).std(0),
        rmse=np.sqrt((off**2).mean(0)),
        bias=off.mean(0),
        median_mae=median_mae,
        skill=1 - ratio(mae, median_mae),
        r2=1 - ratio((off**2).sum(0), (spread**2).sum(0)),
        slope=ratio((true * predicted).sum(0), (true**2).sum(0)),
        slope_with_offset=ratio((spread * follows).sum(0), (spread**2).sum(0)),
    )


def means(six: Six) -> Means:
    """Of the forces and of the torques."""
    return Means(float(six[FORCES].mean()), float(six[TORQUES].mean()))


def ratio(above: Six, below: Six) -> Six:
    """NaN over zero."""
    return np.divide(above, below, out=np.full(6, np.nan), where=below > 0)

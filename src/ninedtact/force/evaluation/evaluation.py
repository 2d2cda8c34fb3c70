"""Six numbers for each question about the errors of all pairs.

The same errors by load, by object and by sensor, and where nothing touches.

How often the truth lies where the predictions' own errors say that it should.

Predictions → everything that is asked of them.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from ninedtact.force.evaluation.predictions import AXES, FORCES, TORQUES, UNITS, Six, WrenchPredictions
from ninedtact.force.evaluation.published_results import published_scores_about
from ninedtact.force.splits import NOTHING


@dataclass(frozen=True)
class AxisScores:
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
class ForceTorqueMeans:
    """Over the three forces and over the three torques, as the paper averages."""

    force_n: float
    torque_nm: float


def _axis_scores(predictions: WrenchPredictions) -> AxisScores:
    """All of them."""
    true, predicted, off = predictions.truth, predictions.predicted, predictions.off
    spread, follows = true - true.mean(0), predicted - predicted.mean(0)
    mae, median_mae = np.abs(off).mean(0), np.abs(true - np.median(true, axis=0)).mean(0)
    return AxisScores(
        mae=mae,
        std=np.abs(off).std(0),
        rmse=np.sqrt((off**2).mean(0)),
        bias=off.mean(0),
        median_mae=median_mae,
        skill=1 - _ratio(mae, median_mae),
        r2=1 - _ratio((off**2).sum(0), (spread**2).sum(0)),
        slope=_ratio((true * predicted).sum(0), (true**2).sum(0)),
        slope_with_offset=_ratio((spread * follows).sum(0), (spread**2).sum(0)),
    )


def force_torque_means(six: Six) -> ForceTorqueMeans:
    """Of the forces and of the torques."""
    return ForceTorqueMeans(float(six[FORCES].mean()), float(six[TORQUES].mean()))


def _ratio(above: Six, below: Six) -> Six:
    """NaN over zero."""
    return np.divide(above, below, out=np.full(6, np.nan), where=below > 0)


LOADS_N = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, np.inf)
"""Ends of the bins of |F_z|."""


@dataclass(frozen=True)
class GroupScores:
    """Some of the pairs."""

    name: str
    pairs: int
    mae: Six
    bias: Six


@dataclass(frozen=True)
class NoContactScores:
    """Pairs whose true wrench is zero on all axes: every force found there is made up."""

    pairs: int
    mean_force_n: float
    """Of the length of the predicted force."""
    largest_force_n: float


def _scores_by_load(predictions: WrenchPredictions) -> Iterator[GroupScores]:
    """Bins of the true |F_z| that hold any pairs; where nothing touches is none of them."""
    load_n, touched = np.abs(predictions.truth[:, 2]), predictions.truth.any(axis=1)
    for low, high in pairwise(LOADS_N):
        inside = (load_n >= low) & (load_n < high) & touched
        if inside.any():
            yield _group_scores(predictions, _load_bin_name(low, high), inside)


def _load_bin_name(low_n: float, high_n: float) -> str:
    """In words."""
    if low_n == 0:
        return f"below {high_n:g} N"
    return f"from {low_n:g} N" if np.isinf(high_n) else f"{low_n:g}–{high_n:g} N"


def _scores_by_name(predictions: WrenchPredictions, names: Sequence[str] | None) -> Iterator[GroupScores]:
    """One part for each name; none where names are not known."""
    if names is None:
        return
    different, number = np.unique(np.asarray(names, dtype=str), return_inverse=True)
    order = np.argsort(number, kind="stable")
    for name, rows in zip(different, np.split(order, np.cumsum(np.bincount(number))[:-1]), strict=True):
        off = predictions.off[rows]
        yield GroupScores(str(name), len(rows), np.abs(off).mean(0), off.mean(0))


def _group_scores(predictions: WrenchPredictions, name: str, inside: Bool[Array, " n"]) -> GroupScores:
    """The errors of some pairs."""
    off = predictions.off[inside]
    return GroupScores(name, len(off), np.abs(off).mean(0), off.mean(0))


def _no_contact_scores(predictions: WrenchPredictions) -> NoContactScores | None:
    """What is predicted where nothing touches; None where there are no such pairs."""
    nothing = ~predictions.truth.any(axis=1)
    if not nothing.any():
        return None
    force_n = np.linalg.norm(predictions.predicted[nothing, FORCES], axis=1)
    return NoContactScores(int(nothing.sum()), float(force_n.mean()), float(force_n.max()))


SHARES = (0.5, 0.9)


@dataclass(frozen=True)
class IntervalCoverage:
    """Of the intervals that should hold the truth in `share` of all pairs."""

    share: float
    covered: Six
    """Part of the pairs whose truth they hold; NaN for an axis without errors."""


def _interval_coverage(
    predictions: WrenchPredictions, shares: tuple[float, ...] = SHARES
) -> tuple[IntervalCoverage, ...]:
    """For each share; nothing where no errors are claimed."""
    if predictions.error is None:
        return ()
    return tuple(IntervalCoverage(share, covered_fraction(predictions, share)) for share in shares)


def covered_fraction(predictions: WrenchPredictions, share: float) -> Six:
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


@dataclass(frozen=True)
class WrenchEvaluation:
    """All figures, and the predictions that they are of."""

    predictions: WrenchPredictions
    scores: AxisScores
    by_load: tuple[GroupScores, ...]
    by_object: tuple[GroupScores, ...]
    by_sensor: tuple[GroupScores, ...]
    coverage: tuple[IntervalCoverage, ...]
    untouched: NoContactScores | None

    @property
    def pairs(self) -> int:
        """How many."""
        return len(self.predictions.truth)

    @property
    def mean_mae(self) -> ForceTorqueMeans:
        """The paper's averages of the error."""
        return force_torque_means(self.scores.mae)

    @property
    def mean_std(self) -> ForceTorqueMeans:
        """And of its deviation."""
        return force_torque_means(self.scores.std)

    def to_json_dict(self) -> dict[str, Any]:
        """Plain values for JSON; null where a question has no answer."""
        return {
            "pairs": self.pairs,
            "axes": list(AXES),
            "units": list(UNITS),
            "about_mm": None if self.predictions.about_mm is None else list(self.predictions.about_mm),
            **{field.name: _six_to_json(getattr(self.scores, field.name)) for field in fields(AxisScores)},
            "mean_mae": asdict(self.mean_mae),
            "mean_std": asdict(self.mean_std),
            "by_load": _groups_to_json(self.by_load),
            "untouched": None if self.untouched is None else asdict(self.untouched),
            "distribution": str(self.predictions.distribution) if self.coverage else None,
            "coverage": {f"{100 * found.share:g}": _six_to_json(found.covered) for found in self.coverage},
            "by_object": _groups_to_json(self.by_object),
            "by_sensor": _groups_to_json(self.by_sensor),
            "published": asdict(published_scores_about(self.predictions.about_mm)),
        }


def evaluate_predictions(predictions: WrenchPredictions) -> WrenchEvaluation:
    """Judge predictions as they are; `Predictions.about` moves their torques first."""
    return WrenchEvaluation(
        predictions,
        _axis_scores(predictions),
        tuple(_scores_by_load(predictions)),
        tuple(part for part in _scores_by_name(predictions, predictions.objects) if part.name != NOTHING),
        tuple(_scores_by_name(predictions, predictions.sensors)),
        _interval_coverage(predictions),
        _no_contact_scores(predictions),
    )


def _groups_to_json(found: Iterable[GroupScores]) -> dict[str, Any]:
    """By name."""
    return {
        one.name: {"pairs": one.pairs, "mae": _six_to_json(one.mae), "bias": _six_to_json(one.bias)} for one in found
    }


def _six_to_json(six: Six) -> list[float | None]:
    """JSON knows no NaN."""
    return [None if np.isnan(value) else float(value) for value in six]

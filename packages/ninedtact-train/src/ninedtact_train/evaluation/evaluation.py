"""Evaluation of wrench predictions: scores by axis, load, object and sensor, and the coverage of claimed intervals.

`evaluate_predictions` computes a `WrenchEvaluation` from `WrenchPredictions`. `PUBLISHED_SCORES` are the scores of the published
network on its own sensor, for comparison (docs/references.md).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
from numpy import ndarray as Array

from ninedtact.quantities import NO_OBJECT, WRENCH_AXES, WRENCH_UNITS
from ninedtact_train.evaluation.predictions import FORCES, TORQUES, Six, WrenchPredictions

_SixNumbers = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class PublishedScores:
    """Scores of one published network, N and N·m, named as in `AxisScores`, with a description of its data."""

    what: str
    mae: _SixNumbers
    std: _SixNumbers
    rmse: _SixNumbers
    r2: _SixNumbers
    slope: _SixNumbers
    skill: _SixNumbers


PUBLISHED_SCORES = PublishedScores(
    "published: DenseNet-169, 10,000 pairs of its own sensor, standard split; torques about 35 mm below the skin",
    mae=(0.2956, 0.3483, 0.2778, 0.00899, 0.00784, 0.00123),
    std=(0.2570, 0.3028, 0.3310, 0.00923, 0.00813, 0.00160),
    rmse=(0.3917, 0.4615, 0.4321, 0.01289, 0.01129, 0.00202),
    r2=(0.722, 0.717, 0.971, 0.884, 0.903, 0.815),
    slope=(0.758, 0.774, 1.003, 0.900, 0.917, 0.872),
    skill=(0.475, 0.484, 0.862, 0.691, 0.718, 0.636),
)
"""Scores that this package computed from the published predictions, with torques about the paper's point."""
PUBLISHED_SCORES_AT_SKIN = replace(
    PUBLISHED_SCORES,
    what="published: DenseNet-169, 10,000 pairs of its own sensor, standard split; torques moved up by 35 mm to the skin",
    mae=(*PUBLISHED_SCORES.mae[:3], 0.00502, 0.00424, 0.00123),
    std=(*PUBLISHED_SCORES.std[:3], 0.00906, 0.00501, 0.00160),
    rmse=(*PUBLISHED_SCORES.rmse[:3], 0.01036, 0.00657, 0.00202),
    r2=(*PUBLISHED_SCORES.r2[:3], 0.732, 0.940, 0.815),
    slope=(*PUBLISHED_SCORES.slope[:3], 0.925, 0.965, 0.872),
    skill=(*PUBLISHED_SCORES.skill[:3], 0.677, 0.797, 0.636),
)
"""Scores of the same predictions with torques about the skin's centre; the force/torque sensor is taken to be 35 mm below it."""
PAPER_OBJECT_SPLIT_MAE = ("0.35", "0.40", "0.41", "11", "10", "2")
PAPER_OBJECT_SPLIT_STD = ("0.31", "0.36", "0.44", "15", "14", "3")
"""Scores for held-out objects as printed in the paper, N and N·mm; the individual predictions were not published."""


def published_scores_about_torque_point(point_mm: tuple[float, float, float] | None) -> PublishedScores:
    """Return the published scores with torques about the skin's centre for (0, 0, 0), else about the paper's point."""
    return PUBLISHED_SCORES_AT_SKIN if point_mm == (0.0, 0.0, 0.0) else PUBLISHED_SCORES


_LOADS_N = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, np.inf)
"""Edges of the bins of |F_z|."""
_COVERAGE_SHARES = (0.5, 0.9)


class AxisScores:
    """Scores of each axis, N and N·m where they have a unit; NaN where the truth does not vary and a score is undefined."""

    def __init__(self, predictions: WrenchPredictions) -> None:
        true, predicted, error = predictions.truth, predictions.predicted, predictions.error
        true_spread, predicted_spread = true - true.mean(0), predicted - predicted.mean(0)
        self.mae: Six = np.abs(error).mean(0)
        """Mean absolute error."""
        self.std: Six = np.abs(error).std(0)
        """Standard deviation of the absolute error, as in the paper."""
        self.rmse: Six = np.sqrt((error**2).mean(0))
        self.bias: Six = error.mean(0)
        """Mean of predicted minus true."""
        self.median_mae: Six = np.abs(true - np.median(true, axis=0)).mean(0)
        """Mean absolute error of always predicting the median of these truths."""
        self.skill: Six = 1 - _ratio(self.mae, self.median_mae)
        """1 − mae / median_mae: 0 is no better than the median, 1 is perfect. It is comparable between different force ranges."""
        self.r2: Six = 1 - _ratio((error**2).sum(0), (true_spread**2).sum(0))
        """1 − squared errors / squared deviations of the truth from its mean."""
        self.slope: Six = _ratio((true * predicted).sum(0), (true**2).sum(0))
        """Slope of the least-squares line predicted = slope · true; below 1, forces are underestimated."""
        self.slope_with_offset: Six = _ratio((true_spread * predicted_spread).sum(0), (true_spread**2).sum(0))
        """Slope of the least-squares line predicted = slope · true + offset; predictions that stay near the mean lower it, too."""


@dataclass(frozen=True)
class ForceTorqueMeans:
    """Mean over the three forces and mean over the three torques, as the paper averages."""

    force_n: float
    torque_nm: float


@dataclass(frozen=True)
class GroupScores:
    """Errors of the pairs of one load bin, object or sensor."""

    name: str
    pairs: int
    mae: Six
    bias: Six


@dataclass(frozen=True)
class NoContactScores:
    """Forces predicted for pairs without contact (`WrenchPredictions.in_contact`); any force found there is false."""

    pairs: int
    mean_force_n: float
    """Mean magnitude of the predicted force."""
    largest_force_n: float


@dataclass(frozen=True)
class WrenchEvaluation:
    """All scores of a set of predictions, and the predictions themselves."""

    predictions: WrenchPredictions
    scores: AxisScores
    by_load: tuple[GroupScores, ...]
    by_object: tuple[GroupScores, ...]
    by_sensor: tuple[GroupScores, ...]
    coverage: dict[float, Six]
    """Observed coverage (`interval_coverage`) of the intervals that should contain the truth in this share of all pairs; empty
    where no standard deviations are claimed."""
    no_contact: NoContactScores | None

    @property
    def pairs(self) -> int:
        """The number of evaluated pairs."""
        return len(self.predictions.truth)

    def to_json_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, N and N·m; undefined scores are null."""
        values = {
            "pairs": self.pairs,
            "axes": WRENCH_AXES,
            "units": WRENCH_UNITS,
            "about_mm": self.predictions.about_mm,
            **vars(self.scores),
            "mean_mae": force_torque_means(self.scores.mae),
            "mean_std": force_torque_means(self.scores.std),
            "by_load": _groups_by_name(self.by_load),
            "no_contact": self.no_contact,
            "distribution": self.predictions.distribution if self.coverage else None,
            "coverage": {f"{100 * share:g}": covered for share, covered in self.coverage.items()},
            "by_object": _groups_by_name(self.by_object),
            "by_sensor": _groups_by_name(self.by_sensor),
            "published": published_scores_about_torque_point(self.predictions.about_mm),
        }
        content = msgspec.json.encode(values, enc_hook=lambda six: six.tolist())  # not-a-number becomes null
        return msgspec.json.decode(content, type=dict[str, Any])


def evaluate_predictions(predictions: WrenchPredictions) -> WrenchEvaluation:
    """Compute all scores, torques about the point of the predictions; `WrenchPredictions.about` moves them first."""
    shares = () if predictions.std is None else _COVERAGE_SHARES
    return WrenchEvaluation(
        predictions,
        AxisScores(predictions),
        tuple(_scores_by_load(predictions)),
        tuple(group for group in _scores_by_name(predictions, predictions.objects) if group.name != NO_OBJECT),
        tuple(_scores_by_name(predictions, predictions.sensors)),
        {share: interval_coverage(predictions, share) for share in shares},
        _no_contact_scores(predictions),
    )


def force_torque_means(six: Six) -> ForceTorqueMeans:
    """Average over the forces and over the torques."""
    return ForceTorqueMeans(float(six[FORCES].mean()), float(six[TORQUES].mean()))


def _ratio(above: Six, below: Six) -> Six:
    """Return the quotient on each axis, NaN where the divisor is zero."""
    return np.divide(above, below, out=np.full(6, np.nan), where=below > 0)


def _scores_by_load(predictions: WrenchPredictions) -> Iterator[GroupScores]:
    """Yield the scores of the bins of true |F_z| that hold pairs; pairs without contact belong to none."""
    load_n, in_contact = np.abs(predictions.truth[:, 2]), predictions.in_contact
    for low, high in pairwise(_LOADS_N):
        inside = (load_n >= low) & (load_n < high) & in_contact
        if inside.any():
            yield _group_scores(_load_bin_name(low, high), predictions.error[inside])


def _load_bin_name(low_n: float, high_n: float) -> str:
    """Return the name of a bin, such as `2–4 N`."""
    if low_n == 0:
        return f"below {high_n:g} N"
    return f"from {low_n:g} N" if np.isinf(high_n) else f"{low_n:g}–{high_n:g} N"


def _scores_by_name(predictions: WrenchPredictions, names: Sequence[str] | None) -> Iterator[GroupScores]:
    """Yield the scores of the pairs of each name; none where names are not known."""
    if names is None:
        return
    different, number = np.unique(np.asarray(names, dtype=str), return_inverse=True)
    order = np.argsort(number, kind="stable")
    for name, rows in zip(different, np.split(order, np.cumsum(np.bincount(number))[:-1]), strict=True):
        yield _group_scores(str(name), predictions.error[rows])


def _group_scores(name: str, error: Array) -> GroupScores:
    return GroupScores(name, len(error), np.abs(error).mean(0), error.mean(0))


def _no_contact_scores(predictions: WrenchPredictions) -> NoContactScores | None:
    no_contact = ~predictions.in_contact
    if not no_contact.any():
        return None
    force_n = np.linalg.norm(predictions.predicted[no_contact, FORCES], axis=1)
    return NoContactScores(int(no_contact.sum()), float(force_n.mean()), float(force_n.max()))


def interval_coverage(predictions: WrenchPredictions, share: float) -> Six:
    """Return the part of the pairs whose truth lies in the central interval of this share, by axis; NaN for an axis without any.

    Pairs without contact for which exactly zero is predicted are left out, because they are always covered. So are, on each axis,
    pairs without a claimed standard deviation.
    """
    assert predictions.std is not None
    is_force = predictions.in_contact | predictions.predicted.any(axis=1)
    counts = is_force[:, None] & ~np.isnan(predictions.std)
    half_width = predictions.distribution.half_width(share) * predictions.std
    inside = counts & (np.abs(predictions.error) <= half_width)
    return _ratio(inside.sum(0).astype(float), counts.sum(0).astype(float))


def _groups_by_name(groups: Iterable[GroupScores]) -> dict[str, dict[str, Any]]:
    return {group.name: {"pairs": group.pairs, "mae": group.mae, "bias": group.bias} for group in groups}

"""Predictions → everything that is asked of them."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from ninedtact.force.evaluation.coverage import IntervalCoverage, coverage
from ninedtact.force.evaluation.parts import Part, Untouched, by_load, by_name, untouched
from ninedtact.force.evaluation.predictions import AXES, UNITS, Predictions, Six
from ninedtact.force.evaluation.published import published_about
from ninedtact.force.evaluation.scores import Means, Scores, means, scores
from ninedtact.force.splits import NOTHING


@dataclass(frozen=True)
class Evaluation:
    """All figures, and the predictions that they are of."""

    predictions: Predictions
    scores: Scores
    by_load: tuple[Part, ...]
    by_object: tuple[Part, ...]
    by_sensor: tuple[Part, ...]
    coverage: tuple[IntervalCoverage, ...]
    untouched: Untouched | None

    @property
    def pairs(self) -> int:
        """How many."""
        return len(self.predictions.truth)

    @property
    def mean_mae(self) -> Means:
        """The paper's averages of the error."""
        return means(self.scores.mae)

    @property
    def mean_std(self) -> Means:
        """And of its deviation."""
        return means(self.scores.std)

    def as_table(self) -> dict[str, Any]:
        """Plain values for JSON; null where a question has no answer."""
        return {
            "pairs": self.pairs,
            "axes": list(AXES),
            "units": list(UNITS),
            "about_mm": None if self.predictions.about_mm is None else list(self.predictions.about_mm),
            **{field.name: listed(getattr(self.scores, field.name)) for field in fields(Scores)},
            "mean_mae": asdict(self.mean_mae),
            "mean_std": asdict(self.mean_std),
            "by_load": parts(self.by_load),
            "untouched": None if self.untouched is None else asdict(self.untouched),
            "distribution": str(self.predictions.distribution) if self.coverage else None,
            "coverage": {f"{100 * found.share:g}": listed(found.covered) for found in self.coverage},
            "by_object": parts(self.by_object),
            "by_sensor": parts(self.by_sensor),
            "published": asdict(published_about(self.predictions.about_mm)),
        }


def evaluate(predictions: Predictions) -> Evaluation:
    """Judge predictions as they are; `Predictions.about` moves their torques first."""
    return Evaluation(
        predictions,
        scores(predictions),
        tuple(by_load(predictions)),
        tuple(part for part in by_name(predictions, predictions.objects) if part.name != NOTHING),
        tuple(by_name(predictions, predictions.sensors)),
        coverage(predictions),
        untouched(predictions),
    )


def parts(found: Iterable[Part]) -> dict[str, Any]:
    """By name."""
    return {one.name: {"pairs": one.pairs, "mae": listed(one.mae), "bias": listed(one.bias)} for one in found}


def listed(six: Six) -> list[float | None]:
    """JSON knows no NaN."""
    return [None if np.isnan(value) else float(value) for value in six]

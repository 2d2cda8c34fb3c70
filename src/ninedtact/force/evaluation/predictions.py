"""Wrenches beside what was made of them.

Predictions that look as if they were not in N and N·m about a point near the skin.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import log, sqrt
from statistics import NormalDist

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")
FORCES, TORQUES = slice(0, 3), slice(3, 6)
_FEWEST_PAIRS = 2

Wrenches = Float64[Array, "n 6"]
Six = Float64[Array, "6"]


class PredictionsUnusable(NinedtactError):
    """WrenchPredictions that cannot be judged."""


class ErrorDistribution(StrEnum):
    """What errors are said to be distributed like, given their standard deviation."""

    GAUSSIAN = "gaussian"
    LAPLACE = "laplace"
    """A network with scale b has the standard deviation √2 b."""

    def half_width(self, share: float) -> float:
        """Of the middle interval that holds this share (below 1), in standard deviations."""
        if self is ErrorDistribution.GAUSSIAN:
            return NormalDist().inv_cdf((1 + share) / 2)
        return -log(1 - share) / sqrt(2)


@dataclass(frozen=True)
class WrenchPredictions:
    """True and predicted wrenches, N and N·m, pair by pair; raises `PredictionsUnusable` for what cannot be judged."""

    truth: Wrenches
    predicted: Wrenches
    error: Wrenches | None = None
    """Standard deviations that the predictions claim; NaN where none is claimed for an axis."""
    distribution: ErrorDistribution = ErrorDistribution.GAUSSIAN
    """Of which `error` are the standard deviations."""
    objects: Sequence[str] | None = None
    sensors: Sequence[str] | None = None
    about_mm: tuple[float, float, float] | None = None
    """The point that torques are about, truth's and prediction's; None where nobody said."""

    def __post_init__(self) -> None:
        rows = len(self.truth)
        if rows < _FEWEST_PAIRS:
            raise PredictionsUnusable(f"expected at least {_FEWEST_PAIRS} pairs to judge, got {rows}; evaluate more")
        for name in ("truth", "predicted", "error"):
            _require_wrenches(name, getattr(self, name), rows)
        for name in ("objects", "sensors"):
            column = getattr(self, name)
            if column is not None and len(column) != rows:
                raise PredictionsUnusable(
                    f"expected {name} of {rows} pairs, got {len(column)}; give one for every pair"
                )

    @property
    def off(self) -> Wrenches:
        """Predicted minus true."""
        return self.predicted - self.truth

    def those(self, chosen: Sequence[bool]) -> "WrenchPredictions":
        """Some of the pairs; raises `PredictionsUnusable` where they are too few."""
        rows = np.flatnonzero(chosen).tolist()
        objects, sensors = (
            None if names is None else [names[row] for row in rows] for names in (self.objects, self.sensors)
        )
        error = None if self.error is None else self.error[rows]
        return replace(
            self,
            truth=self.truth[rows],
            predicted=self.predicted[rows],
            error=error,
            objects=objects,
            sensors=sensors,
        )

    def about(self, point_mm: tuple[float, float, float]) -> "WrenchPredictions":
        """The same with all torques about another point, as `Wrench.about` moves one; raises `PredictionsUnusable`.

        Errors claimed for torques that the move mixes with forces are claimed no longer: how they vary together is not known.
        """
        if self.about_mm is None:
            raise PredictionsUnusable(
                "expected to know the point that torques are given about before they are moved, got none; name it "
                "(--given-about-mm 0 0 0 is the skin's centre, 0 0 -35 the paper's force/torque sensor)"
            )
        arm_m = (np.array(self.about_mm) - point_mm) / 1e3
        if not np.isfinite(arm_m).all():
            raise PredictionsUnusable(
                f"expected points of finite numbers, got {self.about_mm} and {point_mm}; correct them"
            )
        truth, predicted = (_shift_torques(six, arm_m) for six in (self.truth, self.predicted))
        error = None if self.error is None else np.where(_axes_mixed_by_shift(arm_m), np.nan, self.error)
        return replace(self, truth=truth, predicted=predicted, error=error, about_mm=point_mm)


def _shift_torques(six: Wrenches, arm_m: Float64[Array, "3"]) -> Wrenches:
    """τ' = τ + arm × F, the arm from the new point to the old."""
    return np.concatenate([six[:, FORCES], six[:, TORQUES] + np.cross(arm_m, six[:, FORCES])], axis=1)


def _axes_mixed_by_shift(arm_m: Float64[Array, "3"]) -> Array:
    """Axes into which a move brings forces: those that the arm is not parallel to."""
    return np.array([False] * 3 + [bool(np.delete(arm_m, axis).any()) for axis in range(3)])


def _require_wrenches(name: str, six: Wrenches | None, rows: int) -> None:
    """Refuse what is not six finite numbers for each pair, or an error below zero."""
    if six is None:
        return
    if six.shape != (rows, len(AXES)):
        raise PredictionsUnusable(
            f"expected {rows} rows of six numbers as {name}, got an array of {six.shape}; give both of the same pairs"
        )
    bad = six < 0 if name == "error" else ~np.isfinite(six)
    if bad.any():
        row, axis = np.argwhere(bad)[0]
        raise PredictionsUnusable(
            f"expected {'no error below zero' if name == 'error' else 'finite numbers'}, got {six[row, axis]} as {name} "
            f"{AXES[axis]} of pair {row + 1} ({bad.any(axis=1).sum()} such pairs); correct them or leave these pairs out"
        )


LARGEST_N = 200.0
"""The sensor is used to 12 N."""
LONGEST_ARM_M = 0.3
"""Torque per force; the paper's arm is 0.035 m."""
SMALLEST_N = 0.02
SIZE_PERCENTILE = 95
"""Percentile that stands for the size of a column: a few outliers are no wrong unit."""
UNIT_LOW = -1.0
"""Forces reach below this where predictions between 0 and 1 cannot be in N."""


def require_si_units(predictions: WrenchPredictions) -> None:
    """Raise `PredictionsUnusable` with the first suspicion."""
    for suspicion in _unit_suspicions(predictions):
        raise PredictionsUnusable(
            f"expected forces in N and torques in N·m, got {suspicion}, or pass --trust-units if they are right"
        )


def _unit_suspicions(predictions: WrenchPredictions) -> Iterator[str]:
    """What looks wrong, and what to do about it."""
    true, predicted = predictions.truth, predictions.predicted
    if _is_normalised(predicted) and true[:, 2].min() < UNIT_LOW:
        yield (
            "predictions that all lie between 0 and 1, as the original's network gives them; turn them back into "
            "min + p · (max \N{MINUS SIGN} min) with the ranges that it was trained with"
        )
    for name, six in (("true", true), ("predicted", predicted)):
        force_n, torque_nm = _vector_size(six[:, FORCES]), _vector_size(six[:, TORQUES])
        if force_n > LARGEST_N:
            yield f"{name} forces of {force_n:.0f}, as of mN or gram-force; convert them"
        elif force_n and torque_nm > LONGEST_ARM_M * max(force_n, SMALLEST_N):
            yield (
                f"{name} torques {torque_nm / force_n:.2g} m times the forces, as of N·mm or of forces that are scaled; "
                "convert them"
            )


def _is_normalised(six: Wrenches) -> bool:
    """Every number between 0 and 1, and not merely small."""
    return bool(six.min() >= 0 and six.max() <= 1 and six.max() > 0)


def _vector_size(vectors: Float64[Array, "n 3"]) -> float:
    """How long nearly all of them are at most."""
    return float(np.percentile(np.linalg.norm(vectors, axis=1), SIZE_PERCENTILE))

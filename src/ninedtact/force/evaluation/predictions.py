"""Wrenches beside what was made of them."""

from collections.abc import Sequence
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
FEWEST = 2

Wrenches = Float64[Array, "n 6"]
Six = Float64[Array, "6"]


class PredictionsUnusable(NinedtactError):
    """Predictions that cannot be judged."""


class Distribution(StrEnum):
    """What errors are said to be distributed like, given their standard deviation."""

    GAUSSIAN = "gaussian"
    LAPLACE = "laplace"
    """A network with scale b has the standard deviation √2 b."""

    def half_width(self, share: float) -> float:
        """Of the middle interval that holds this share (below 1), in standard deviations."""
        if self is Distribution.GAUSSIAN:
            return NormalDist().inv_cdf((1 + share) / 2)
        return -log(1 - share) / sqrt(2)


@dataclass(frozen=True)
class Predictions:
    """True and predicted wrenches, N and N·m, pair by pair; raises `PredictionsUnusable` for what cannot be judged."""

    truth: Wrenches
    predicted: Wrenches
    error: Wrenches | None = None
    """Standard deviations that the predictions claim; NaN where none is claimed for an axis."""
    distribution: Distribution = Distribution.GAUSSIAN
    """Of which `error` are the standard deviations."""
    objects: Sequence[str] | None = None
    sensors: Sequence[str] | None = None
    about_mm: tuple[float, float, float] | None = None
    """The point that torques are about, truth's and prediction's; None where nobody said."""

    def __post_init__(self) -> None:
        rows = len(self.truth)
        if rows < FEWEST:
            raise PredictionsUnusable(f"expected at least {FEWEST} pairs to judge, got {rows}; evaluate more")
        for name in ("truth", "predicted", "error"):
            require_wrenches(name, getattr(self, name), rows)
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

    def those(self, chosen: Sequence[bool]) -> "Predictions":
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

    def about(self, point_mm: tuple[float, float, float]) -> "Predictions":
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
        truth, predicted = (moved(six, arm_m) for six in (self.truth, self.predicted))
        error = None if self.error is None else np.where(mixed(arm_m), np.nan, self.error)
        return replace(self, truth=truth, predicted=predicted, error=error, about_mm=point_mm)


def moved(six: Wrenches, arm_m: Float64[Array, "3"]) -> Wrenches:
    """τ' = τ + arm × F, the arm from the new point to the old."""
    return np.concatenate([six[:, FORCES], six[:, TORQUES] + np.cross(arm_m, six[:, FORCES])], axis=1)


def mixed(arm_m: Float64[Array, "3"]) -> Array:
    """Axes into which a move brings forces: those that the arm is not parallel to."""
    return np.array([False] * 3 + [bool(np.delete(arm_m, axis).any()) for axis in range(3)])


def require_wrenches(name: str, six: Wrenches | None, rows: int) -> None:
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

"""Wrench predictions: true wrenches with the predicted ones and their claimed standard deviations, a check of their units, and
their form as CSV files.

    object,sensor,Fx_N,…,Fz_N,Tx_Nm,…,Tz_Nm,pFx,…,pTz,eFx,…,eTz

Each row of a file holds the six true numbers, the six predicted ones (`p…`) and, optionally, the six claimed standard
deviations of the predictions (`e…`), in N and N·m. A standard deviation is `nan` where none is claimed. `object` and `sensor` are
optional. Other columns are ignored, and the order is free.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from io import BytesIO
from math import log, sqrt
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float64
from numpy import ndarray as Array
from pyarrow import csv

from ninedtact.atomic_write import open_atomic_file
from ninedtact.checked_reading import read_text_file
from ninedtact.errors import FileFormatError
from ninedtact.quantities import NO_OBJECT, WRENCH_AXES

FORCES, TORQUES = slice(0, 3), slice(3, 6)
_FEWEST_PAIRS = 2
_LARGEST_FORCE_N = 200.0
"""Largest plausible force; the sensor is used up to 12 N."""
_LONGEST_ARM_M = 0.3
"""Largest plausible ratio of torque to force; the paper's arm is 0.035 m."""
_SMALLEST_FORCE_N = 0.02
_SIZE_PERCENTILE = 95
"""Percentile of the magnitudes that is compared with the limits, so that a few outliers are not taken for a wrong unit."""
_MIN_FORCE_REACH_N = -1.0
"""True forces below this show that predictions between 0 and 1 cannot be in N."""

Wrenches = Float64[Array, "n 6"]
Six = Float64[Array, "6"]


class ErrorDistribution(StrEnum):
    """Whether claimed errors are Gaussian or Laplace distributed, given their standard deviation."""

    GAUSSIAN = "gaussian"
    LAPLACE = "laplace"
    """A network that predicts the scale b claims the standard deviation √2 b."""

    def half_width(self, share: float) -> float:
        """Return half the width, in standard deviations, of the central interval that holds this share (below 1)."""
        if self is ErrorDistribution.GAUSSIAN:
            return NormalDist().inv_cdf((1 + share) / 2)
        return -log(1 - share) / sqrt(2)


@dataclass(frozen=True)
class WrenchPredictions:
    """True and predicted wrenches, N and N·m, one row for each pair; raises `FileFormatError`."""

    truth: Wrenches
    predicted: Wrenches
    std: Wrenches | None = None
    """Standard deviations that the predictions claim; NaN where none is claimed."""
    distribution: ErrorDistribution = ErrorDistribution.GAUSSIAN
    """Distribution of which `std` are the standard deviations."""
    objects: Sequence[str] | None = None
    sensors: Sequence[str] | None = None
    about_mm: tuple[float, float, float] | None = None
    """Point of all torques, true and predicted; None where it is not known."""

    def __post_init__(self) -> None:
        rows = len(self.truth)
        if rows < _FEWEST_PAIRS:
            raise FileFormatError(
                expected=f"at least {_FEWEST_PAIRS} pairs to evaluate", got=f"{rows}", remedy="evaluate more"
            )
        for name in ("truth", "predicted", "std"):
            _require_wrenches(name, getattr(self, name), rows)
        for name in ("objects", "sensors"):
            column = getattr(self, name)
            if column is not None and len(column) != rows:
                raise FileFormatError(
                    expected=f"{name} of {rows} pairs", got=f"{len(column)}", remedy="give one for every pair"
                )

    @property
    def in_contact(self) -> Bool[Array, " n"]:
        """Mask of the pairs in which something touches: those whose wrench is not zero on all axes and whose object is not `none`.

        A force/torque sensor measures noise where nothing touches, so that zeros alone do not show this.
        """
        touched = np.asarray(self.truth.any(axis=1))
        return touched if self.objects is None else touched & (np.asarray(self.objects, dtype=str) != NO_OBJECT)

    @property
    def error(self) -> Wrenches:
        """Predicted minus true wrenches (n, 6)."""
        return self.predicted - self.truth

    def select(self, chosen: Sequence[bool]) -> "WrenchPredictions":
        """Return the chosen pairs; raises `FileFormatError` where they are too few."""
        rows = np.flatnonzero(chosen).tolist()
        objects, sensors = (
            None if names is None else [names[row] for row in rows] for names in (self.objects, self.sensors)
        )
        return replace(
            self,
            truth=self.truth[rows],
            predicted=self.predicted[rows],
            std=None if self.std is None else self.std[rows],
            objects=objects,
            sensors=sensors,
        )

    def about(self, point_mm: tuple[float, float, float]) -> "WrenchPredictions":
        """Return the predictions with torques about another point, moved as by `Wrench.about`; raises `FileFormatError`.

        Standard deviations of torques into which the move mixes forces become NaN, because their correlation is not known.
        """
        if self.about_mm is None:
            raise FileFormatError(
                expected="to know the point of the torques before they are moved",
                got="none",
                remedy="name it (--predictions-about-mm 0 0 0 is the skin's centre, 0 0 -35 the paper's "
                "force/torque sensor)",
            )
        arm_m = (np.array(self.about_mm) - point_mm) / 1e3
        if not np.isfinite(arm_m).all():
            raise FileFormatError(
                expected="points of finite numbers", got=f"{self.about_mm} and {point_mm}", remedy="correct them"
            )
        truth, predicted = (
            np.concatenate([six[:, FORCES], six[:, TORQUES] + np.cross(arm_m, six[:, FORCES])], axis=1)
            for six in (self.truth, self.predicted)
        )
        # The torque axes that are not parallel to the arm receive a part of the forces.
        is_mixed = np.array([False] * 3 + [bool(np.delete(arm_m, axis).any()) for axis in range(3)])
        std = None if self.std is None else np.where(is_mixed, np.nan, self.std)
        return replace(self, truth=truth, predicted=predicted, std=std, about_mm=point_mm)


def _require_wrenches(name: str, six: Wrenches | None, rows: int) -> None:
    """Raise `FileFormatError` for anything but six finite numbers for each pair, or standard deviations of zero or more."""
    if six is None:
        return
    if six.shape != (rows, len(WRENCH_AXES)):
        raise FileFormatError(
            expected=f"{rows} rows of six numbers as {name}",
            got=f"an array of {six.shape}",
            remedy="give both of the same pairs",
        )
    bad = six < 0 if name == "std" else ~np.isfinite(six)
    if bad.any():
        row, axis = np.argwhere(bad)[0]
        raise FileFormatError(
            expected=f"{'no standard deviation below zero' if name == 'std' else 'finite numbers'}",
            got=f"{six[row, axis]} as {name} {WRENCH_AXES[axis]} of pair {row + 1} ({bad.any(axis=1).sum()} such "
            "pairs)",
            remedy="correct them or leave these pairs out",
        )


def require_si_units(predictions: WrenchPredictions) -> None:
    """Raise `FileFormatError` where wrenches do not look like N and N·m about a point near the skin."""
    for suspicion in _unit_suspicions(predictions):
        raise FileFormatError(
            f"expected forces in N and torques in N·m, got {suspicion}, or pass --trust-units if they are right"
        )


def _unit_suspicions(predictions: WrenchPredictions) -> Iterator[str]:
    """Yield a text for each sign of wrong units: what is suspicious, and what to do about it."""
    true, predicted = predictions.truth, predictions.predicted
    is_normalised = predicted.min() >= 0 and predicted.max() <= 1 and predicted.any()
    if is_normalised and true[:, 2].min() < _MIN_FORCE_REACH_N:
        yield (
            "predictions that all lie between 0 and 1, as the original's network gives them; turn them back into "
            "min + p · (max \N{MINUS SIGN} min) with the ranges that it was trained with"
        )
    for name, six in (("true", true), ("predicted", predicted)):
        force_n, torque_nm = _vector_size(six[:, FORCES]), _vector_size(six[:, TORQUES])
        if force_n > _LARGEST_FORCE_N:
            yield f"{name} forces of {force_n:.0f}, as of mN or gram-force; convert them"
        elif force_n and torque_nm > _LONGEST_ARM_M * max(force_n, _SMALLEST_FORCE_N):
            yield (
                f"{name} torques {torque_nm / force_n:.2g} m times the forces, as of N·mm or of forces that are scaled; "
                "convert them"
            )


def _vector_size(vectors: Float64[Array, "n 3"]) -> float:
    """Return the length that nearly all vectors stay below."""
    return float(np.percentile(np.linalg.norm(vectors, axis=1), _SIZE_PERCENTILE))


_TRUTH = tuple(f"{axis}_{'N' if axis.startswith('F') else 'Nm'}" for axis in WRENCH_AXES)
_PREDICTED = tuple(f"p{axis}" for axis in WRENCH_AXES)
_STD = tuple(f"e{axis}" for axis in WRENCH_AXES)
_GROUPS = ("object", "sensor")


def read_predictions(
    path: Path,
    distribution: ErrorDistribution = ErrorDistribution.GAUSSIAN,
    about_mm: tuple[float, float, float] | None = None,
) -> WrenchPredictions:
    """Read and check a file; raises `FileFormatError` with the row and column of what is wrong.

    distribution: the distribution of the claimed errors. about_mm: the point of the torques. The file contains neither.
    """
    types = {name: pa.float64() for name in (*_TRUTH, *_PREDICTED, *_STD)} | dict.fromkeys(_GROUPS, pa.string())
    try:
        table = csv.read_csv(
            BytesIO(read_text_file(path).encode()),
            csv.ReadOptions(use_threads=False),  # with threads, Arrow does not count rows
            parse_options=csv.ParseOptions(newlines_in_values=True),
            convert_options=csv.ConvertOptions(column_types=types, null_values=[]),
        )
    except (OSError, UnicodeDecodeError, pa.ArrowException) as trouble:
        raise FileFormatError(
            f"expected a CSV file of predictions in {path}, got: {trouble}; check the path, or correct that row"
        ) from trouble
    _require_columns(path, table.column_names)
    truth, predicted = (_six_columns(table, names) for names in (_TRUTH, _PREDICTED))
    std = _six_columns(table, _STD) if _STD[0] in table.column_names else None
    objects, sensors = (table[name].to_pylist() if name in table.column_names else None for name in _GROUPS)
    return WrenchPredictions(truth, predicted, std, distribution, objects, sensors, about_mm)


def _require_columns(path: Path, header: Sequence[str]) -> None:
    wanted = (*_TRUTH, *_PREDICTED, *(_STD if any(name in _STD for name in header) else ()))
    missing = [name for name in wanted if name not in header]
    repeated = sorted({name for name in header if header.count(name) > 1})
    if missing or repeated:
        fault = f"no {', '.join(missing)}" if missing else f"{', '.join(repeated)} more than once"
        raise FileFormatError(
            expected=f"columns {' '.join(_TRUTH)} {' '.join(_PREDICTED)} in {path}, separated by commas",
            got=f"{fault} (the columns there: {' '.join(header)[:200]})",
            remedy="name them so",
        )


def _six_columns(table: pa.Table, names: Sequence[str]) -> Wrenches:
    return np.stack([table[name].to_numpy() for name in names], axis=1)


def write_predictions(path: Path, predictions: WrenchPredictions) -> None:
    """Write a file atomically with every number in full, so that it is read back unchanged; raises `FileNotWritten`."""
    columns = {
        name: column
        for name, column in zip(_GROUPS, (predictions.objects, predictions.sensors), strict=True)
        if column is not None
    }
    for names, six in ((_TRUTH, predictions.truth), (_PREDICTED, predictions.predicted), (_STD, predictions.std)):
        if six is not None:
            columns |= dict(zip(names, six.T, strict=True))
    with open_atomic_file(path) as file:
        csv.write_csv(pa.table(columns), file)

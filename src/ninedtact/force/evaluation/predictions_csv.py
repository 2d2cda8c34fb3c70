"""Reading and writing of wrench predictions as CSV files.

    object,sensor,Fx_N,…,Fz_N,Tx_Nm,…,Tz_Nm,pFx,…,pTz,eFx,…,eTz

Each row holds the six true numbers, the six predicted ones (`p…`) and, optionally, the six claimed standard deviations of the
predictions (`e…`), in N and N·m. `object` and `sensor` are optional. Other columns are ignored, and the order is free.
"""

import csv
from collections.abc import Iterator, Sequence
from io import StringIO
from math import isfinite
from pathlib import Path
from typing import NoReturn

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.checked_reading import read_text_file
from ninedtact.force.evaluation.predictions import (
    AXES,
    ErrorDistribution,
    PredictionsUnusable,
    Wrenches,
    WrenchPredictions,
)

_TRUTH = tuple(f"{axis}_{'N' if axis.startswith('F') else 'Nm'}" for axis in AXES)
_PREDICTED = tuple(f"p{axis}" for axis in AXES)
_STD = tuple(f"e{axis}" for axis in AXES)
_GROUPS = ("object", "sensor")


def read_predictions(
    path: Path,
    distribution: ErrorDistribution = ErrorDistribution.GAUSSIAN,
    about_mm: tuple[float, float, float] | None = None,
) -> WrenchPredictions:
    """Read and check a file; raises `PredictionsUnusable` with the line and column of what is wrong.

    distribution: the distribution of the claimed errors. about_mm: the point of the torques. The file contains neither.
    """
    header, rows = _read_csv_rows(path)
    _require_columns(path, header)
    columns = dict(zip(header, zip(*(row for _, row in rows), strict=True), strict=True))
    lines = [line for line, _ in rows]
    truth, predicted = (_parse_columns(path, columns, names, lines) for names in (_TRUTH, _PREDICTED))
    std = _parse_columns(path, columns, _STD, lines) if _STD[0] in columns else None
    objects, sensors = (columns.get(name) for name in _GROUPS)
    return WrenchPredictions(truth, predicted, std, distribution, objects, sensors, about_mm)


def _read_csv_rows(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the header, and the rows with their line numbers; raises `PredictionsUnusable`."""
    try:
        text = read_text_file(path).removeprefix("\ufeff")
        reader = csv.reader(StringIO(text, newline=""), strict=True)
        filled = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
    except (OSError, UnicodeDecodeError, csv.Error) as trouble:
        raise PredictionsUnusable(
            f"expected a CSV file of predictions in {path}, got: {trouble}; check the path, or write it again as UTF-8 text"
        ) from trouble
    if len(filled) < 2:
        raise PredictionsUnusable(
            f"expected a header and rows of predictions in {path}, got {'a header alone' if filled else 'an empty file'}; "
            "write the predictions again"
        )
    (_, header), *rows = filled
    for line, row in rows:
        if len(row) != len(header):
            _refuse_line(path, line, f"expected {len(header)} cells as in the header, got {len(row)}")
    return header, rows


def _require_columns(path: Path, header: Sequence[str]) -> None:
    """Raise `PredictionsUnusable` for a header without a required column, or with a name twice."""
    wanted = (*_TRUTH, *_PREDICTED, *(_STD if any(name in _STD for name in header) else ()))
    missing = [name for name in wanted if name not in header]
    repeated = sorted({name for name in header if header.count(name) > 1})
    if missing or repeated:
        fault = f"no {', '.join(missing)}" if missing else f"{', '.join(repeated)} more than once"
        raise PredictionsUnusable(
            f"expected columns {' '.join(_TRUTH)} {' '.join(_PREDICTED)} in {path}, separated by commas, got {fault} (the columns "
            f"there: {' '.join(header)[:200]}); name them so"
        )


def _parse_columns(
    path: Path, columns: dict[str, tuple[str, ...]], names: Sequence[str], lines: Sequence[int]
) -> Wrenches:
    """Return six columns as finite numbers; raises `PredictionsUnusable`."""
    try:
        six = np.array([columns[name] for name in names]).astype(float).T
    except ValueError:
        six = np.full((len(lines), len(names)), np.nan)
    if not np.isfinite(six).all():
        return np.array(list(_parse_cells(path, columns, names, lines))).reshape(len(names), len(lines)).T
    return np.ascontiguousarray(six)


def _parse_cells(
    path: Path, columns: dict[str, tuple[str, ...]], names: Sequence[str], lines: Sequence[int]
) -> Iterator[float]:
    """Parse columns cell by cell, to name the line that is wrong. A standard deviation may be infinite."""
    for name in names:
        for line, cell in zip(lines, columns[name], strict=True):
            try:
                value = float(cell)
            except ValueError:
                _refuse_line(path, line, f"expected a number in column {name}, got {cell[:40]!r}")
            if not (isfinite(value) or (name in _STD and value == np.inf)):
                _refuse_line(path, line, f"expected a finite number in column {name}, got {cell}")
            yield value


def _refuse_line(path: Path, line: int, fault: str) -> NoReturn:
    """Raise `PredictionsUnusable` with the number of the faulty line."""
    raise PredictionsUnusable(f"{fault}, in line {line} of {path}; correct it or leave the line out")


def write_predictions(path: Path, predictions: WrenchPredictions) -> None:
    """Write a file atomically with every number in full, so that it is read back unchanged; raises `FileNotWritten`."""
    text = StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    groups = {
        name: column
        for name, column in zip(_GROUPS, (predictions.objects, predictions.sensors), strict=True)
        if column is not None
    }
    blocks = {_TRUTH: predictions.truth, _PREDICTED: predictions.predicted}
    if predictions.std is not None:
        blocks[_STD] = predictions.std
    writer.writerow([*groups, *(name for names in blocks for name in names)])
    writer.writerows(
        zip(*groups.values(), *(column.tolist() for six in blocks.values() for column in six.T), strict=True)
    )
    write_file_atomically(path, text.getvalue().encode())

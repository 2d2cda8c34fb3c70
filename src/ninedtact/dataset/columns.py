"""Rows as Parquet: the columns of the twin's data sets and five more. Read and written a hundred rows at a time."""

from collections.abc import Collection, Container, Iterable, Iterator
from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.atomic_write import open_atomic_file
from ninedtact.dataset.arrow import pa, pq
from ninedtact.dataset.generation.table import COLUMNS as TWINS_COLUMNS
from ninedtact.dataset.generation.table import REFERENCE_COLUMNS, schema, stored
from ninedtact.dataset.rows import Row, UntouchedImage, writable
from ninedtact.errors import NinedtactError

COLUMNS = {
    **TWINS_COLUMNS,
    "id": (pa.string(), {"dtype": "string", "_type": "Value"}),
    "source": (pa.string(), {"dtype": "string", "_type": "Value"}),
    "mm_per_px": (pa.float32(), {"dtype": "float32", "_type": "Value"}),
    "gap_ms": (pa.float32(), {"dtype": "float32", "_type": "Value"}),
}
NEEDED = ("image", "wrench")
GROUP = 100
"""Rows that are in memory at once, and that a reader can pick."""
Thing = TypeVar("Thing")


class DataSetDamaged(NinedtactError):
    """A folder that is no data set, or a file of it that is not whole."""


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """A file of pairs, whole or not at all; raises `FileNotWritten`."""
    write(path, ({**plain(row), "image": stored(row.image)} for row in rows), COLUMNS)


def plain(row: Row) -> dict[str, Any]:
    """The columns of a row, names as UTF-8 can hold them."""
    values = {field.name: getattr(row, field.name) for field in fields(row) if field.name in COLUMNS}
    return {name: writable(value) if isinstance(value, str) else value for name, value in values.items()}


def write_untouched(path: Path, images: Iterable[UntouchedImage]) -> None:
    """The untouched images, whole or not at all; raises `FileNotWritten`."""
    rows = ({"reference": writable(it.id), "image": stored(it.image), "sensor": writable(it.sensor)} for it in images)
    write(path, rows, REFERENCE_COLUMNS)


def write(path: Path, rows: Iterable[dict[str, Any]], columns: dict[str, tuple[Any, dict[str, Any]]]) -> None:
    """Rows of any columns; images are compressed already."""
    form = schema(columns)
    with open_atomic_file(path) as file, pq.ParquetWriter(file, form, compression="snappy") as writer:
        for group in groups(rows, GROUP):
            writer.write_table(pa.Table.from_pylist(group, schema=form))


def copy_rows(path: Path, final: Path, unwanted: Container[int]) -> None:
    """A file's rows to another one, without some; raises `FileNotWritten`, `DataSetDamaged`."""
    kept = (row for number, row in enumerate(rows_of(path)) if number not in unwanted)
    write(final, kept, COLUMNS)


def groups(things: Iterable[Thing], size: int) -> Iterator[list[Thing]]:
    """A hundred at a time."""
    each = iter(things)
    while group := list(islice(each, size)):
        yield group


def rows_of(path: Path, columns: Iterable[str] | None = None) -> Iterator[dict[str, Any]]:
    """The rows of a file one by one, all columns or those of these that it has; raises `DataSetDamaged`."""
    file = opened(path)
    present = None if columns is None else [name for name in columns if name in file.schema_arrow.names]
    try:
        for batch in file.iter_batches(GROUP, columns=present):
            yield from batch.to_pylist()
    except (pa.ArrowException, OSError) as trouble:
        raise damaged(path, trouble) from trouble


def rows_at(path: Path, numbers: Collection[int]) -> Iterator[dict[str, Any]]:
    """Some rows of a file, in its order; raises `DataSetDamaged`."""
    file, begin = opened(path), 0
    for group in range(file.num_row_groups):
        end = begin + file.metadata.row_group(group).num_rows
        wanted = sorted(number - begin for number in numbers if begin <= number < end)
        if wanted:
            try:
                yield from file.read_row_group(group).take(wanted).to_pylist()
            except (pa.ArrowException, OSError) as trouble:
                raise damaged(path, trouble) from trouble
        begin = end


def opened(path: Path) -> Any:
    """A Parquet file; raises `DataSetDamaged`."""
    try:
        return pq.ParquetFile(path)
    except (pa.ArrowException, OSError) as trouble:
        raise damaged(path, trouble) from trouble


def require_pairs(path: Path) -> None:
    """Refuse a file of something else; raises `DataSetDamaged`."""
    names = opened(path).schema_arrow.names
    missing = [name for name in NEEDED if name not in names]
    if missing:
        raise DataSetDamaged(
            f"expected the columns {' and '.join(NEEDED)} in {path}, got none called {missing[0]} among {', '.join(names)}; "
            "give the folder of a data set of pairs"
        )


def damaged(path: Path, trouble: Exception) -> DataSetDamaged:
    """The refusal of a file."""
    said = (str(trouble).splitlines() or [type(trouble).__name__])[0]
    return DataSetDamaged(f"expected a whole Parquet file in {path}, got: {said}; copy it again or build it again")


def bytes_of(stored: Any) -> bytes | None:
    """What an image column holds."""
    return stored.get("bytes") if isinstance(stored, dict) else stored if isinstance(stored, bytes) else None


def six(value: Any) -> Float32[Array, "6"]:
    """A wrench as stored; not a number where there is none."""
    numbers = [float("nan") if number is None else number for number in (value or [])]
    return np.asarray(numbers if len(numbers) == 6 else [float("nan")] * 6, np.float32)

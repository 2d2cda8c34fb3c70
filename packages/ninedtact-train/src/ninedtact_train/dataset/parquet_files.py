"""Reads and writes the Parquet files of a data set: pairs, reference images, whole columns, and the images that they store,
which are grey PNG files, encoded, decoded, and looked up by the id of a reference image.

Files are written completely or not at all. Rows are read and written in groups, so that a file may be larger than memory.
"""

import json
from collections.abc import Collection, Container, Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.atomic_write import open_atomic_file
from ninedtact.capture.strict_image_reading import image_file_fault
from ninedtact.errors import FileFormatError
from ninedtact_train.dataset.schema import (
    DATASET_FORMAT,
    FORMAT_KEY,
    PAIR_COLUMNS,
    REFERENCE_COLUMNS,
    TRUTH_COLUMNS,
    WRENCH_MEANING,
    Column,
    DatasetRow,
    MotionTruth,
    ReferenceImage,
)

_ROWS_PER_GROUP = 100
"""Number of rows in memory at once, which is the smallest unit that a reader can read."""
_READ_ERRORS = (pa.ArrowException, OSError, ValueError, MemoryError)
"""Exceptions that Arrow raises for a damaged file; text that is not UTF-8 is a `ValueError`."""
_NO_WRENCH = [float("nan")] * 6
_MOST_TEXT_BYTES, _MOST_VALUES_PER_ROW = 500_000_000, 16
"""Largest size of the texts of a file once they are decoded; a dictionary of Parquet stores a text once for any number of rows."""
_MOST_TEXT_BYTES_PER_ROW = 10_000
"""Largest size of the texts of a column, per row: names and places."""
_IMAGE_COLUMNS = {column.name for column in (*PAIR_COLUMNS, *REFERENCE_COLUMNS) if column.kind == "image"}


def write_pair_file(path: Path, rows: Iterable[DatasetRow]) -> None:
    """Write a file of pairs; raises `FileNotWritten`."""
    _write_parquet_file(path, map(_column_values, rows), PAIR_COLUMNS)


def write_sequence_file(path: Path, images: Iterable[tuple[DatasetRow, MotionTruth]]) -> None:
    """Write a file of one sequence, pairs with their truth; raises `FileNotWritten`."""
    rows = ({**_column_values(row), **vars(truth)} for row, truth in images)
    _write_parquet_file(path, rows, (*PAIR_COLUMNS, *TRUTH_COLUMNS))


def write_reference_images_file(path: Path, references: Iterable[ReferenceImage]) -> None:
    """Write the Parquet file of all reference images; raises `FileNotWritten`."""
    _write_parquet_file(path, map(_column_values, references), REFERENCE_COLUMNS)


def copy_pairs_without_rows(path: Path, target: Path, unwanted_rows: Container[int]) -> None:
    """Copy a file of pairs without some of its rows; raises `FileNotWritten`, `FileFormatError`."""
    kept = (row for number, row in enumerate(iterate_rows(path)) if number not in unwanted_rows)
    _write_parquet_file(target, kept, PAIR_COLUMNS)


def _column_values(item: DatasetRow | ReferenceImage) -> dict[str, Any]:
    """Return the values of an item by column, with text as UTF-8 can store it."""
    values = {
        name: escape_invalid_utf8(value) if isinstance(value, str) else value for name, value in vars(item).items()
    }
    return {**values, "image": {"bytes": item.image, "path": None}}


def escape_invalid_utf8(text: str) -> str:
    """Return text that UTF-8 can store: the bytes of a file name that are not UTF-8 become escape sequences."""
    return text.encode(errors="backslashreplace").decode()


def _write_parquet_file(path: Path, rows: Iterator[dict[str, Any]], columns: tuple[Column, ...]) -> None:
    """Write rows of column values; this is the only place that writes Parquet."""
    schema, plain = _arrow_schema(columns), [one.name for one in columns if one.kind not in ("image", "wrench")]
    with (
        open_atomic_file(path) as file,
        pq.ParquetWriter(file, schema, compression="snappy", write_page_checksum=True, use_dictionary=plain) as writer,
    ):
        while group := list(islice(rows, _ROWS_PER_GROUP)):
            writer.write_table(pa.Table.from_pylist(group, schema=schema))


def _arrow_schema(columns: tuple[Column, ...]) -> pa.Schema:
    """Return the Arrow schema of these columns, with the metadata by which Hugging Face `datasets` recognises images."""
    arrow_types = {
        "image": pa.struct([("bytes", pa.binary()), ("path", pa.string())]),
        "wrench": pa.list_(pa.float32(), 6),
    }
    features: dict[str, Any] = {
        "image": {"_type": "Image"},
        "wrench": {"feature": {"dtype": "float32", "_type": "Value"}, "length": 6, "_type": "Sequence"},
    }
    fields = [(one.name, arrow_types.get(one.kind) or pa.type_for_alias(one.kind)) for one in columns]
    info = {one.name: features.get(one.kind) or {"dtype": one.kind, "_type": "Value"} for one in columns}
    axes = "torque about the centre of the skin without contact; x along columns, y along rows, z outward"
    metadata = {
        FORMAT_KEY: str(DATASET_FORMAT).encode(),
        b"ninedtact.wrench": f"{WRENCH_MEANING}; {axes}".encode(),
        b"huggingface": json.dumps({"info": {"features": info}}).encode(),
    }
    return pa.schema(fields, metadata=metadata)


def iterate_rows(path: Path, columns: Collection[str] | None = None) -> Iterator[dict[str, Any]]:
    """Yield the rows of a file one by one as column values, all columns or the named ones; raises `FileFormatError`."""
    file = open_parquet_file(path)
    try:
        for batch in file.iter_batches(_ROWS_PER_GROUP, columns=columns and list(columns)):
            yield from batch.to_pylist()
    except _READ_ERRORS as error:
        raise _parquet_damage(path, error) from error


def iterate_rows_at(path: Path, numbers: Collection[int]) -> Iterator[dict[str, Any]]:
    """Yield the rows of these numbers in ascending order; raises `FileFormatError`."""
    file, begin = open_parquet_file(path), 0
    for group in range(file.num_row_groups):
        end = begin + file.metadata.row_group(group).num_rows
        wanted = sorted(number - begin for number in numbers if begin <= number < end)
        if wanted:
            try:
                yield from file.read_row_group(group).take(wanted).to_pylist()
            except _READ_ERRORS as error:
                raise _parquet_damage(path, error) from error
        begin = end


def read_columns(paths: Sequence[Path], columns: Sequence[str]) -> Any:
    """Return whole columns of several files as one Arrow table; raises `FileFormatError`."""
    tables = []
    for path in paths:
        try:
            tables.append(open_parquet_file(path).read(columns=list(columns)))
        except _READ_ERRORS as error:
            raise _parquet_damage(path, error) from error
    return pa.concat_tables(tables)


def wrench_array(table: Any) -> Float32[Array, "n 6"]:
    """Return the column `wrench` of an Arrow table, with NaN where a wrench is missing; raises `FileFormatError`."""
    column = table["wrench"].combine_chunks()
    lengths = pc.list_value_length(column).drop_null().to_numpy(zero_copy_only=False)
    if (lengths != len(_NO_WRENCH)).any():
        raise _wrong_length(int(lengths[lengths != len(_NO_WRENCH)][0]))
    if column.null_count == 0:
        values = column.flatten().to_numpy(zero_copy_only=False)
    else:
        values = np.array([wrench or _NO_WRENCH for wrench in column.to_pylist()])
    return np.array(values, np.float32).reshape(-1, 6)


def decode_stored_wrench(value: Any) -> Float32[Array, "6"]:
    """Return the wrench of one row, NaN where it is missing; raises `FileFormatError`."""
    numbers = [float("nan") if number is None else number for number in (value or _NO_WRENCH)]
    if len(numbers) != len(_NO_WRENCH):
        raise _wrong_length(len(numbers))
    return np.asarray(numbers, np.float32)


def _wrong_length(numbers: int) -> FileFormatError:
    return FileFormatError(
        expected="six numbers in each wrench of the data set",
        got=f"{numbers}",
        remedy="build it again from its sources",
    )


def open_parquet_file(path: Path) -> Any:
    """Open a Parquet file whose texts fit in memory and whose columns have their types; raises `FileFormatError`."""
    try:
        if not path.is_file():
            raise OSError("no such file" if not path.exists() else "a folder, a pipe or a device and not a file")
        file = pq.ParquetFile(path, page_checksum_verification=True)
        if file.metadata.num_rows > path.stat().st_size:
            raise ValueError(f"{file.metadata.num_rows} rows in {path.stat().st_size} bytes")
        if (size := _decoded_text_bytes(path, file.metadata)) > _MOST_TEXT_BYTES:
            raise ValueError(f"texts of {size / 1e6:.0f} MB, more than {_MOST_TEXT_BYTES / 1e6:.0f} MB")
        _require_column_types(path, file.schema_arrow)
        return file
    except _READ_ERRORS as error:
        raise _parquet_damage(path, error) from error


def _require_column_types(path: Path, schema: Any) -> None:
    """Raise `FileFormatError` for a column of another type than the schema of data sets gives its name."""
    for column in PAIR_COLUMNS:
        if column.name in schema.names and not _holds_kind(found := schema.field(column.name).type, column.kind):
            raise FileFormatError(
                expected=f"{'six numbers' if column.kind == 'wrench' else column.kind} in the column {column.name} of {path}",
                got=f"{found}",
                remedy="build it again from its sources",
            )


def _decoded_text_bytes(path: Path, metadata: Any) -> int:
    """Return the size of those decoded texts and images of a file that can be large, without decoding them; raises `ValueError`.

    Only a dictionary makes values larger than the file; images that we write have none.
    """
    size = 0
    for group in range(metadata.num_row_groups):
        columns = metadata.row_group(group)
        for number in range(metadata.num_columns):
            column = columns.column(number)
            if column.num_values > _MOST_VALUES_PER_ROW * columns.num_rows:
                raise ValueError(f"{column.num_values} values of {column.path_in_schema} in {columns.num_rows} rows")
            is_text = column.physical_type == "BYTE_ARRAY"
            is_image = column.path_in_schema.split(".")[0] in _IMAGE_COLUMNS
            if (
                is_text
                and not is_image
                and column.total_uncompressed_size > _MOST_TEXT_BYTES_PER_ROW * (columns.num_rows + 100)
            ):
                raise ValueError(
                    f"{column.total_uncompressed_size} bytes of texts in {columns.num_rows} rows of {column.path_in_schema}"
                )
            if is_text and column.has_dictionary_page and column.total_uncompressed_size * column.num_values > 1e7:
                name = column.path_in_schema
                read = pq.ParquetFile(path, read_dictionary=[name]).read_row_group(group, columns=[name])
                for chunk in read.column(0).chunks:
                    while pa.types.is_struct(chunk.type):  # of images
                        chunk = chunk.field(0)
                    if not pa.types.is_dictionary(chunk.type):
                        raise ValueError(f"{name} of another type than texts or images")
                    lengths = pc.binary_length(chunk.dictionary).cast(pa.int64())
                    size += pc.sum(lengths.take(chunk.indices)).as_py() or 0
    return size


def require_pair_columns(path: Path) -> None:
    """Refuse a file that does not hold pairs in the current format; raises `FileFormatError`."""
    schema = open_parquet_file(path).schema_arrow
    found = (schema.metadata or {}).get(FORMAT_KEY)
    if found != str(DATASET_FORMAT).encode():
        raise FileFormatError(
            expected=f"a data set of format {DATASET_FORMAT} in {path}",
            got=f"{'no format' if found is None else found.decode()}",
            remedy="make it again from its sources with 'ninedtact dataset build' or 'ninedtact simulate dataset'",
        )
    expected = [column.name for column in PAIR_COLUMNS]
    if missing := [name for name in expected if name not in schema.names]:
        raise FileFormatError(
            expected=f"the columns {', '.join(expected)} in {path}",
            got=f"no column {missing[0]}",
            remedy="give the folder of a data set of pairs",
        )


def _holds_kind(found: pa.DataType, kind: str) -> bool:
    """Return whether a type of Arrow holds the values of a column's kind, also as other writers store them."""
    if kind == "wrench":
        is_list = pa.types.is_list(found) or pa.types.is_large_list(found) or pa.types.is_fixed_size_list(found)
        size = getattr(found, "list_size", len(_NO_WRENCH))
        return is_list and size == len(_NO_WRENCH) and pa.types.is_floating(found.value_type)
    if pa.types.is_null(found):
        return True
    if kind == "image":
        stored = (
            found.field("bytes").type if pa.types.is_struct(found) and found.get_field_index("bytes") >= 0 else found
        )
        return bool(pa.types.is_binary(stored) or pa.types.is_large_binary(stored))
    if kind == "string":
        stored = found.value_type if pa.types.is_dictionary(found) else found
        return bool(pa.types.is_string(stored) or pa.types.is_large_string(stored))
    return bool(pa.types.is_integer(found) if kind.startswith("int") else pa.types.is_floating(found))


def _parquet_damage(path: Path, error: Exception) -> FileFormatError:
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    return FileFormatError(f"expected a whole Parquet file in {path}, got: {reason}; copy it again or build it again")


GreyImage = UInt8[Array, "rows cols"]
_MOST_DECODED = 32


class StoredImageUnreadable(FileFormatError):
    """Raised for stored bytes that are not an 8-bit image."""


def decode_stored_image(stored: Any) -> GreyImage:
    """Return the grey image of a value of the column `image`, or of a PNG file's bytes.

    The structure of the file is checked before it is decoded. Raises `StoredImageUnreadable`.
    """
    content = stored_image_bytes(stored)
    if not content:
        raise StoredImageUnreadable(expected="an image", got="nothing", remedy="record it again")
    if fault := image_file_fault(content):
        raise StoredImageUnreadable(expected="an image", got=f"{fault}", remedy="record it again")
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint8:
        raise StoredImageUnreadable(
            expected="an 8-bit image", got="damaged data or another depth", remedy="record it again"
        )
    if image.ndim == 3:
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
    return np.asarray(image)


def stored_image_bytes(stored: Any) -> bytes | None:
    """Return the file in a value of the column `image`; None if there is none."""
    content = stored.get("bytes") if isinstance(stored, dict) else stored
    return content if isinstance(content, bytes) else None


class ReferenceImageFile:
    """The reference images of a file by id: all as encoded files, the most recent ones decoded."""

    def __init__(self, path: Path) -> None:
        self._files = {row["reference_id"]: row["image"] for row in iterate_rows(path, ("reference_id", "image"))}
        self.find = lru_cache(_MOST_DECODED)(self._find)

    def _find(self, reference_id: str | None) -> GreyImage | None:
        """Return the image of this id; None if it is missing or cannot be read."""
        try:
            return decode_stored_image(self._files.get(reference_id))
        except StoredImageUnreadable:
            return None

"""Pairs as Parquet files that Hugging Face `datasets` opens, images included."""

import json
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.atomic_write import open_atomic_file
from ninedtact.dataset.generation.pair import Pair
from ninedtact.dataset.generation.settings import DatasetImpossible

try:
    import joblib  # noqa: F401 - the other half of the extra, asked for here so that one sentence covers both
    import pyarrow as pa
    import pyarrow.parquet as pq
except ModuleNotFoundError as missing:
    raise DatasetImpossible(
        f"expected the libraries of data sets, got no {missing.name}; install them: pip install 'ninedtact[datasets]'"
    ) from missing

IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
IMAGE_FEATURE = {"_type": "Image"}
COLUMNS: dict[str, tuple[pa.DataType, dict[str, Any]]] = {
    "image": (IMAGE, IMAGE_FEATURE),
    "reference": (pa.string(), {"dtype": "string", "_type": "Value"}),
    "wrench": (
        pa.list_(pa.float32(), 6),
        {"feature": {"dtype": "float32", "_type": "Value"}, "length": 6, "_type": "Sequence"},
    ),
    "object": (pa.string(), {"dtype": "string", "_type": "Value"}),
    "contact": (pa.string(), {"dtype": "string", "_type": "Value"}),
    "step": (pa.int32(), {"dtype": "int32", "_type": "Value"}),
    "time_ns": (pa.int64(), {"dtype": "int64", "_type": "Value"}),
    "sensor": (pa.string(), {"dtype": "string", "_type": "Value"}),
    "kind": (pa.string(), {"dtype": "string", "_type": "Value"}),
    "mm_per_px": (pa.float32(), {"dtype": "float32", "_type": "Value"}),
}
"""Arrow type and Hugging Face feature of every column, in the order of `Pair`."""
REFERENCE_COLUMNS = {name: COLUMNS[name] for name in ("reference", "image", "sensor")}
NOTES = {
    "ninedtact.wrench": "Fx Fy Fz in N, Tx Ty Tz in N·m, of the object on the skin, pressing gives Fz < 0; "
    "torque about the centre of the untouched skin; x along columns, y along rows, z outward"
}


def schema(columns: dict[str, tuple[pa.DataType, dict[str, Any]]]) -> pa.Schema:
    """With the metadata that tells Hugging Face which column is an image."""
    features = {name: feature for name, (_, feature) in columns.items()}
    notes = {**NOTES, "huggingface": json.dumps({"info": {"features": features}})}
    return pa.schema([(name, kind) for name, (kind, _) in columns.items()], metadata=notes)


def write_pairs(path: Path, pairs: Iterable[Pair]) -> None:
    """One file of pairs, whole or not at all; raises `FileNotWritten`."""
    rows = [{name.name: getattr(pair, name.name) for name in fields(pair)} for pair in pairs]
    write(path, [{**row, "image": stored(row["image"])} for row in rows], COLUMNS)


def write_references(path: Path, references: Iterable[tuple[str, bytes]]) -> None:
    """The untouched image of every sensor."""
    rows = [{"reference": name, "image": stored(image), "sensor": name} for name, image in references]
    write(path, rows, REFERENCE_COLUMNS)


def stored(image: bytes) -> dict[str, Any]:
    """An image as Hugging Face stores it."""
    return {"bytes": image, "path": None}


def write(path: Path, rows: list[dict[str, Any]], columns: dict[str, tuple[pa.DataType, dict[str, Any]]]) -> None:
    """Rows as Parquet. Images are compressed already; 100 rows a group let a reader pick."""
    table = pa.Table.from_pylist(rows, schema=schema(columns))
    with open_atomic_file(path) as file:
        pq.write_table(table, file, row_group_size=100, compression="snappy")


def wrenches(paths: Iterable[Path]) -> tuple[Float[Array, "n 6"], Array]:
    """All wrenches and kinds of these files."""
    table = pa.concat_tables([pq.read_table(path, columns=["wrench", "kind"]) for path in paths])
    six = table["wrench"].combine_chunks().flatten().to_numpy(zero_copy_only=False).reshape(-1, 6)
    return np.asarray(six, float), np.asarray(table["kind"].to_pylist())

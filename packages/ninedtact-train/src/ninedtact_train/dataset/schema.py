"""The schema of a data set: its columns, what they mean, and the rows and reference images that are stored in them.

A new column is one entry of `PAIR_COLUMNS` and one field of the same name in `DatasetRow`. The Parquet files, the columns that
readers require and the table of columns in README.md follow from that list. `DATASET_FORMAT` is raised when a column changes
its name or meaning; a data set of another format is refused.
"""

import json
from dataclasses import dataclass, fields
from typing import Any

import pyarrow as pa
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.quantities import NO_OBJECT
from ninedtact_train.dataset.fault_report import PairFault

DATASET_FORMAT = 2
"""Stored in the metadata of every Parquet file and in settings.json."""
FORMAT_KEY = b"ninedtact.format"


@dataclass(frozen=True)
class Column:
    """One column: its Arrow type, its Hugging Face feature, and its meaning in README.md."""

    name: str
    arrow_type: Any
    feature: dict[str, Any]
    meaning: str


def _value_column(name: str, dtype: str, meaning: str) -> Column:
    """Return a column of strings or plain numbers."""
    arrow_type = pa.string() if dtype == "string" else pa.type_for_alias(dtype)
    return Column(name, arrow_type, {"dtype": dtype, "_type": "Value"}, meaning)


_IMAGE_STRUCT = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
_WRENCH_FEATURE = {"feature": {"dtype": "float32", "_type": "Value"}, "length": 6, "_type": "Sequence"}
_WRENCH_MEANING = "Fx Fy Fz in N, Tx Ty Tz in N·m, of the object on the skin: pressing gives Fz < 0"

PAIR_COLUMNS = (
    _value_column("id", "string", "unique id of the pair"),
    Column("image", _IMAGE_STRUCT, {"_type": "Image"}, "rectified image of the sensor, grey, PNG"),
    _value_column("reference_id", "string", "id of the reference image (no contact), in config `references`"),
    Column("wrench", pa.list_(pa.float32(), 6), _WRENCH_FEATURE, _WRENCH_MEANING),
    _value_column("object", "string", f"object that touches the skin; `{NO_OBJECT}` without contact"),
    _value_column(
        "contact_id", "string", "shared by the pairs of one continuous contact; a split should not divide them"
    ),
    _value_column("step", "int32", "number of the pair within its contact or session"),
    _value_column("time_ns", "int64", "time of the image in ns; empty if unknown"),
    _value_column("sensor", "string", "name of the sensor"),
    _value_column(
        "kind",
        "string",
        "`rule`: kept by the paper's sampling rule; `light_touch`; `no_contact`; `stream`: every image of an episode",
    ),
    _value_column("source", "string", "name of the source that the pair was read from; empty in a generated data set"),
    _value_column("mm_per_px", "float32", "scale of the image in mm per pixel; empty if unknown"),
    _value_column("wrench_delay_ms", "float32", "time from image to wrench in ms; empty if unknown"),
)
"""All columns of the files in `data/`, in the order of `DatasetRow`."""

REFERENCE_COLUMNS = tuple(column for column in PAIR_COLUMNS if column.name in ("image", "reference_id", "sensor"))
"""All columns of `references.parquet`."""


@dataclass(frozen=True)
class DatasetRow:
    """One pair of image and wrench; its fields are the columns of `PAIR_COLUMNS`."""

    id: str
    image: bytes
    """The image as a grey PNG file."""
    reference_id: str | None
    wrench: Float32[Array, "6"]
    """The wrench, N and N·m about the skin's centre."""
    object: str
    contact_id: str
    step: int
    time_ns: int | None
    sensor: str
    kind: str
    source: str | None
    mm_per_px: float | None = None
    wrench_delay_ms: float | None = None
    faults: tuple[tuple[PairFault, str], ...] = ()
    """Faults that were found while the source was read, each with a message; not a column."""


@dataclass(frozen=True)
class ReferenceImage:
    """An image of a sensor without contact, which the images of the same sensor are compared with."""

    id: str
    image: bytes
    """The image as a grey PNG file."""
    sensor: str


@dataclass(frozen=True)
class RejectedItem:
    """An item of a source that cannot become a pair."""

    fault: PairFault
    id: str
    message: str


SourceItem = DatasetRow | ReferenceImage | RejectedItem
"""An item that a source yields; a reference image comes before the rows that name it."""


def arrow_schema(columns: tuple[Column, ...]) -> pa.Schema:
    """Return the Arrow schema of these columns, with the metadata by which Hugging Face `datasets` recognises images."""
    features = {column.name: column.feature for column in columns}
    metadata = {
        FORMAT_KEY: str(DATASET_FORMAT).encode(),
        b"ninedtact.wrench": (
            f"{_WRENCH_MEANING}; torque about the centre of the skin without contact; x along columns, y along rows, z outward"
        ).encode(),
        b"huggingface": json.dumps({"info": {"features": features}}).encode(),
    }
    return pa.schema([(column.name, column.arrow_type) for column in columns], metadata=metadata)


def row_to_columns(row: DatasetRow) -> dict[str, Any]:
    """Return the column values of a row, with text as UTF-8 can store it."""
    values = {field.name: getattr(row, field.name) for field in fields(row) if field.name != "faults"}
    values = {name: escape_invalid_utf8(value) if isinstance(value, str) else value for name, value in values.items()}
    return {**values, "image": {"bytes": row.image, "path": None}}


def reference_to_columns(reference: ReferenceImage) -> dict[str, Any]:
    """Return the column values of a reference image."""
    return {
        "reference_id": escape_invalid_utf8(reference.id),
        "image": {"bytes": reference.image, "path": None},
        "sensor": escape_invalid_utf8(reference.sensor),
    }


def escape_invalid_utf8(text: str) -> str:
    """Return text that UTF-8 can store: the bytes of a file name that are not UTF-8 become escape sequences."""
    return text.encode(errors="backslashreplace").decode()

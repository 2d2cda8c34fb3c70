"""The schema of a data set: its columns, what they mean, and the rows and reference images that are stored in them.

A new column is one entry of `PAIR_COLUMNS` and one field of the same name in `DatasetRow`. The Parquet files, the columns that
readers require and the table of columns in README.md follow from that list. `DATASET_FORMAT` is raised when a column changes
its name or meaning; a data set of another format is refused.
"""

from dataclasses import dataclass

from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.quantities import NO_OBJECT
from ninedtact_train.dataset.fault_report import PairFault, PairFinding

DATASET_FORMAT = 2
"""Stored in the metadata of every Parquet file and in settings.json."""
FORMAT_KEY = b"ninedtact.format"


@dataclass(frozen=True)
class Column:
    """One column, its kind and its meaning in README.md."""

    name: str
    kind: str
    """`image` (a PNG file), `wrench` (six float32), or a type of Arrow and NumPy."""
    meaning: str


WRENCH_MEANING = "Fx Fy Fz in N, Tx Ty Tz in N·m, of the object on the skin: pressing gives Fz < 0"
_IMAGE = Column("image", "image", "rectified image of the sensor, grey, PNG")
_REFERENCE_ID = Column("reference_id", "string", "id of the reference image (no contact), in config `references`")
_SENSOR = Column("sensor", "string", "name of the sensor")
PAIR_COLUMNS = (
    Column("id", "string", "unique id of the pair"),
    _IMAGE,
    _REFERENCE_ID,
    Column("wrench", "wrench", WRENCH_MEANING),
    Column("object", "string", f"object that touches the skin; `{NO_OBJECT}` without contact"),
    Column("contact_id", "string", "shared by the pairs of one continuous contact; a split should not divide them"),
    Column("step", "int32", "number of the pair within its contact or session"),
    Column("time_ns", "int64", "time of the image in ns; empty if unknown"),
    _SENSOR,
    Column(
        "kind",
        "string",
        "`rule`: kept by the paper's sampling rule; `light_touch`; `no_contact`; `stream`: every image of an episode",
    ),
    Column("source", "string", "name of the source that the pair was read from; empty in a generated data set"),
    Column("mm_per_px", "float32", "scale of the image in mm per pixel; empty if unknown"),
    Column("wrench_delay_ms", "float32", "time from image to wrench in ms; empty if unknown"),
)
"""All columns of the files in `data/`, in the order of `DatasetRow`."""
REFERENCE_COLUMNS = (_IMAGE, _REFERENCE_ID, _SENSOR)
"""All columns of `references.parquet`."""


TRUTH_COLUMNS = (
    Column("motion", "string", "kind of the motion of the whole sequence"),
    Column("friction", "float32", "true friction coefficient"),
    Column("x_mm", "float32", "true position of the object along x"),
    Column("y_mm", "float32", "the same along y"),
    Column("depth_mm", "float32", "true depth of the object's origin below the undeformed skin; negative above it"),
    Column("twist_deg", "float32", "true turn of the object about z"),
    Column("tilt_y_deg", "float32", "true tilt of the object about y"),
    Column("slip", "string", "true state: `static`, `incipient`, `gross`, or `unknown` without contact"),
    Column("sticking_share", "float32", "true share of the contact's area that sticks"),
    Column("slip_speed_mm_s", "float32", "true mean speed of the object over the skin"),
)
"""Further columns of a data set of sequences, in the order of `MotionTruth`."""


@dataclass(frozen=True)
class MotionTruth:
    """What a twin knows of one image of a sequence; its fields are the columns of `TRUTH_COLUMNS`."""

    motion: str
    friction: float
    x_mm: float
    y_mm: float
    depth_mm: float
    twist_deg: float
    tilt_y_deg: float
    slip: str
    sticking_share: float
    slip_speed_mm_s: float


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

    reference_id: str
    image: bytes
    """The image as a grey PNG file."""
    sensor: str


SourceItem = DatasetRow | ReferenceImage | PairFinding
"""An item that a source yields: a pair, a reference image (before the rows that name it), or a finding, which becomes no pair."""

"""The metadata record at the beginning of a recording: sensor, sources, settings, clocks and format number.

Stamps in the package and the log times of the messages are those of the monotonic clock; `header.stamp` is on the wall clock, as
other programs expect. The difference of the two clocks is stored once per recording.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from secrets import token_hex
from typing import Annotated, Literal

import msgspec
from mcap.records import Metadata
from msgspec import Meta

from ninedtact._version import __version__
from ninedtact.checked_reading import CHECKSUM_KEY, mapping_checksum
from ninedtact.errors import OutputError, printable_text
from ninedtact.recording.errors import RecordingUnreadable

REPAIR_RECORD = "ninedtact_repair"
"""Name of the metadata record of a file that was cut short and completed later."""
METADATA_RECORD = "ninedtact"
"""Name of the metadata record."""
RECORDING_FORMAT = 3
"""Format number; recordings of other formats are refused. 3: storage of images and heights, and the camera delay, are stated."""
ImageStorage = Literal["zstd", "png"]
"""How images are stored, both without loss: raw in chunks that zstd compresses, or each as a PNG."""
LATEST_NS = 1 << 62
"""Greatest difference of two clocks; a stamp and it remain within 64 bits."""
HEIGHT_STEP_16_BIT_MM = 0.001
"""Quantisation step of heights of 16 bits: a twentieth of the noise of one pixel; they reach ±32 mm."""


def wall_minus_monotonic_ns() -> int:
    """Return how far the wall clock is ahead of the monotonic clock now."""
    return time.time_ns() - time.monotonic_ns()


def wall_time_ns(stamp_ns: int) -> int:
    """Return the wall time of a monotonic stamp, as the clocks are now."""
    return stamp_ns + wall_minus_monotonic_ns()


@dataclass(frozen=True)
class RecordingMetadata:
    """The data that apply to a whole recording of a sensor: one run of one program; several sensors have one each."""

    sensor: str
    """Name of the tactile sensor, as in its sensor.toml."""
    purpose: str = "record"
    """The command that made the recording."""
    source: str = ""
    """Where the images came from, in words."""
    force_torque: str = ""
    """Where the measured wrenches came from, in words."""
    settings: str = "{}"
    """The resolved settings of the command, JSON."""
    mm_per_px: Annotated[float, Meta(ge=0, le=1e3)] = 0.0
    """Scale of the height maps, where there are any."""
    images: ImageStorage = "zstd"
    height_step_mm: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Quantisation step of heights that are stored as integers of 16 bits; 0 for 32-bit floating point."""
    camera_delay_ms: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0
    """Delay of the camera that was subtracted from the arrival times of its images; their stamps are times of exposure then."""
    name: Annotated[str, Meta(pattern=r"^\w*$")] = ""
    """Name of the sensor among several of one recording, such as left; empty in a recording of one sensor."""
    estimate_notices: str = ""
    """What a person must know of every recorded estimate, in words, such as the error of an unknown gel."""
    software: str = __version__
    """Version of the package that made the recording."""
    id: str = field(default_factory=lambda: f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{token_hex(2)}")
    wall_minus_monotonic_ns: Annotated[int, Meta(ge=-LATEST_NS, le=LATEST_NS)] = field(
        default_factory=wall_minus_monotonic_ns
    )

    @property
    def topic_name(self) -> str:
        """The name of the sensor in topics: its name among several, or its id."""
        return self.name or self.sensor

    def wall_ns(self, stamp_ns: int) -> int:
        """Return the wall time of a monotonic stamp."""
        return stamp_ns + self.wall_minus_monotonic_ns

    def to_mcap_metadata(self) -> dict[str, str]:
        """Return the format number and all fields as strings by name, as MCAP keeps them, with their checksum; no empty name."""
        stated = {
            name: printable_text(str(value)) for name, value in asdict(self).items() if name not in _ABSENT or value
        }
        values = {"format": str(RECORDING_FORMAT), **stated}
        return {**values, CHECKSUM_KEY: mapping_checksum(values)}


_ABSENT = {"name": "", "estimate_notices": ""}
"""Fields that are not stored where they are empty."""


def parse_recording_metadata(metadata: Mapping[str, str], name: str) -> RecordingMetadata:
    """Return the metadata of a recording; raises `RecordingUnreadable` for another format or missing fields."""
    try:
        version = int(metadata["format"])
    except (KeyError, ValueError) as error:
        raise RecordingUnreadable(
            expected=f"{name} to state its format", got=str(error), remedy="record it again"
        ) from error
    if version != RECORDING_FORMAT:
        remedy = "update ninedtact" if version > RECORDING_FORMAT else "record it again"
        age = "a newer" if version > RECORDING_FORMAT else "an older"
        raise RecordingUnreadable(
            expected=f"{name} in format {RECORDING_FORMAT}",
            got=f"format {version} from {age} ninedtact",
            remedy=remedy,
        )
    if metadata.get(CHECKSUM_KEY) not in (None, mapping_checksum(metadata)):
        raise RecordingUnreadable(
            expected=f"the description of {name} as it was written",
            got="other values than its checksum",
            remedy="restore it from a copy",
        )
    stated = {**_ABSENT, **metadata}
    missing = [entry.name for entry in fields(RecordingMetadata) if entry.name not in stated]
    try:
        if missing:
            raise ValueError(f"no {', no '.join(missing)}")
        return msgspec.convert(stated, RecordingMetadata, strict=False)
    except ValueError as error:
        raise RecordingUnreadable(
            expected=f"{name} to state what was recorded", got=str(error), remedy="record it again"
        ) from error


def parse_sensor_metadata(records: Sequence[Metadata], path: Path) -> tuple[RecordingMetadata, ...]:
    """Return the metadata of every sensor from the metadata records of a file; raises `RecordingUnreadable`."""
    found = tuple(parse_recording_metadata(one.metadata, str(path)) for one in records if one.name == METADATA_RECORD)
    if not found:
        raise RecordingUnreadable(
            expected=f"a recording of ninedtact in {path}",
            got="an MCAP file of another program, or one that was cut short before it began",
            remedy="record with 'ninedtact record'",
        )
    if len({one.name for one in found}) < len(found):
        raise RecordingUnreadable(
            expected=f"a name of its own for each sensor in {path}",
            got="two sensors of the same name",
            remedy="restore it from a copy",
        )
    return found


def choose_sensor_metadata(found: tuple[RecordingMetadata, ...], name: str, path: Path) -> RecordingMetadata:
    """Return the metadata of the sensor that is named, or of the only one; raises `RecordingUnreadable`."""
    chosen = [one for one in found if one.name == name or (not name and len(found) == 1)]
    if not chosen:
        names = ", ".join(one.name for one in found if one.name)
        has = f"one of the sensors {names} of {path}" if names else f"no name of a sensor with {path}, which holds one"
        remedy = f"name it as {path}#{found[0].name}" if names else "drop it"
        raise RecordingUnreadable(expected=has, got=repr(name) if name else "none", remedy=remedy)
    return chosen[0]


def require_recordable_metadata(metadata: RecordingMetadata) -> None:
    """Raise `OutputError` for metadata with which a recording could not be read again."""
    try:
        parse_recording_metadata(metadata.to_mcap_metadata(), "the recording")
    except RecordingUnreadable as unreadable:
        raise OutputError(
            expected="options with which a recording can be read", got=str(unreadable.__cause__), remedy="correct them"
        ) from unreadable

"""The metadata record at the beginning of a recording: sensor, sources, settings, clocks and format number.

Stamps in the package and the log times of the messages are those of the monotonic clock; `header.stamp` is on the wall clock, as
other programs expect. The difference of the two clocks is stored once per recording.
"""

import re
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from math import isfinite
from secrets import token_hex
from typing import Any, Literal, get_args

from ninedtact._version import __version__
from ninedtact.checked_reading import CHECKSUM_KEY, mapping_checksum
from ninedtact.recording.errors import RecordingRefused, RecordingUnreadable

REPAIR_RECORD = "ninedtact_repair"
"""Name of the metadata record of a file that was cut short and completed later."""
METADATA_RECORD = "ninedtact"
"""Name of the metadata record."""
RECORDING_FORMAT = 3
"""Format number; recordings of other formats are refused. 3: storage of images and heights, and the camera delay, are stated."""
ImageStorage = Literal["zstd", "png"]
"""How images are stored, both without loss: raw in chunks that zstd compresses, or each as a PNG."""
HEIGHT_STEP_16_BIT_MM = 0.001
"""Quantisation step of heights of 16 bits: a twentieth of the noise of one pixel; they reach ±32 mm."""


_NUMBERS = ("mm_per_px", "height_step_mm", "camera_delay_ms")
"""Fields that are floating point numbers."""


def wall_minus_monotonic_ns() -> int:
    """Return how far the wall clock is ahead of the monotonic clock now."""
    return time.time_ns() - time.monotonic_ns()


def wall_time_ns(stamp_ns: int) -> int:
    """Return the wall time of a monotonic stamp, as the clocks are now."""
    return stamp_ns + wall_minus_monotonic_ns()


def _new_recording_id() -> str:
    return f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{token_hex(2)}"


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
    mm_per_px: float = 0.0
    """Scale of the height maps, where there are any."""
    images: ImageStorage = "zstd"
    height_step_mm: float = 0.0
    """Quantisation step of heights that are stored as integers of 16 bits; 0 for 32-bit floating point."""
    camera_delay_ms: float = 0.0
    """Delay of the camera that was subtracted from the arrival times of its images; their stamps are times of exposure then."""
    name: str = ""
    """Name of the sensor among several of one recording, such as left; empty in a recording of one sensor."""
    software: str = __version__
    """Version of the package that made the recording."""
    id: str = field(default_factory=_new_recording_id)
    wall_minus_monotonic_ns: int = field(default_factory=wall_minus_monotonic_ns)

    @property
    def topic_name(self) -> str:
        """The name of the sensor in topics: its name among several, or its id."""
        return self.name or self.sensor

    def wall_ns(self, stamp_ns: int) -> int:
        """Return the wall time of a monotonic stamp."""
        return stamp_ns + self.wall_minus_monotonic_ns

    def to_mcap_metadata(self) -> dict[str, str]:
        """Return the format number and all fields as strings by name, as MCAP keeps them, with their checksum; no empty name."""
        stated = {name: str(value) for name, value in asdict(self).items() if name != "name" or value}
        values = {"format": str(RECORDING_FORMAT), **stated}
        return {**values, CHECKSUM_KEY: mapping_checksum(values)}


def parse_recording_metadata(metadata: Mapping[str, str], name: str) -> RecordingMetadata:
    """Return the metadata of a recording; raises `RecordingUnreadable` for another format or missing fields."""
    try:
        version = int(metadata["format"])
    except (KeyError, ValueError) as error:
        raise RecordingUnreadable(f"expected {name} to state its format, got {error}; record it again") from error
    if version != RECORDING_FORMAT:
        remedy = "update ninedtact" if version > RECORDING_FORMAT else "record it again"
        age = "a newer" if version > RECORDING_FORMAT else "an older"
        raise RecordingUnreadable(
            f"expected {name} in format {RECORDING_FORMAT}, got format {version} from {age} ninedtact; {remedy}"
        )
    if metadata.get(CHECKSUM_KEY) not in (None, mapping_checksum(metadata)):
        raise RecordingUnreadable(
            f"expected the description of {name} as it was written, got other values than its checksum; restore it from a copy"
        )
    try:
        stated = {"name": "", **metadata}
        values: dict[str, Any] = {entry.name: stated[entry.name] for entry in fields(RecordingMetadata)}
        values |= {name: _finite_float(values[name]) for name in _NUMBERS}
        values["wall_minus_monotonic_ns"] = int(values["wall_minus_monotonic_ns"])
        if values["images"] not in get_args(ImageStorage):
            raise ValueError(f"images stored as {values['images']!r}")
        if values["height_step_mm"] < 0:
            raise ValueError(f"heights in steps of {values['height_step_mm']:g} mm")
        if re.fullmatch(r"\w*", values["name"]) is None:
            raise ValueError(f"a sensor of the name {values['name']!r}")
    except (KeyError, ValueError) as error:
        raise RecordingUnreadable(
            f"expected {name} to state what was recorded, got {error}; record it again"
        ) from error
    return RecordingMetadata(**values)


def require_recordable_metadata(metadata: RecordingMetadata) -> None:
    """Raise `RecordingRefused` for metadata with which a recording could not be read again."""
    try:
        parse_recording_metadata(metadata.to_mcap_metadata(), "the recording")
    except RecordingUnreadable as unreadable:
        raise RecordingRefused(
            f"expected options with which a recording can be read, got {unreadable.__cause__}; correct them"
        ) from unreadable


def _finite_float(text: str) -> float:
    """Return the number; raises `ValueError`, also for one that is not finite."""
    number = float(text)
    if not isfinite(number):
        raise ValueError(f"the number {text}")
    return number

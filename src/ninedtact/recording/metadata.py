"""What is said once about an episode, in a metadata record at its beginning.

Stamps in the package are those of the monotonic clock; those in the file are on the wall clock, which other programs show. The
difference of the two is noted once: taking it off gives the monotonic stamp back, to the nanosecond.
"""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from secrets import token_hex

from ninedtact.recording.errors import RecordingUnreadable

METADATA_RECORD = "ninedtact"
"""Name of the metadata record."""
RECORDING_FORMAT = 1
"""Rises when an older program could no longer read an episode."""


def wall_minus_monotonic_ns() -> int:
    """How far the wall clock is ahead of the monotonic clock now."""
    return time.time_ns() - time.monotonic_ns()


def new_recording_id() -> str:
    """A name that no other episode has."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{token_hex(2)}"


@dataclass(frozen=True)
class RecordingMetadata:
    """One run of one program with one sensor."""

    sensor: str
    """Name of the tactile sensor, as in its sensor.toml."""
    purpose: str = "record"
    """The command that made it."""
    source: str = ""
    """What the images came from, in words."""
    force_torque: str = ""
    """What the measured wrenches came from, in words."""
    settings: str = "{}"
    """The command's resolved settings, JSON."""
    mm_per_px: float = 0.0
    """Of the height maps, where there are any."""
    software: str = ""
    id: str = field(default_factory=new_recording_id)
    wall_minus_monotonic_ns: int = field(default_factory=wall_minus_monotonic_ns)

    def wall_ns(self, stamp_ns: int) -> int:
        """A monotonic stamp on the wall clock."""
        return stamp_ns + self.wall_minus_monotonic_ns

    def as_metadata(self) -> dict[str, str]:
        """Words by name, as MCAP keeps them."""
        return {"format": str(RECORDING_FORMAT), **{name: str(value) for name, value in asdict(self).items()}}


def parse_recording_metadata(metadata: Mapping[str, str], name: str) -> RecordingMetadata:
    """The session that a file tells of; raises `RecordingUnreadable`."""
    try:
        version = int(metadata["format"])
        words = {entry.name: metadata[entry.name] for entry in fields(RecordingMetadata)}
        mm_per_px, ahead_ns = float(words.pop("mm_per_px")), int(words.pop("wall_minus_monotonic_ns"))
    except (KeyError, ValueError) as trouble:
        raise RecordingUnreadable(
            f"expected {name} to say what was recorded, got {trouble}; record it again"
        ) from trouble
    if version > RECORDING_FORMAT:
        raise RecordingUnreadable(
            f"expected {name} in format {RECORDING_FORMAT} or older, got format {version} from a newer ninedtact; update ninedtact"
        )
    return RecordingMetadata(**words, mm_per_px=mm_per_px, wall_minus_monotonic_ns=ahead_ns)

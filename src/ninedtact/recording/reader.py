"""An episode on disk: its nouns again, whether the file was finished or cut short.

The sensor's folder rides along in an episode: whoever has the file has the calibration.
"""

import struct
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import BinaryIO

import numpy as np
from jaxtyping import Float32, Int64
from mcap.exceptions import McapError
from mcap.records import Attachment, Metadata
from numpy import ndarray as Array

from ninedtact.capture.frame_source import CameraNotFound
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.mcap_index import (
    PLACE,
    McapIndex,
    StoredMessage,
    chunk_at,
    damaged,
    index_mcap_records,
    message_at,
    read_outer_chunks,
    stream_of,
)
from ninedtact.recording.metadata import METADATA_RECORD, RecordingMetadata, parse_recording_metadata
from ninedtact.recording.ros_messages import (
    PairLabel,
    RecordingEvent,
    Topic,
    event_of,
    height_of,
    image_of,
    pair_of,
    wrench_of,
)


class Recording:
    """One recording, open for reading (`with`). One thread at a time."""

    def __init__(self, path: Path | str) -> None:
        """Open and survey it; raises `CameraNotFound` or `RecordingUnreadable`."""
        self.path = Path(path)
        self._file = opened(self.path)
        self._chunk: tuple[int, bytes] = (-1, b"")
        try:
            self.scan, self.session = surveyed(self._file, str(self.path))
        except BaseException:
            self._file.close()
            raise

    @cached_property
    def _channels(self) -> dict[str, int]:
        return {channel.topic: number for number, channel in self.scan.channels.items()}

    @property
    def finished(self) -> bool:
        """Whether it was closed in order; if not, its last half second may be missing."""
        return self.scan.finished

    def places(self, topic: Topic) -> Array:
        """`PLACE` of the topic's messages, in the order of writing."""
        parts = self.scan.places.get(self._channels.get(topic, -1), [])
        return np.concatenate(parts) if parts else np.empty(0, PLACE)

    def stamps_ns(self, topic: Topic) -> Int64[Array, " n"]:
        """When the topic's messages were, monotonic clock."""
        return np.asarray(self.places(topic)["wall_ns"] - self.session.wall_minus_monotonic_ns)

    def message(self, place: np.void) -> StoredMessage:
        """The message at one `PLACE`; raises `RecordingUnreadable` where the file is damaged."""
        number = int(place["chunk"])
        span = self.scan.chunks[number]
        if self._chunk[0] != number:
            self._chunk = number, chunk_at(self._file, span, str(self.path)).data
        try:
            message = message_at(self._chunk[1], int(place["offset"]))
        except (ValueError, IndexError, struct.error) as trouble:
            raise damaged(str(self.path), span.end) from trouble
        if message.wall_ns != place["wall_ns"] or message.channel != place["channel"]:
            raise damaged(str(self.path), span.end)
        return message

    def messages(self, topic: Topic) -> Iterator[StoredMessage]:
        """All messages of a topic."""
        return map(self.message, self.places(topic))

    def stamp_ns(self, message: StoredMessage) -> int:
        """When it was, monotonic clock."""
        return message.wall_ns - self.session.wall_minus_monotonic_ns

    def frame(self, place: np.void) -> Frame:
        """One image as it was read, its stamp and index too."""
        message = self.message(place)
        return Frame(image_of(message.data), self.stamp_ns(message), message.sequence)

    def frames(self, topic: Topic = Topic.IMAGES) -> Iterator[Frame]:
        """All images."""
        return map(self.frame, self.places(topic))

    def wrench(self, place: np.void) -> Wrench:
        """One wrench, about the skin's centre."""
        message = self.message(place)
        return wrench_of(message.data, self.stamp_ns(message))

    def wrenches(self, topic: Topic = Topic.MEASURED) -> Iterator[Wrench]:
        """All wrenches of a topic."""
        return map(self.wrench, self.places(topic))

    def heights(self) -> Iterator[tuple[int, Float32[Array, "rows cols"]]]:
        """Number of the image, and heights in mm."""
        return ((message.sequence, height_of(message.data)) for message in self.messages(Topic.HEIGHTS))

    def pairs(self) -> Iterator[PairLabel]:
        """What was marked, undone contacts included."""
        return (pair_of(message.data, self.stamp_ns(message)) for message in self.messages(Topic.PAIRS))

    def events(self) -> list[RecordingEvent]:
        """What else happened."""
        return [event_of(message.data, self.stamp_ns(message)) for message in self.messages(Topic.EVENTS)]

    def attachments(self) -> Iterator[Attachment]:
        """The files that ride along."""
        return (Attachment.read(stream_of(self._file, span)) for span in self.scan.attachments)

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def opened(path: Path) -> BinaryIO:
    """The file; raises `CameraNotFound` where there is none, and `RecordingUnreadable`."""
    if not path.is_file():
        raise CameraNotFound(f"expected a recording at {path}, got no such file; check the path")
    try:
        return path.open("rb")
    except OSError as trouble:
        raise RecordingUnreadable(
            f"expected to read {path}, got: {trouble.strerror}; check its permissions"
        ) from trouble


def surveyed(file: BinaryIO, name: str) -> tuple[McapIndex, RecordingMetadata]:
    """Structure and session of a file; raises `RecordingUnreadable`."""
    try:
        found = index_mcap_records(file, name)
        session = session_in(found, file, name)
        read_outer_chunks(found, file, name)
    except (McapError, ValueError, IndexError, MemoryError, struct.error) as trouble:
        raise RecordingUnreadable(
            f"expected a recording in {name}, got a damaged file ({trouble}); restore it from a copy"
        ) from trouble
    return found, session


def session_in(found: McapIndex, file: BinaryIO, name: str) -> RecordingMetadata:
    """What the file says about itself; raises `RecordingUnreadable`."""
    for span in found.metadata:
        record = Metadata.read(stream_of(file, span))
        if record.name == METADATA_RECORD:
            return parse_recording_metadata(record.metadata, name)
    raise RecordingUnreadable(
        f"expected a recording of ninedtact in {name}, got an MCAP file of another program, or one that was cut short "
        "before it began; record with 'ninedtact record'"
    )


FOLDER = "sensor"
"""What the names of its attachments begin with."""


def sensor_folder_attachments(folder: Path) -> dict[str, bytes]:
    """The files of a sensor folder by the names that they have in an episode."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {f"{FOLDER}/{path.relative_to(folder).as_posix()}": path.read_bytes() for path in files}


def restore_sensor_folder(recording: Path | str, into: Path) -> Path:
    """Write the sensor folder that a recording carries; raises `RecordingUnreadable` where it carries none."""
    with Recording(recording) as episode:
        copied = [write_copy(into, attachment.name, attachment.data) for attachment in episode.attachments()]
    if not any(copied):
        raise RecordingUnreadable(
            f"expected {recording} to carry its sensor's folder, got a recording without; name one with --sensor"
        )
    return into


def write_copy(into: Path, name: str, content: bytes) -> bool:
    """Write one file of the sensor folder; whether it belongs there. Names that lead elsewhere do not."""
    way = PurePosixPath(name)
    if way.parts[:1] != (FOLDER,) or len(way.parts) < 2 or ".." in way.parts or way.is_absolute():
        return False
    path = into.joinpath(*way.parts[1:])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return True

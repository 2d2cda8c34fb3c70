"""A file that only grows, by whole records: whatever stops it, what stands in it can be read.

Writing an episode: one MCAP file that is good up to the last half second, however the program ends.
"""

import os
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, monotonic_ns
from types import TracebackType

import numpy as np
from mcap.writer import CompressionType, Writer

from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame, HeightMap, Wrench
from ninedtact.recording.mcap_repair import repair_recording
from ninedtact.recording.metadata import METADATA_RECORD, RecordingMetadata
from ninedtact.recording.ros_messages import (
    TYPES,
    EventKind,
    PairLabel,
    RecordingEvent,
    Topic,
    camera_image_message,
    definition,
    event_message,
    height_message,
    pair_message,
    wrench_message,
)


class RecordingRefused(NinedtactError):
    """An episode cannot be begun there."""


class RecordingStopped(NinedtactError):
    """Nothing more can be written; what was written is kept."""


class RecordFile:
    """The output of an MCAP writer, which hands over whole records with every write; nothing waits in this process.

    Not synced to the disk: it outlives the program, not a power cut.
    """

    def __init__(self, path: Path) -> None:
        """Begin a new file; raises `RecordingRefused`."""
        self.path, self._end = path, 0
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError as trouble:
            raise RecordingRefused(f"expected a new file to record to, got {path}; choose another name") from trouble
        except OSError as trouble:
            raise RecordingRefused(
                f"expected to begin {path}, got: {trouble.strerror}; correct the path and its permissions"
            ) from trouble

    def write(self, records: bytes) -> int:
        """Append whole records, or none of them; raises `RecordingStopped`."""
        left = memoryview(records)
        try:
            while left:
                left = left[os.write(self._file, left) :]
        except BaseException as trouble:
            os.ftruncate(self._file, self._end)
            os.lseek(self._file, self._end, os.SEEK_SET)
            if isinstance(trouble, OSError):
                raise RecordingStopped(stopped(self.path, trouble)) from trouble
            raise
        self._end += len(records)
        return len(records)

    def tell(self) -> int:
        """Where the next record will stand."""
        return self._end

    def flush(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        """Let go of the file; its number may soon be another file's."""
        descriptor, self._file = self._file, -1
        os.close(descriptor)


def stopped(path: Path, trouble: OSError) -> str:
    """What is said when the disk takes no more."""
    return (
        f"expected to write on to {path}, got: {trouble.strerror}; what was recorded until then is kept: free the disk, and "
        "record on under another name"
    )


CHUNK_BYTES = 2**19
"""Less than an image: whatever is written before an image is on disk with it."""
LONGEST_WAIT_S = 0.5
"""After which what was written is handed to the system, whatever its size."""


class RecordingWriter:
    """Writes an episode while it is open (`with`). One thread at a time.

    Images are stored as they are (bgr8) in chunks that zstd compresses without loss (docs/recording.md has the figures).
    """

    def __init__(
        self,
        path: Path | str,
        session: RecordingMetadata,
        topics: Collection[Topic] = tuple(Topic),
        attached: Mapping[str, bytes] | None = None,
    ) -> None:
        """topics: those that will be written to. attached: files that ride along, by name."""
        self.path, self.session = Path(path), session
        self.written: Counter[Topic] = Counter()
        self.dropped = 0
        """Images that the source counted and nobody wrote."""
        self._topics = {*topics, Topic.EVENTS}
        self._attached = dict(attached or {})
        self._next_index: int | None = None
        self._between_records = True

    def __enter__(self) -> "RecordingWriter":
        """Begin the file; raises `RecordingRefused` or `RecordingStopped`."""
        self._file = RecordFile(self.path)
        self._writer = Writer(self._file, CHUNK_BYTES, CompressionType.ZSTD)  # type: ignore[arg-type]
        try:
            self._begin()
        except BaseException:
            self._file.close()
            self.path.unlink()
            raise
        self._flushed_at = monotonic()
        return self

    def image(self, frame: Frame) -> None:
        """An image as it was read, and how many are missing before it."""
        missing = 0 if self._next_index is None else frame.index - self._next_index
        self._next_index = frame.index + 1
        if missing > 0:
            self.dropped += missing
            self.event(RecordingEvent(frame.stamp_ns, EventKind.DROPPED, str(missing)))
        self.kept_image(frame)

    def kept_image(self, frame: Frame) -> None:
        """An image that was chosen among many: those between are not missing."""
        wall_ns = self.session.wall_ns(frame.stamp_ns)
        self._add(Topic.IMAGES, wall_ns, camera_image_message(frame.image, wall_ns), frame.index)

    def untouched(self, frame: Frame, tare: int) -> None:
        """An image of the untouched skin, of this tare."""
        wall_ns = self.session.wall_ns(frame.stamp_ns)
        self._add(Topic.UNTOUCHED, wall_ns, camera_image_message(frame.image, wall_ns), tare)

    def measured(self, wrench: Wrench) -> None:
        """What the force/torque sensor told."""
        self._wrench(Topic.MEASURED, wrench)

    def estimated(self, wrench: Wrench) -> None:
        """What was estimated from an image."""
        self._wrench(Topic.ESTIMATED, wrench)

    def height(self, height: HeightMap, index: int) -> None:
        """The heights of the image of this number, NaN out of view."""
        wall_ns = self.session.wall_ns(height.stamp_ns)
        z_mm = np.where(height.in_view, height.z_mm, np.float32(np.nan))
        self._add(Topic.HEIGHTS, wall_ns, height_message(z_mm, wall_ns), index)

    def pair(self, mark: PairLabel) -> None:
        """That an image was saved as a pair; on disk when this returns."""
        wall_ns = self.session.wall_ns(mark.stamp_ns)
        self._add(Topic.PAIRS, wall_ns, pair_message(mark, wall_ns))
        self.flush()

    def event(self, event: RecordingEvent) -> None:
        """Something that happened; on disk when this returns."""
        wall_ns = self.session.wall_ns(event.stamp_ns)
        self._add(Topic.EVENTS, wall_ns, event_message(event, wall_ns))
        self.flush()

    def flush(self) -> None:
        """Hand everything to the system."""
        with self._records():
            self._writer.flush()
        self._flushed_at = monotonic()

    def _wrench(self, topic: Topic, wrench: Wrench) -> None:
        wall_ns = self.session.wall_ns(wrench.stamp_ns)
        self._add(topic, wall_ns, wrench_message(wrench, wall_ns))

    def _add(self, topic: Topic, wall_ns: int, data: bytes, sequence: int = 0) -> None:
        with self._records():
            self._writer.add_message(self._channels[topic], wall_ns, data, wall_ns, sequence)
        self.written[topic] += 1
        if monotonic() - self._flushed_at > LONGEST_WAIT_S:
            self.flush()

    @contextmanager
    def _records(self) -> Iterator[None]:
        """The library's writer at work: interrupted there, it does not know what it has written."""
        self._between_records = False
        yield
        self._between_records = True

    def _begin(self) -> None:
        now_ns = self.session.wall_ns(monotonic_ns())
        self._writer.start("ros2", f"ninedtact {self.session.software}".strip())
        self._writer.add_metadata(METADATA_RECORD, self.session.as_metadata())
        for name, content in self._attached.items():
            self._writer.add_attachment(now_ns, now_ns, name, "application/octet-stream", content)
        topics = [topic for topic in Topic if topic in self._topics]
        schemas = {
            name: self._writer.register_schema(name, "ros2msg", definition(name))
            for name in dict.fromkeys(TYPES[topic] for topic in topics)
        }
        self._channels = {
            topic: self._writer.register_channel(topic.value, "cdr", schemas[TYPES[topic]]) for topic in topics
        }

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Finish the file, whatever ended the block; where it ended before anything came, nothing is left."""
        try:
            if self._between_records:
                self._between_records = False
                self._writer.finish()
                self._between_records = True
        finally:
            self._file.close()
            if error is not None and not self.written:
                self.path.unlink()
            elif not self._between_records:
                with suppress(OSError, NinedtactError):  # no room for a summary: it can be read without one
                    repair_recording(self.path)

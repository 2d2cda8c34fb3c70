"""Writes a recording: one MCAP file that remains readable up to the last half second if the program is killed."""

import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import RLock
from time import monotonic, monotonic_ns
from types import TracebackType

from mcap.writer import CompressionType, Writer

from ninedtact.errors import CameraError, OutputError
from ninedtact.quantities import EstimateWarning, Frame, HeightMap, Rectified, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.errors import RecordingStopped
from ninedtact.recording.mcap_file import lock_while_writing
from ninedtact.recording.metadata import (
    METADATA_RECORD,
    RecordingMetadata,
    require_recordable_metadata,
    wall_minus_monotonic_ns,
)
from ninedtact.recording.topics_and_messages import (
    CAMERA_FRAME,
    SKIN_FRAME,
    LabelledSpan,
    PairLabel,
    RecordingEvent,
    RecordingEventKind,
    Topic,
    encode_covariance,
    encode_event,
    encode_height,
    encode_image,
    encode_labelled_span,
    encode_pair_label,
    encode_reference_grey,
    encode_warnings_as_diagnostics,
    encode_wrench,
    message_definition,
)

CHUNK_BYTES = 2**19
"""Less than an image: whatever is written before an image is on disk with it."""
_CLOCK_STEP_NS = 500_000_000
"""Change of the wall clock against the monotonic clock that is reported; gradual corrections of the clock remain below it."""
_LONGEST_BUFFERING_S = 0.5
"""After this time what was written is handed to the operating system, whatever its size."""


class RecordingWriter:
    """Writes what one sensor delivers into a recording while it is open (`with`). One thread at a time for each sensor.

    Images are stored without loss, and everything in chunks that zstd compresses. The metadata say whether images are PNG and
    heights are integers (docs/recording.md has the figures).

        with RecordingWriter("press.mcap", RecordingMetadata("my_sensor")) as recording:
            recording.write_image(frame)

    Several sensors are written into one file by a writer each; `with` of the first one opens and closes the file for all.
    """

    def __init__(
        self,
        path: Path | str,
        metadata: RecordingMetadata,
        topics: Collection[Topic] = tuple(Topic),
        attachments: Mapping[str, bytes] | None = None,
        notify: Callable[[str], None] = lambda sentence: None,
        beside: "RecordingWriter | None" = None,
    ) -> None:
        """topics: those that will be written. attachments: content of the attached files by their names. notify: receives a
        sentence where the wall clock is set during the recording. beside: the first writer of the same file, not yet opened."""
        self.path, self.metadata = Path(path), metadata
        self.written: Counter[Topic] = Counter()
        """Messages written so far."""
        self.dropped = 0
        """Images that the source counted and that were not written."""
        self.warned: Counter[str] = Counter()
        """Images with each warning so far."""
        self._topics = {*topics, Topic.EVENTS}
        if self._topics & {Topic.HEIGHTS, Topic.ESTIMATED}:
            self._topics.add(Topic.WARNINGS)
        self._attachments = dict(attachments or {})
        self._next_index: int | None = None
        self._size: tuple[int, int] | None = None
        self._reference: Rectified | None = None
        of_sensor = f"{metadata.name}_" if metadata.name else ""  # which several sensors are told apart by
        self._camera_frame, self._skin_frame = of_sensor + CAMERA_FRAME, of_sensor + SKIN_FRAME
        self._open_file: _SharedFile = _SharedFile() if beside is None else beside._open_file
        self._open_file.writers.append(self)
        self._notify = notify
        self._wall_ahead_ns = metadata.wall_minus_monotonic_ns
        self._has_other_clock = abs(wall_minus_monotonic_ns() - self._wall_ahead_ns) > _CLOCK_STEP_NS

    def __enter__(self) -> "RecordingWriter":
        """Create the file; raises `OutputError` or `RecordingStopped`."""
        opened = self._open_file
        for writer in opened.writers:
            require_recordable_metadata(writer.metadata)
        opened.records = _RecordFile(self.path)
        opened.mcap = Writer(opened.records, CHUNK_BYTES, CompressionType.ZSTD)  # type: ignore[arg-type]
        try:
            opened.mcap.start("ros2", f"ninedtact {self.metadata.software}")
            for writer in opened.writers:
                now_ns = monotonic_ns()
                wall_ns = writer.metadata.wall_ns(now_ns)
                opened.mcap.add_metadata(METADATA_RECORD, writer.metadata.to_mcap_metadata())
                for name, content in writer._attachments.items():
                    opened.mcap.add_attachment(wall_ns, now_ns, name, "application/octet-stream", content)
            for writer in opened.writers:
                writer._register_channels()
        except BaseException:
            opened.records.close()
            self.path.unlink()
            raise
        opened.flushed_at = monotonic()
        return self

    @property
    def file_bytes(self) -> int:
        """Number of bytes that were written to the file, by the writers of all its sensors."""
        return self._open_file.records.tell()

    def write_reading(self, reading: Reading) -> None:
        """Write a reading: its reference image where that is a new one, its image, and what `write_measurements` writes."""
        if reading.reference is not self._reference:
            self._reference = reading.reference
            self.write_reference_grey(reading.reference, reading.stamp_ns)
        self.write_image(reading.frame)
        self.write_measurements(reading)

    def write_measurements(self, reading: Reading) -> None:
        """Write the heights and the estimate of a reading, where the file has topics for them, and the warnings of both."""
        index = reading.frame.index
        if Topic.HEIGHTS in self._topics:
            self.write_height(reading.height, index)
        if reading.force is not None and Topic.ESTIMATED in self._topics:
            self.write_estimated(replace(reading.force, warnings=reading.warnings), index)
        elif Topic.WARNINGS in self._topics:
            self.write_warnings(reading.warnings, reading.stamp_ns, index)

    def write_image(self, frame: Frame) -> None:
        """Write a frame as it was read, and an event where frames are missing before it."""
        missing = 0 if self._next_index is None else frame.index - self._next_index
        self._next_index = frame.index + 1
        self.count_dropped(missing, frame.stamp_ns)
        self.write_selected_image(frame)

    def count_dropped(self, images: int, stamp_ns: int | None = None) -> None:
        """Count images that are missing before a stamp, which is now unless it is given, and write an event for them."""
        if images > 0:
            self.dropped += images
            at_ns = monotonic_ns() if stamp_ns is None else stamp_ns
            self.write_event(RecordingEvent(at_ns, RecordingEventKind.DROPPED, str(images)))

    def write_selected_image(self, frame: Frame) -> None:
        """Write a frame that was selected among many: frames before it do not count as missing."""
        self._add(Topic.IMAGES, frame.stamp_ns, self._encode_image(frame), frame.index)

    def write_reference(self, frame: Frame, tare: int) -> None:
        """Write a reference image (no contact) of this tare."""
        self._add(Topic.REFERENCE, frame.stamp_ns, self._encode_image(frame), tare)

    def write_reference_grey(self, reference: Rectified, stamp_ns: int) -> None:
        """Write the rectified reference image that heights are computed against from this stamp on."""
        wall_ns = self.metadata.wall_ns(stamp_ns)
        self._add(Topic.REFERENCE_GREY, stamp_ns, encode_reference_grey(reference.grey, wall_ns))

    def write_measured(self, wrench: Wrench) -> None:
        """Write a wrench of the force/torque sensor."""
        wall_ns = self.metadata.wall_ns(wrench.stamp_ns)
        self._add(Topic.MEASURED, wrench.stamp_ns, encode_wrench(wrench, wall_ns, self._skin_frame))

    def write_estimated(self, estimate: WrenchEstimate, index: int = 0) -> None:
        """Write an estimated wrench with its covariance, and its warnings where it has any; index: of the image."""
        stamp_ns = estimate.wrench.stamp_ns
        wall_ns = self.metadata.wall_ns(stamp_ns)
        self._add(Topic.ESTIMATED, stamp_ns, encode_wrench(estimate.wrench, wall_ns, self._skin_frame), index)
        covariance = estimate.about_skin_centre().covariance  # as `encode_wrench`
        self._add(Topic.COVARIANCE, stamp_ns, encode_covariance(covariance), index)
        self.write_warnings(estimate.warnings, stamp_ns, index)

    def write_warnings(self, warnings: Sequence[EstimateWarning], stamp_ns: int, index: int) -> None:
        """Write why heights and estimate of the image with this index should not be trusted; nothing where there is no reason."""
        if not warnings:
            return
        texts = [warning.value for warning in warnings]
        wall_ns = self.metadata.wall_ns(stamp_ns)
        message = encode_warnings_as_diagnostics(texts, self.metadata.topic_name, wall_ns, self._skin_frame)
        self._add(Topic.WARNINGS, stamp_ns, message, index)
        self.warned.update(texts)

    def write_height(self, height: HeightMap, index: int) -> None:
        """Write the heights of the image with this index, NaN out of view."""
        wall_ns = self.metadata.wall_ns(height.stamp_ns)
        message = encode_height(height.visible_z_mm, wall_ns, self.metadata.height_step_mm, self._skin_frame)
        self._add(Topic.HEIGHTS, height.stamp_ns, message, index)

    def write_label(self, label: PairLabel) -> None:
        """Write that an image was saved as a pair; the label is on disk when this returns."""
        self._add(Topic.LABELS, label.stamp_ns, encode_pair_label(label))
        self.flush()

    def write_span(self, span: LabelledSpan) -> None:
        """Write a labelled span; it is on disk when this returns."""
        self._add(Topic.SPANS, span.begin_ns, encode_labelled_span(span))
        self.flush()

    def write_event(self, event: RecordingEvent) -> None:
        """Write an event; it is on disk when this returns."""
        self._add(Topic.EVENTS, event.stamp_ns, encode_event(event))
        self.flush()

    def flush(self) -> None:
        """Hand everything that was written to the operating system."""
        with self._open_file.writing_records() as mcap:
            mcap.flush()
        self._open_file.flushed_at = monotonic()
        self._open_file.writers[0]._report_clock_step()

    def _report_clock_step(self) -> None:
        """Report, as a remark in the recording and to the person who records, that the wall clock was set since the last call."""
        ahead_ns, before_ns = wall_minus_monotonic_ns(), self._wall_ahead_ns
        if self._has_other_clock or abs(ahead_ns - before_ns) <= _CLOCK_STEP_NS:
            return
        self._wall_ahead_ns = ahead_ns
        text = (
            f"the clock of the computer moved by {(ahead_ns - before_ns) / 1e9:+.1f} s during the recording (it was set, or the "
            "computer slept); all stamps continue with the clock as it was at the beginning"
        )
        self.write_event(RecordingEvent(monotonic_ns(), RecordingEventKind.REMARK, "clock", text))
        self._notify(text)

    def _add(self, topic: Topic, stamp_ns: int, data: bytes, sequence: int = 0) -> None:
        with self._open_file.writing_records() as mcap:
            wall_ns = self.metadata.wall_ns(stamp_ns)
            mcap.add_message(self._channels[topic], stamp_ns, data, wall_ns, sequence)
        self.written[topic] += 1
        if monotonic() - self._open_file.flushed_at > _LONGEST_BUFFERING_S:
            self.flush()

    def _encode_image(self, frame: Frame) -> bytes:
        """Return the message of an image; raises `CameraError` for another size than that of the first one."""
        (rows, cols, _), (first_rows, first_cols) = frame.image.shape, self._size or frame.image.shape[:2]
        if (rows, cols) != (first_rows, first_cols):
            raise CameraError(
                expected=f"images of {first_cols}x{first_rows} pixels from {self.metadata.source}, as the first one",
                got=f"{cols}x{rows}",
                remedy="use what was recorded before, and set the camera to one size",
            )
        self._size = rows, cols
        wall_ns = self.metadata.wall_ns(frame.stamp_ns)
        return encode_image(frame.image, wall_ns, self.metadata.images, self._camera_frame)

    def _register_channels(self) -> None:
        """Register the topics, and the message types that no other sensor of the file has."""
        mcap, known, images = self._open_file.mcap, self._open_file.schemas, self.metadata.images
        self._channels: dict[Topic, int] = {}
        for topic in (topic for topic in Topic if topic in self._topics):
            name = topic.message_type(images)
            if name not in known:
                known[name] = mcap.register_schema(name, "ros2msg", message_definition(name))
            path = topic.path(self.metadata.topic_name, images)
            self._channels[topic] = mcap.register_channel(path, "cdr", known[name])

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Finish the file, whatever ended the block; delete it where the block failed before any message.

        Where a write has failed, as on a full disk, the file stays without an end: it is read as far as it goes.
        """
        opened = self._open_file
        try:
            if opened.is_between_records:
                with opened.writing_records() as mcap:
                    mcap.finish()
        finally:
            opened.records.close()
            if error is not None and not any(writer.written for writer in opened.writers):
                self.path.unlink()


class _SharedFile:
    """The file that the writers of several sensors share, one record at a time."""

    records: "_RecordFile"
    mcap: Writer

    def __init__(self) -> None:
        self.writers: list[RecordingWriter] = []
        self.schemas: dict[str, int] = {}
        self.flushed_at, self.is_between_records = 0.0, True
        self._lock = RLock()

    @contextmanager
    def writing_records(self) -> Iterator[Writer]:
        """Give the library's writer to one thread; an interruption of the block leaves it in an unknown state.

        Raises `RecordingStopped` after such an interruption: what it would write then could not be read.
        """
        with self._lock:
            if not self.is_between_records:
                raise RecordingStopped(
                    expected=f"to continue writing {self.records.path}",
                    got="an earlier write that failed",
                    remedy="free the disk, and record on under another name",
                )
            self.is_between_records = False
            yield self.mcap
            self.is_between_records = True


class _RecordFile:
    """The output of the MCAP writer, which writes whole records; nothing is buffered in this process.

    The file is not synced to the disk: it survives the program, not a power cut.
    """

    def __init__(self, path: Path) -> None:
        """Create a new file; raises `OutputError`."""
        self.path, self._end = path, 0
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError as error:
            raise OutputError(
                expected="a new file to record to", got=str(path), remedy="choose another name"
            ) from error
        except OSError as error:
            raise OutputError(
                expected=f"to create {path}", got=str(error.strerror), remedy="correct the path and its permissions"
            ) from error
        lock_while_writing(self._file)

    def write(self, records: bytes) -> int:
        """Append whole records, or none of them; raises `RecordingStopped`."""
        left = memoryview(records)
        if os.fstat(self._file).st_size < self._end:
            raise RecordingStopped(
                expected=f"to continue writing {self.path}", got="a file that was cut", remedy="record again"
            )
        try:
            while left:
                left = left[os.write(self._file, left) :]
        except BaseException as error:
            os.ftruncate(self._file, self._end)
            os.lseek(self._file, self._end, os.SEEK_SET)
            if isinstance(error, OSError):
                raise RecordingStopped(
                    expected=f"to continue writing {self.path}",
                    got=str(error.strerror),
                    remedy="free the disk, and record on under another name",
                ) from error
            raise
        self._end += len(records)
        return len(records)

    def tell(self) -> int:
        return self._end

    def flush(self) -> None:
        """Do nothing, because nothing is buffered."""

    def close(self) -> None:
        """Close the file; its descriptor may soon belong to another file."""
        descriptor, self._file = self._file, -1
        os.close(descriptor)

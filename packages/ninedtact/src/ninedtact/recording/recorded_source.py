"""A recording as a frame source and a wrench source: its frames and measured wrenches, bit for bit, with their recorded stamps."""

from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import ClassVar, TypeVar

import numpy as np
from numpy import ndarray as Array

from ninedtact.capture.frame_source import FrameSource, Openable, SourceEnded, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import RecordedReferences, Recording
from ninedtact.recording.summary import usual_rate_hz
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.shape.calibrated_shape import CalibratedShape, DepthReader, FindReferenceFaults

Item = TypeVar("Item")


class _RecordedTopic(Openable):
    """The messages of one topic of a recording, one by one, from the first at every opening."""

    topic: ClassVar[Topic]

    def __init__(self, path: Path | str) -> None:
        self.path, self.name = Path(path), f"recording {path}"
        self._recording: Recording | None = None
        self._positions: Array = np.empty(0)
        self._next = 0
        self._lock = Lock()

    def open(self) -> None:
        """Open the recording at its first message; raises `CameraError` or `RecordingUnreadable`."""
        with self._lock:
            if self._recording is not None:
                return
            recording = Recording(self.path)
            self._positions, self._next = recording.positions(self.topic), 0
            if len(self._positions) == 0:
                recording.close()
                topic = self.topic.path(recording.metadata.topic_name)
                raise RecordingUnreadable(
                    expected=f"messages on {topic} in {self.path}", got="none", remedy="take another recording"
                )
            self._recording = recording

    def close(self) -> None:
        with self._lock:
            if self._recording is not None:
                self._recording.close()
                self._recording = None

    def _read_next(self, decode: Callable[[Recording, np.void], Item]) -> Item:
        """Return the next message, decoded; raises `SourceEnded`, `SourceNotOpen` or `RecordingUnreadable`."""
        with self._lock:
            if self._recording is None:
                raise SourceNotOpen(self.name)
            if self._next == len(self._positions):
                self._require_end(self._recording)
                raise SourceEnded(
                    expected=f"more {self.topic}", got=f"the end of {self.name} after {self._next}", remedy="stop here"
                )
            self._next += 1
            return decode(self._recording, self._positions[self._next - 1])

    def _require_end(self, recording: Recording) -> None:
        """Raise an error, once, where the messages do not end with the recording itself."""


class RecordedFrameSource(_RecordedTopic, FrameSource):
    """The frames of a recording, bit for bit, with their recorded stamps and indices, as fast as they are requested.

    with RecordedFrameSource("press.mcap") as source:
        for frame in source:
            print(frame.index, frame.stamp_ns)
    """

    topic = Topic.IMAGES
    is_live = False
    _references: RecordedReferences | None = None
    _has_told_end = False

    def __init__(self, path: Path | str) -> None:
        super().__init__(path)
        self.recording = str(path)

    def open(self) -> None:
        """Open the recording at its first image; raises `CameraError` or `RecordingUnreadable`."""
        super().open()
        self._has_told_end = False
        self.recorded_hz = usual_rate_hz(self._positions["stamp_ns"])

    def depth_reader_at(
        self,
        stamp_ns: int,
        shape: CalibratedShape,
        find_faults: FindReferenceFaults,
        rectified_faults: tuple[str, ...] = (),
    ) -> DepthReader | None:
        """Return a depth reader for the reference image that held at a stamp; None where the recording has none.

        rectified_faults: why images that were recorded rectified cannot be reference images of the calibrated sensor.
        Raises `SourceNotOpen` and what `RecordedReferences.depth_reader_at` raises.
        """
        with self._lock:
            if self._recording is None:
                raise SourceNotOpen(self.name)
            if self._references is None or self._references.recording is not self._recording:
                self._references = RecordedReferences(self._recording, shape, find_faults, rectified_faults)
            return self._references.depth_reader_at(stamp_ns)

    def read(self) -> Frame:
        """Return the next frame; raises `SourceEnded` after the last, and before that `RecordingCutShort`, once, without an end."""
        return self._read_next(Recording.frame)

    def _require_end(self, recording: Recording) -> None:
        if not recording.is_finished and not self._has_told_end:
            self._has_told_end = True
            raise recording.missing_end_error()


class RecordedWrenchSource(_RecordedTopic, WrenchSource):
    """The measured wrenches of a recording, about the skin centre, with their recorded stamps."""

    topic = Topic.MEASURED

    def read(self) -> Wrench:
        """Return the next sample; raises `SourceEnded` after the last."""
        return self._read_next(Recording.wrench)

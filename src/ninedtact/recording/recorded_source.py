"""A recording as a frame source and a wrench source: its frames and measured wrenches, bit for bit, with their recorded stamps."""

from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import TypeVar

import numpy as np

from ninedtact.capture.frame_source import FrameSource, SourceEnded, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import Recording, median_rate_hz
from ninedtact.recording.ros_messages import Topic

Item = TypeVar("Item")


class RecordedSource(FrameSource):
    """The frames of a recording, bit for bit, with their recorded stamps and indices, as fast as they are requested.

    with RecordedSource("press.mcap") as source:
        for frame in source:
            print(frame.index, frame.stamp_ns)
    """

    is_live = False

    def __init__(self, path: Path | str) -> None:
        self._messages = _TopicPlayer(Path(path), Topic.IMAGES)
        self.path, self.name = self._messages.path, self._messages.name

    def open(self) -> None:
        """Open the recording at its first image; raises `CameraNotFound` or `RecordingUnreadable`."""
        self._messages.open()
        if self._messages.recording is not None:
            self.recorded_hz = median_rate_hz(self._messages.recording.stamps_ns(Topic.IMAGES))

    def read(self) -> Frame:
        """Return the next frame; raises `SourceEnded` after the last."""
        return self._messages.read(Recording.frame)

    def close(self) -> None:
        """Close the recording; opening it again starts from the first frame."""
        self._messages.close()


class RecordedWrenchSource(WrenchSource):
    """The measured wrenches of a recording, about the skin centre, with their recorded stamps."""

    def __init__(self, path: Path | str) -> None:
        self._messages = _TopicPlayer(Path(path), Topic.MEASURED)
        self.path, self.name = self._messages.path, self._messages.name

    def open(self) -> None:
        """Open the recording at its first sample; raises `CameraNotFound` or `RecordingUnreadable`."""
        self._messages.open()

    def read(self) -> Wrench:
        """Return the next sample; raises `SourceEnded` after the last."""
        return self._messages.read(Recording.wrench)

    def close(self) -> None:
        """Close the recording; opening it again starts from the first sample."""
        self._messages.close()


class _TopicPlayer:
    """The messages of one topic, one by one, from the first at every opening."""

    def __init__(self, path: Path, topic: Topic) -> None:
        self.path, self.topic, self.name = path, topic, f"recording {path}"
        self.recording: Recording | None = None
        self._positions = np.empty(0)
        self._next = 0
        self._lock = Lock()

    def open(self) -> None:
        """Open the file; raises `CameraNotFound` or `RecordingUnreadable`."""
        with self._lock:
            if self.recording is not None:
                return
            recording = Recording(self.path)
            self._positions, self._next = recording.positions(self.topic), 0
            if len(self._positions) == 0:
                recording.close()
                raise RecordingUnreadable(
                    f"expected messages on {self.topic.path(recording.sensor)} in {self.path}, got none; take another recording"
                )
            self.recording = recording

    def read(self, decode: Callable[[Recording, np.void], Item]) -> Item:
        """Return the next message, decoded; raises `SourceEnded`, `SourceNotOpen` or `RecordingUnreadable`."""
        with self._lock:
            if self.recording is None:
                raise SourceNotOpen(self.name)
            if self._next == len(self._positions):
                raise SourceEnded(
                    f"expected more {self.topic}, got the end of {self.name} after {self._next}; stop here"
                )
            self._next += 1
            return decode(self.recording, self._positions[self._next - 1])

    def close(self) -> None:
        """Close the file of the recording."""
        with self._lock:
            if self.recording is not None:
                self.recording.close()
                self.recording = None

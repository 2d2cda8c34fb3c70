"""The sources of a recording once more: a camera and a force/torque sensor whose every answer is known."""

from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import TypeVar

import numpy as np
from numpy import ndarray as Array

from ninedtact.capture.frame_source import FrameSource, SourceEnded, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import Recording
from ninedtact.recording.ros_messages import Topic

Noun = TypeVar("Noun")


class Played:
    """The messages of one topic, one by one, from the beginning at every opening."""

    def __init__(self, path: Path, topic: Topic) -> None:
        self.path, self.topic, self.name = path, topic, f"recording {path}"
        self.episode: Recording | None = None
        self._places = np.empty(0)
        self._next = 0
        self._lock = Lock()

    def open(self) -> None:
        """Open the file; raises `CameraNotFound` or `RecordingUnreadable`."""
        with self._lock:
            if self.episode is None:
                self.episode, self._next = opened_with(self.path, self.topic), 0
                self._places = self.episode.places(self.topic)

    def read(self, noun: Callable[[Recording, np.void], Noun]) -> Noun:
        """The next message as a noun; raises `SourceEnded`, `SourceNotOpen` or `RecordingUnreadable`."""
        with self._lock:
            if self.episode is None:
                raise SourceNotOpen(self.name)
            if self._next == len(self._places):
                raise SourceEnded(
                    f"expected more on {self.topic}, got the end of {self.name} after {self._next}; stop here"
                )
            self._next += 1
            return noun(self.episode, self._places[self._next - 1])

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            if self.episode is not None:
                self.episode.close()
                self.episode = None


def opened_with(path: Path, topic: Topic) -> Recording:
    """A recording that holds something on a topic."""
    episode = Recording(path)
    if len(episode.places(topic)) == 0:
        episode.close()
        raise RecordingUnreadable(f"expected messages on {topic} in {path}, got none; take another recording")
    return episode


class RecordedSource(FrameSource):
    """The images of a recording, bit for bit, with their stamps and indexes as recorded, as fast as they are asked for."""

    def __init__(self, path: Path | str) -> None:
        self._played = Played(Path(path), Topic.IMAGES)
        self.path, self.name = self._played.path, self._played.name

    def open(self) -> None:
        """Open it at its first image; raises `CameraNotFound` or `RecordingUnreadable`."""
        self._played.open()
        if self._played.episode is not None:
            self.recorded_hz = median_rate_hz(self._played.episode.stamps_ns(Topic.IMAGES))

    def read(self) -> Frame:
        """The next image; `SourceEnded` after the last."""
        return self._played.read(Recording.frame)

    def close(self) -> None:
        """Close it; opening it again starts over."""
        self._played.close()


class RecordedWrenchSource(WrenchSource):
    """The measured wrenches of a recording, about the skin's centre, with their stamps as recorded."""

    def __init__(self, path: Path | str) -> None:
        self._played = Played(Path(path), Topic.MEASURED)
        self.path, self.name = self._played.path, self._played.name

    def open(self) -> None:
        """Open it at its first sample; raises `CameraNotFound` or `RecordingUnreadable`."""
        self._played.open()

    def read(self) -> Wrench:
        """The next sample; `SourceEnded` after the last."""
        return self._played.read(Recording.wrench)

    def close(self) -> None:
        """Close it; opening it again starts over."""
        self._played.close()


RATE_WHERE_UNKNOWN_HZ = 30.0


def median_rate_hz(stamps_ns: Array) -> float:
    """The usual rate of some stamps: by the median of their distances, which gaps do not change."""
    usual_ns = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return 1e9 / usual_ns if usual_ns > 0 else RATE_WHERE_UNKNOWN_HZ

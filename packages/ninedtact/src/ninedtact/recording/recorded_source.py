"""A recording as a frame source and a wrench source: its frames and measured wrenches, bit for bit, with their recorded stamps.

`read_references_at_moments` reads reference images from a later moment of a recording, so that the rest of it is measured from a
new zero.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Lock
from typing import ClassVar, TypeVar

import numpy as np
from numpy import ndarray as Array

from ninedtact.calibration.drift.reference_check import ReferenceImageChecker, describe_new_contact
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder
from ninedtact.capture.frame_source import FrameSource, Openable, SourceEnded, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.errors import InputError
from ninedtact.quantities import Frame, HeightSource, Rectified, Wrench
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import RecordedReferences, Recording
from ninedtact.recording.summary import median_rate_hz
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.shape.calibrated_shape import (
    REFERENCE_FRAMES,
    CalibratedShape,
    DepthReader,
    FindReferenceFaults,
    mean_rectified_image,
)

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
        """Close the recording; opening it again starts from the first message."""
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
        self.recorded_hz = median_rate_hz(self._positions["stamp_ns"])

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


def read_first_reference(path: Path | str, sensor: SensorFolder, check: ReferenceImageChecker) -> DepthReader | None:
    """Return a depth reader for the reference image that a recording starts with; None without one (`ninedtact record`).

    Raises what `RecordedReferences.depth_reader_at` raises.
    """
    with Recording(path) as recording:
        is_rectified = len(recording.positions(Topic.REFERENCE_GREY)) > 0
        faults = _find_rectified_faults(recording, path, sensor) if is_rectified else ()
        references = RecordedReferences(recording, sensor.shape, check.find_faults, faults)
        stamps_ns = recording.stamps_ns(Topic.IMAGES)
        return references.depth_reader_at(int(stamps_ns[0])) if len(stamps_ns) else None


def _find_rectified_faults(recording: Recording, path: Path | str, sensor: SensorFolder) -> tuple[str, ...]:
    """Return why images that were recorded rectified cannot be reference images of a sensor; empty where they can."""
    own = recording.sensor_files().get(SENSOR_FILE)
    is_own = recording.sensor == sensor.id if own is None else own == (sensor.path / SENSOR_FILE).read_bytes()
    return () if is_own else (f"{path} was rectified with another calibration than that of {sensor.path}",)


def read_references_at_moments(
    path: Path | str,
    moments_s: Sequence[float],
    shape: CalibratedShape,
    check: ReferenceImageChecker,
    before: Rectified | None = None,
) -> list[tuple[int, DepthReader]]:
    """Return depth readers for the reference images (no contact) at moments of a recording, with the stamp of each moment.

    Each is the mean of ten images. moments_s: seconds after the first image. before: rectified reference image until the first
    moment; without it, that of the first ten images. Raises `InputError` for a moment that is not in the recording or
    at which something touches the gel, and what reading a recording raises.
    """
    with Recording(path) as recording:
        positions = recording.positions(Topic.IMAGES)
        found = []
        for at_s in sorted(moments_s):
            first = _first_image_at(recording, positions, at_s)
            frames = _read_frames(recording, positions[first : first + REFERENCE_FRAMES])
            if before is None:
                first_frames = _read_frames(recording, positions[:REFERENCE_FRAMES])
                before = mean_rectified_image([shape.rectify(frame) for frame in first_frames])
            before = _require_no_contact(f"{path} from {at_s:g} s on", frames, before, shape, check)
            found.append((frames[0].stamp_ns, shape.reader_against(before)))
    return found


def _first_image_at(recording: Recording, positions: Array, at_s: float) -> int:
    """Return the number of the first image at a moment; raises `InputError`."""
    seconds = (positions["stamp_ns"] - positions["stamp_ns"][:1]) / 1e9
    last = len(seconds) - REFERENCE_FRAMES
    first = int(np.searchsorted(seconds, at_s))
    if last < 0 or not at_s >= 0 or first > last:
        room = f"between 0 and {seconds[last]:.2f} s" if last >= 0 else f"in a recording of {REFERENCE_FRAMES} images"
        raise InputError(
            expected=f"a moment {room} for a reference of {REFERENCE_FRAMES} images",
            got=f"{at_s:g} s of {recording.path}, which has {len(seconds)} images",
            remedy="name a moment within the recording",
        )
    return first


def _read_frames(recording: Recording, positions: Array) -> list[Frame]:
    return [recording.frame(position) for position in positions]


def _require_no_contact(
    where: str, frames: list[Frame], before: Rectified, shape: CalibratedShape, check: ReferenceImageChecker
) -> Rectified:
    """Return the rectified mean of reference images; raises `InputError` where they cannot be a reference."""
    fault = next(iter(check.find_faults(frames)), None)
    if fault is None:
        mean = mean_rectified_image([shape.rectify(frame) for frame in frames])
        contact = describe_new_contact(before, mean, shape.rectify.height_source != HeightSource.OUT_OF_VIEW)
        if contact is None:
            return mean
        fault = f"something touches the gel: {contact}"
    raise InputError(
        expected=f"the {len(frames)} images of {where} to show the skin without contact",
        got=f"a fault; {fault}",
        remedy="name a moment at which nothing touches",
    )

"""The reference images of a recording: those that it has, those of its first images, and those of later moments of it."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from ninedtact.calibration.drift.reference_check import ReferenceImageChecker, describe_new_contact
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder
from ninedtact.errors import InputError
from ninedtact.quantities import Frame, HeightSource, Rectified
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic, decode_reference_grey
from ninedtact.shape.calibrated_shape import (
    REFERENCE_FRAMES,
    CalibratedShape,
    DepthReader,
    FindReferenceFaults,
    mean_rectified_image,
)


class RecordedReferences:
    """The reference images of a recording: rectified ones (live page, ROS), or raw ones (`collect`), of which those with one index
    belong together. Each holds from its stamp on, the first one before it, too."""

    def __init__(
        self,
        recording: Recording,
        shape: CalibratedShape,
        find_faults: FindReferenceFaults = lambda _: (),
        rectified_faults: tuple[str, ...] = (),
    ) -> None:
        """rectified_faults: why images that were recorded rectified cannot be reference images of the calibrated sensor."""
        self.recording, self._shape = recording, shape
        self._find_faults, self._rectified_faults = find_faults, rectified_faults
        kinds = (Topic.REFERENCE_GREY, Topic.REFERENCE)
        self.topic = next((topic for topic in kinds if len(recording.positions(topic))), None)
        """The topic of the reference images; None where the recording has none."""
        self._positions = recording.positions(self.topic or Topic.REFERENCE)
        self._last: tuple[int, DepthReader] | None = None

    def depth_reader_at(self, stamp_ns: int) -> DepthReader | None:
        """Return a depth reader for the reference image that held at a stamp, the same object until it changes; None without one.

        Raises what reading a recording raises, and `RecordingUnreadable` where the image is not that of the sensor.
        """
        if self.topic is None:
            return None
        number = max(int(np.searchsorted(self._positions["stamp_ns"], stamp_ns, side="right")) - 1, 0)
        if self._last is None or self._last[0] != number:
            self._last = number, self._read(number)
        return self._last[1]

    def depth_reader_of_first_images(self) -> DepthReader:
        """Return a depth reader for the first ten images; raises `InputError` where there are fewer."""
        frames = list(islice(self.recording.frames(), REFERENCE_FRAMES))
        if len(frames) < REFERENCE_FRAMES:
            raise InputError(
                expected=(
                    f"reference images in {self.recording.path}, or at least {REFERENCE_FRAMES} images of which the "
                    "first are taken as such"
                ),
                got=f"{len(frames)} images alone",
                remedy="record longer",
            )
        return self._shape.depth_reader(*frames, find_faults=self._find_faults)

    def _frames_at(self, number: int) -> list[Frame]:
        frames = [self.recording.frame(self._positions[number])]
        for numbers in (range(number - 1, -1, -1), range(number + 1, len(self._positions))):
            for other in numbers:
                frame = self.recording.frame(self._positions[other])
                if frame.index != frames[0].index:
                    break
                frames.append(frame)
        return frames

    def _read(self, number: int) -> DepthReader:
        if self.topic is not Topic.REFERENCE_GREY:
            return self._shape.depth_reader(*self._frames_at(number), find_faults=self._find_faults)
        message, wanted = self.recording.file.message(self._positions[number]), self._shape.rectify.height_source.shape
        grey = decode_reference_grey(message.data)
        if grey.shape != wanted:
            raise RecordingUnreadable(
                expected=f"a reference image of {wanted[1]} x {wanted[0]} pixels in {self.recording.path}, as the sensor has",
                got=f"{grey.shape[1]} x {grey.shape[0]}",
                remedy="name the recorded sensor, or none",
            )
        reference = Rectified(grey, self._shape.rectify.mm_per_px, message.log_time)
        return self._shape.reader_against(reference, self._rectified_faults)


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

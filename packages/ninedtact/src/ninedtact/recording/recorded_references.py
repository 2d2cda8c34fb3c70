"""The reference images with which a recorded sensor is opened: those that its recording starts with, or those of later moments."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from ninedtact.calibration.drift.reference_check import (
    ReferenceImageChecker,
    describe_new_contact,
    reference_image_error,
)
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder
from ninedtact.errors import InputError
from ninedtact.quantities import Frame, HeightSource, Rectified
from ninedtact.recording.reader import RecordedReferences, Recording
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.shape.calibrated_shape import (
    REFERENCE_FRAMES,
    CalibratedShape,
    DepthReader,
    mean_rectified_image,
)


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
    is_own = recording.is_named_after(sensor) if own is None else own == (sensor.path / SENSOR_FILE).read_bytes()
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
    images, advice = f"the {len(frames)} images of {where}", "name a moment at which nothing touches"
    raise reference_image_error(images, check.sensor, f"{fault}; {advice}")

"""A sensor without a calibration, read from images that are already rectified: its reference images, the sensor made of them,
and the motion and slip of what touches.

    video or folder ──▶ reference images ──nominal shape──▶ Sensor ──▶ RectifiedTracker ──▶ motion and slip

Positions are as right as the width of the view is known; depths and loads have an unknown scale.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.calibration.nominal_shape import nominal_shape
from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.design import SensorDesign
from ninedtact.errors import CameraError, FileFormatError, InputError
from ninedtact.force.contact_detection import ContactRegionSettings, ContactThreshold
from ninedtact.force.traction.estimator import TractionForce, build_traction_force
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.sensor import Sensor
from ninedtact.shape.calibrated_shape import MIN_LIT_GREY_LEVEL, REFERENCE_FRAMES, CalibratedShape
from ninedtact.shape.lens_and_rectification import to_grey_float
from ninedtact.tracking import SlipEstimate, SlipSample, TrackState, UprightMotion, UprightTracker, slip_of_sequence

_CELLS = 24, 18
"""Columns and rows to which images are reduced to be compared."""
_STEADY_FRAMES = 3
"""Images from which the noise of a sequence is known."""
_STEADY_FACTOR, _STEADY_CHANGE = 4.0, 0.004
"""Change from the images before, over that of the first images and relative to the brightness, up to which nothing has happened."""
_TOUCHED_CHANGE = 0.02
"""Relative change of a cell that only a contact makes."""
_PRESSED_SKEWNESS = 3.0
"""Skewness of the change from which the earlier of two images is the pressed one: its dent is a bright spot in the change. Bulges
around wide objects gave up to 2.3 on simulated sensors, small dents −4."""
_LEARNING_FRAMES = 5
"""Reference images from which the noise of the sequence is known, so that no bound from the grey levels is needed."""
_THRESHOLDS, _RAISE = 5, 1.5
"""Number of thresholds of contact that are tried, each this factor above the one before."""
_LEAST_NOISE_MM, _UNKNOWN_NOISE_MM = 0.002, 0.01
"""Noise of a pixel's height that is assumed at least, and with a single reference image."""


@dataclass(frozen=True)
class ReferenceFrames:
    """The images of a sequence that are taken to show no contact."""

    frames: tuple[Frame, ...]
    notices: tuple[str, ...] = ()
    """Sentences about them of which a reader should know."""


def read_reference_frames(source: FrameSource, chosen: tuple[int, int] | None = None) -> ReferenceFrames:
    """Return the reference images of a video or folder.

    chosen: the first and the end of their numbers, counted from 0; None takes the first ones up to the first change, or the last
    ones where the first show a contact. Raises `InputError` where there are none, and what the source raises before its first
    image.
    """
    first, last = list[Frame](), deque[Frame](maxlen=REFERENCE_FRAMES)
    start, end = (0, REFERENCE_FRAMES) if chosen is None else chosen
    count = 0
    with source:
        try:
            while chosen is None or count < end:
                frame = source.read()
                if start <= count < end:
                    first.append(frame)
                last.append(frame)
                count += 1
        except (SourceEnded, CameraError, FileFormatError):
            if not count:
                raise
    if chosen is not None:
        if len(first) < end - start:
            raise InputError(
                expected=f"--reference-frames {start}:{end} within the images of {source.name}",
                got=f"{count} images",
                remedy="name earlier ones",
            )
        return ReferenceFrames(tuple(first))
    return choose_reference_frames(first, list(last))


def choose_reference_frames(first: Sequence[Frame], last: Sequence[Frame]) -> ReferenceFrames:
    """Return the images at the beginning of a sequence until something changes, or those at its end where the beginning shows a
    contact."""
    beginning, ending = _steady(first), _steady(last[::-1])
    change = _relative_change(_cells_of(ending), _cells_of(beginning))
    centred = change - change.mean()
    skewness = float((centred**3).mean()) / max(float((centred**2).mean()) ** 1.5, 1e-12)
    if change.max() < _TOUCHED_CHANGE or skewness < _PRESSED_SKEWNESS:
        return ReferenceFrames(beginning)
    numbers = f"{ending[-1].index}:{ending[0].index + 1}"
    return ReferenceFrames(
        ending,
        (
            f"the first images show a contact that the last ones do not: images {numbers} are the reference; name others with "
            "--reference-frames",
        ),
    )


def _steady(frames: Sequence[Frame]) -> tuple[Frame, ...]:
    """Return the first frames, up to the one that differs from those before by more than these do among themselves."""
    cells = [_cells_of([frame]) for frame in frames]
    least = _STEADY_CHANGE
    for count in range(1, len(frames)):
        change = float(np.abs(_relative_change(cells[count], np.mean(cells[:count], axis=0))).max())
        if count >= _STEADY_FRAMES and change > _STEADY_FACTOR * least:
            return tuple(frames[:count])
        if change > _TOUCHED_CHANGE:
            return tuple(frames[:count])
        least = max(least, change / _STEADY_FACTOR if count >= _STEADY_FRAMES else change)
    return tuple(frames)


def _cells_of(frames: Sequence[Frame]) -> Float32[Array, "cell_rows cell_cols"]:
    """Return the mean brightness of images on cells."""
    return np.asarray(
        cv2.GaussianBlur(cv2.resize(_mean_grey(frames), _CELLS, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    )


def _mean_grey(frames: Sequence[Frame]) -> Float32[Array, "rows cols"]:
    return np.asarray(np.mean([to_grey_float(frame.image) for frame in frames], axis=0), np.float32)


def _relative_change(
    now: Float32[Array, "cell_rows cell_cols"], before: Float32[Array, "cell_rows cell_cols"]
) -> Float32[Array, "cell_rows cell_cols"]:
    """Return the change of brightness but for that of the whole; zero where it is dark, as in black borders."""
    is_lit = before > MIN_LIT_GREY_LEVEL
    ratio = now / np.maximum(before, 1)
    level = max(float(np.median(ratio[is_lit])), 1e-3) if is_lit.any() else 1.0
    return np.where(is_lit, ratio / level - 1, 0).astype(np.float32)


@contextmanager
def open_rectified(
    source: FrameSource, references: Sequence[Frame], mm_per_px: float | None = None
) -> Iterator[Sensor]:
    """Open a sensor on rectified images of this source, with these reference images and the forces of the published design, which
    have an unknown scale.

    mm_per_px: of the images; None takes their view to be as wide as that of the published design. Raises what `nominal_shape`,
    `ReferenceImages.take` and the source raise.
    """
    shape = _with_noise(nominal_shape(_mean_grey(references), mm_per_px), references)
    estimator = build_traction_force(shape, SensorDesign().gel)
    sensor = Sensor(source, shape, estimator=estimator)
    sensor.open(take_reference=False)
    try:
        sensor.use_reference(references)
        if len(references) >= _LEARNING_FRAMES:
            sensor.estimator = _with_learnt_threshold(estimator, sensor, references)
        yield sensor
    finally:
        sensor.close()


def _with_learnt_threshold(estimator: TractionForce, sensor: Sensor, references: Sequence[Frame]) -> TractionForce:
    """Return the estimator with the lowest threshold of contact at which nothing touches in any reference image, or the highest
    that is tried."""
    reader = sensor.references.in_use
    assert reader is not None
    readings = [read_frame(frame, sensor.shape, reader, stream=sensor.references.memory) for frame in references]
    threshold = ContactThreshold(stream_noises=ContactThreshold().reference_noises, learnt_after_s=0.0)
    for _ in range(_THRESHOLDS):
        found = replace(estimator, contact_region=ContactRegionSettings(threshold))
        if not any(found.estimate(reading).touching for reading in readings):
            return found
        threshold = replace(threshold, stream_noises=_RAISE * threshold.stream_noises)
    return replace(estimator, contact_region=ContactRegionSettings(threshold))


def _with_noise(shape: CalibratedShape, references: Sequence[Frame]) -> CalibratedShape:
    """Return the shape path with the noise of a pixel's height, as its reference images show it."""
    if len(references) < 2:
        return replace(shape, noise_mm=_UNKNOWN_NOISE_MM)
    reader = shape.depth_reader(*references)
    squares = [float(np.mean(reader(shape.rectify(frame)).z_mm ** 2)) for frame in references]
    # Each image is part of the mean with which it is compared.
    noise_mm = float(np.sqrt(np.mean(squares) * len(references) / (len(references) - 1)))
    return replace(shape, noise_mm=max(noise_mm, _LEAST_NOISE_MM))


@dataclass(frozen=True)
class TrackedImage:
    """What one image shows of the object that touches."""

    index: int
    """Number of the image in its source."""
    time_s: float
    motion: UprightMotion
    force_n: Float64[Array, "3"]
    """Load on the skin with an unknown scale, that of the published design; not a number where none is known."""
    slip: SlipEstimate
    """Unknown where nothing touches, and where the image says nothing."""


@dataclass
class RectifiedTracker:
    """Follows the object through a whole sequence: give it every reading in turn, then call `finish`."""

    rate_hz: float | None = None
    """Images per second; None takes the stamps of the readings."""
    _tracker: UprightTracker = field(default_factory=UprightTracker, init=False, repr=False)
    _images: list[tuple[int, float, UprightMotion, Float64[Array, "3"]]] = field(default_factory=list, init=False)
    _sample_of_image: list[int] = field(default_factory=list, init=False, repr=False)
    _samples: list[SlipSample] = field(default_factory=list, init=False, repr=False)
    _last: Reading | None = field(default=None, init=False, repr=False)
    _first_ns: int = field(default=0, init=False, repr=False)

    def add(self, reading: Reading) -> None:
        """Take the next reading."""
        if not self._images:
            self._first_ns = reading.stamp_ns
        index = reading.frame.index
        time_s = index / self.rate_hz if self.rate_hz else (reading.stamp_ns - self._first_ns) / 1e9
        if self._last is not None and np.array_equal(reading.image, self._last.image):
            _, _, motion, force_n = self._images[-1]  # an image that is repeated says nothing new
        else:
            motion = self._tracker.update(reading)
            is_known = motion.state == TrackState.TRACKED
            force_n = reading.wrench.force_n if is_known and reading.wrench is not None else np.full(3, np.nan)
            normal = 0.0 if motion.state == TrackState.NO_CONTACT else -float(force_n[2])
            self._samples.append(SlipSample(time_s, motion.moved_mm, force_n[:2], normal))
        self._images.append((index, time_s, motion, force_n))
        self._sample_of_image.append(len(self._samples) - 1)
        self._last = reading

    def finish(self) -> list[TrackedImage]:
        """Return what every image shows; its slip is judged by all of them."""
        slips = slip_of_sequence(self._samples)
        pairs = zip(self._images, self._sample_of_image, strict=True)
        return [TrackedImage(*image, slips[number]) for image, number in pairs]

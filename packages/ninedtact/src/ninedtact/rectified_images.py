"""A sensor without a calibration, made of reference images that are already rectified.

    reference images ──nominal shape──▶ Sensor

Positions are as right as the width of the view is known; depths and loads have an unknown scale.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from ninedtact.calibration.nominal_shape import nominal_shape
from ninedtact.capture.frame_source import FrameSource
from ninedtact.design import SensorDesign
from ninedtact.force.contact_detection import ContactRegionSettings, ContactThreshold
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.force.traction.estimator import TractionForce, build_traction_force
from ninedtact.quantities import Frame, WrenchEstimate
from ninedtact.reading import Reading, read_frame
from ninedtact.reference_frames import ReferenceFrames, mean_grey
from ninedtact.sensor import Sensor
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.steady_light import SteadyLight, measure_light

_LEARNING_FRAMES = 5
"""Reference images from which the noise of the sequence is known, so that no bound from the grey levels is needed."""
_THRESHOLDS, _RAISE = 5, 1.5
"""Number of thresholds of contact that are tried, each this factor above the one before. A contact lasts until it is below its
threshold by this factor."""
_LEAST_NOISE_MM, _UNKNOWN_NOISE_MM = 0.002, 0.01
"""Noise of a pixel's height that is assumed at least, and with a single reference image."""


@contextmanager
def open_rectified(
    source: FrameSource, references: ReferenceFrames, mm_per_px: float | None = None
) -> Iterator[Sensor]:
    """Open a sensor on rectified images of this source, with these reference images and the forces of the published design, which
    have an unknown scale.

    mm_per_px: of the images; None takes their view to be as wide as that of the published design. Raises what `nominal_shape`,
    `ReferenceImages.take` and the source raise.
    """
    frames = references.frames
    shape = _with_noise(nominal_shape(mean_grey(frames), mm_per_px), frames)
    estimator = build_traction_force(shape, SensorDesign().gel)
    sensor = Sensor(SteadyLight(source, measure_light(references)), shape, estimator=estimator)
    sensor.open(take_reference=False)
    try:
        sensor.use_reference(frames)
        if len(frames) >= _LEARNING_FRAMES:
            estimator = _with_learnt_threshold(estimator, sensor, frames)
        sensor.estimator = _HeldContact(estimator)
        yield sensor
    finally:
        sensor.close()


@dataclass
class _HeldContact(ForceEstimator):
    """An estimator by which a contact lasts until it is fainter than the faintest that is found: noise does not interrupt it."""

    estimator: TractionForce
    _thresholds: tuple[ContactRegionSettings, ContactRegionSettings] = field(init=False, repr=False)
    """Those by which a contact is found, and by which it lasts."""

    def __post_init__(self) -> None:
        self.name = self.estimator.name
        found = self.estimator.contact_region
        self._thresholds = found, replace(found, threshold=_scaled(found.threshold, 1 / _RAISE))

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the estimate; raises what the estimator raises."""
        estimate = self.estimator.estimate(reading)
        self.estimator.contact_region = self._thresholds[estimate.touching]
        return estimate

    def forget(self) -> None:
        """Estimate the next wrench as if it were the first."""
        self.estimator.contact_region = self._thresholds[0]
        self.estimator.forget()


def _scaled(threshold: ContactThreshold, factor: float) -> ContactThreshold:
    """Return the threshold of images that have more noise than a camera's by this factor, or less."""
    names = "noise_stds", "min_darkening", "reference_noises"
    return replace(threshold, **{name: factor * getattr(threshold, name) for name in names})


def _with_learnt_threshold(estimator: TractionForce, sensor: Sensor, references: Sequence[Frame]) -> TractionForce:
    """Return the estimator with the lowest threshold of contact at which nothing touches in any reference image, or the highest
    that is tried."""
    reader = sensor.references.in_use
    assert reader is not None
    readings = [read_frame(frame, sensor.shape, reader, stream=sensor.references.memory) for frame in references]
    threshold = ContactThreshold(learnt_after_s=0.0)
    for _ in range(_THRESHOLDS):
        found = replace(estimator, contact_region=ContactRegionSettings(threshold))
        if not any(found.estimate(reading).touching for reading in readings):
            return found
        threshold = replace(threshold, reference_noises=_RAISE * threshold.reference_noises)
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

"""A sequence of rectified images of a sensor without a calibration, followed as a whole.

Positions are as right as the width of the view is known; depths and loads have an unknown scale.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.reading import Reading
from ninedtact.tracking.object_tracker import TrackState
from ninedtact.tracking.sliding_springs import SlipSample
from ninedtact.tracking.slip import SlipEstimate, SlipState
from ninedtact.tracking.slip_of_sequence import slip_of_sequence
from ninedtact.tracking.upright_motion import UprightMotion, UprightTracker


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

    @property
    def slip_label(self) -> str:
        """The state of slip; static where nothing touches, empty where the image says nothing."""
        if self.motion.state == TrackState.NO_CONTACT:
            return "static"
        return "" if self.slip.state == SlipState.UNKNOWN else str(self.slip.state)


@dataclass
class SequenceTracker:
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
            normal = 0.0 if motion.ends_path else -float(force_n[2])
            self._samples.append(SlipSample(time_s, motion.moved_mm, force_n[:2], normal))
        self._images.append((index, time_s, motion, force_n))
        self._sample_of_image.append(len(self._samples) - 1)
        self._last = reading

    def finish(self) -> list[TrackedImage]:
        """Return what every image shows; its slip is judged by all of them."""
        slips = slip_of_sequence(self._samples)
        pairs = zip(self._images, self._sample_of_image, strict=True)
        return [TrackedImage(*image, slips[number]) for image, number in pairs]

"""The calibrated shape path of one sensor: rectification, depth curve and their errors, from a camera frame to a height map. The
only other input is the reference image of the session (no contact), which `CalibratedShape.depth_reader` binds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ninedtact.errors import CalibrationError
from ninedtact.quantities import EstimateWarning, Frame, Rectified
from ninedtact.shape.deblurring import Deblurring
from ninedtact.shape.depth import FINE_SMOOTHING, DepthCurve, DepthReader, GlobalDimmingModel, Smoothing
from ninedtact.shape.rectification import Rectification

REFERENCE_FRAMES = 10
"""Number of images without contact whose mean is a reference image; it brings their noise below that of a reading."""
MIN_LIT_GREY_LEVEL = 15.0
"""Mean grey level below which an image counts as taken in the dark and cannot be a reference image."""
_MAX_UNSTEADINESS = 0.1
"""Largest relative difference of the mean brightness between the images of one reference; light that is being switched on changes
by more."""
_KEPT_BYTES = 31 << 20
"""Size in bytes, just below the 32 MiB above which glibc no longer adapts its threshold (mallopt(3), M_MMAP_THRESHOLD)."""

FindReferenceFaults = Callable[[Sequence[Frame]], Sequence[str]]
"""Returns why raw images cannot be reference images of the calibrated sensor; nothing where they can."""


class ReferenceUnusable(CalibrationError):
    """The reference images of a session (no contact) are missing, too dark, or differ in brightness."""


@dataclass(frozen=True)
class CalibratedShape:
    """Rectification, depth curve and their errors for one sensor."""

    rectify: Rectification
    curve: DepthCurve
    noise_mm: float
    camera_distance_mm: float
    smoothing: Smoothing = Smoothing()
    loss: GlobalDimmingModel = GlobalDimmingModel()
    deblurring: Deblurring | None = None
    """The removal of the point spread of this sensor's light; None where the calibration does not determine it."""
    warnings: tuple[EstimateWarning, ...] = ()
    """Reasons to distrust everything that is measured with this calibration; every reading carries them."""

    def fast(self) -> "CalibratedShape":
        """Return the same sensor without deblurring: faster, and three times less accurate (docs/accuracy.md)."""
        return replace(self, deblurring=None)

    def depth_reader(self, *references: Frame, find_faults: FindReferenceFaults = lambda _: ()) -> DepthReader:
        """Return a depth reader for the reference image of this session, the mean of one or more frames, with its faults; raises
        `ReferenceUnusable`.
        """
        retain_freed_memory()
        mean = mean_rectified_image([self.rectify(frame) for frame in references])
        return self.reader_against(mean, tuple(find_faults(references)))

    def reader_against(self, reference: Rectified, faults: tuple[str, ...] = ()) -> DepthReader:
        """Return a depth reader for a reference image that is already rectified, and the faults of this image."""
        return DepthReader(
            self.curve,
            reference,
            self.rectify.height_source,
            self.smoothing if self.deblurring is None else FINE_SMOOTHING,
            self.noise_mm,
            self.camera_distance_mm,
            self.loss,
            self.deblurring,
            faults,
        )


def mean_rectified_image(images: list[Rectified]) -> Rectified:
    """Return the mean brightness of several rectified images of the same skin; raises `ReferenceUnusable`."""
    if not images:
        raise ReferenceUnusable("expected at least one reference image (no contact), got none; take one first")
    total = np.zeros_like(images[0].grey)
    for image in images:
        cv2.accumulate(image.grey, total)
    total /= len(images)
    if total.mean() < MIN_LIT_GREY_LEVEL:
        raise ReferenceUnusable(
            f"expected a lit reference image (no contact), got a mean grey level of {total.mean():.0f} of 255; "
            "switch the sensor's light on and raise the exposure"
        )
    levels = [float(image.grey.mean()) for image in images]
    if max(levels) - min(levels) > _MAX_UNSTEADINESS * max(levels):
        raise ReferenceUnusable(
            f"expected reference images (no contact) of one brightness, got mean grey levels from {min(levels):.0f} to "
            f"{max(levels):.0f}; wait until light and exposure are steady"
        )
    return Rectified(total, images[0].mm_per_px, images[-1].stamp_ns)


def retain_freed_memory() -> None:
    """Make the allocator keep the memory that one frame's results free, so that the next frame's results reuse it.

    glibc sets the amount that it keeps by the largest block freed so far. Without this call, and depending on what else the program
    does, allocating fresh memory for every frame costs up to four times as much as computing the frame.
    """
    np.empty(_KEPT_BYTES, np.uint8)

"""One sensor's calibrated shape path: everything between a frame and its height but the session's untouched image."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ninedtact.errors import CalibrationError
from ninedtact.quantities import Frame, Rectified
from ninedtact.shape.depth import FINE_SMOOTHING, Deblurring, DepthCurve, DepthReader, LightLoss, Smoothing
from ninedtact.shape.rectification import Rectification

MIN_LIT_GREY_LEVEL = 15.0
"""Mean grey level below which an image is a dark room, not a skin."""
KEPT_BYTES = 31 << 20
"""Just below the 32 MiB from which on glibc learns nothing (mallopt(3), M_MMAP_THRESHOLD)."""


class ReferenceUnusable(CalibrationError):
    """The untouched image of this session cannot serve as one."""


@dataclass(frozen=True)
class CalibratedShape:
    """Rectification, depth curve and their errors."""

    rectify: Rectification
    curve: DepthCurve
    noise_mm: float
    camera_distance_mm: float
    smoothing: Smoothing = Smoothing()
    loss: LightLoss = LightLoss()
    deblurring: Deblurring | None = None
    """The point-spread of this sensor's light, where the calibration knows it."""

    def fast(self) -> "CalibratedShape":
        """The same sensor read without undoing the point-spread: quicker, and three times less exact (docs/accuracy.md)."""
        return replace(self, deblurring=None)

    def depth_reader(self, *references: Frame) -> DepthReader:
        """Bind the untouched skin of this session, the mean of one or more frames; raises `ReferenceUnusable`."""
        retain_freed_memory()
        return self.reader_against(mean_rectified_image([self.rectify(frame) for frame in references]))

    def reader_against(self, reference: Rectified) -> DepthReader:
        """The same, of untouched skin that is rectified already."""
        return DepthReader(
            self.curve,
            reference,
            self.rectify.height_source,
            self.smoothing if self.deblurring is None else FINE_SMOOTHING,
            self.noise_mm,
            self.camera_distance_mm,
            self.loss,
            self.deblurring,
        )


def mean_rectified_image(images: list[Rectified]) -> Rectified:
    """Mean brightness of several images of the same skin."""
    if not images:
        raise ReferenceUnusable("expected at least one image of the untouched skin, got none; take one first")
    total = np.zeros_like(images[0].grey)
    for image in images:
        cv2.accumulate(image.grey, total)
    total /= len(images)
    if total.mean() < MIN_LIT_GREY_LEVEL:
        raise ReferenceUnusable(
            f"expected a lit image of the untouched skin, got a mean grey level of {total.mean():.0f} of 255; "
            "switch the sensor's light on and raise the exposure"
        )
    return Rectified(total, images[0].mm_per_px, images[-1].stamp_ns)


def retain_freed_memory() -> None:
    """Let the memory that one frame's results free serve the next frame's, instead of going back to the system.

    The allocator takes the largest block freed so far as the measure of what to keep. Without it, depending on what else
    the program does, taking fresh memory for every frame costs up to four times what computing the frame does.
    """
    np.empty(KEPT_BYTES, np.uint8)

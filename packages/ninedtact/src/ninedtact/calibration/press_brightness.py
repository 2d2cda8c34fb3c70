"""Brightness of calibration images: the relative change that a press causes, in grey levels as under uniform light, the noise of a
pixel, and the checks that refuse unusable images.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.errors import CalibrationError
from ninedtact.quantities import Rectified
from ninedtact.shape.calibrated_shape import MIN_LIT_GREY_LEVEL

BgrImage = UInt8[Array, "_ _ 3"]

MIN_REFERENCE_GREY = 8.0
"""Grey level of the reference image below which a relative change is mostly noise."""
OVEREXPOSED = 250
"""Grey level from which a pixel counts as overexposed."""
_MAX_OVEREXPOSED_SHARE = 0.2


class ImageUnusable(CalibrationError):
    """The image cannot be used for a calibration."""


def to_grey_float(image: BgrImage) -> Float32[Array, "rows cols"]:
    """Convert a BGR image to grey levels as float32."""
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)


def flat_fielded_brightness_change(reference: BgrImage, press: BgrImage) -> Float32[Array, "rows cols"]:
    """Return (press − reference) / reference, times the mean grey level of the reference, as under uniform light."""
    before, after = to_grey_float(reference), to_grey_float(press)
    return (after - before) / np.maximum(before, MIN_REFERENCE_GREY) * before.mean()


def relative_brightness(after: Rectified, before: Rectified) -> Float32[Array, "rows cols"]:
    """Return the brightness of a rectified image relative to its reference image, whose black pixels count as one grey level."""
    return after.grey / np.maximum(before.grey, 1)


def estimate_pixel_noise(change: Float32[Array, "rows cols"]) -> float:
    """Return the standard deviation of one pixel's noise, from second differences, to which smooth image content does not
    contribute.

    The median of absolute values is insensitive to edges; 0.6745 converts it to a standard deviation, and √6 accounts for the
    second difference of independent pixels (Rousseeuw & Croux 1993 for the median).
    """
    second = np.abs(np.diff(change, n=2, axis=1))
    return float(max(np.median(second) / 0.6745 / np.sqrt(6), 0.1))


def estimate_camera_noise(change: Float32[Array, "rows cols"]) -> float:
    """Return the standard deviation of one pixel of one image, from the difference of two, which contains the noise of both."""
    return estimate_pixel_noise(change) / 2**0.5


@dataclass(frozen=True)
class ExposureFault:
    """Why the exposure of an image makes it unusable."""

    kind: Literal["dark", "overexposed"]
    expected: str
    """What is expected of an image, in words."""
    sentence: str
    """What was found, and what to do."""


def find_exposure_fault(image: BgrImage) -> ExposureFault | None:
    """Return why an image is too dark or too bright to be measured, or None."""
    grey = to_grey_float(image)
    if grey.mean() < MIN_LIT_GREY_LEVEL:
        return ExposureFault(
            "dark",
            "a lit image",
            f"a mean grey level of {grey.mean():.0f} of 255; switch the sensor's light on and raise the exposure",
        )
    overexposed_share = float((grey >= OVEREXPOSED).mean())
    if overexposed_share > _MAX_OVEREXPOSED_SHARE:
        return ExposureFault(
            "overexposed",
            f"grey levels below {OVEREXPOSED}",
            f"{overexposed_share:.0%} of the image overexposed; lower exposure or gain",
        )
    return None


def require_usable_exposure(name: str, image: BgrImage) -> None:
    """Raise `ImageUnusable` for an image that is black or overexposed."""
    fault = find_exposure_fault(image)
    if fault is not None:
        raise ImageUnusable(f"expected {fault.expected} for the {name}, got {fault.sentence}")


def require_same_image_size(name: str, reference: BgrImage, press: BgrImage) -> None:
    """Refuse a pair of images of different sizes."""
    if reference.shape != press.shape:
        (rows, cols), (got_rows, got_cols) = reference.shape[:2], press.shape[:2]
        raise ImageUnusable(
            f"expected the {name} and its reference to be of one size, got {got_cols}x{got_rows} and {cols}x{rows}; "
            "take both with the same camera settings"
        )


def smooth_gaussian(image: Float32[Array, "rows cols"], sigma_px: float) -> Float32[Array, "rows cols"]:
    """Smooth an image by a Gaussian of this standard deviation; the border is repeated."""
    from scipy.ndimage import gaussian_filter  # slow to import

    return np.asarray(gaussian_filter(image, sigma_px, mode="nearest"))

"""What a touch did to the rectified image, as networks are shown it: darker, brighter, reference (9DTact, section IV).

The one place where this is defined: checks while recording, training and live use call the same functions. Differences
are of floating numbers, so nothing wraps. An image and its reference are resized alike and before they are compared:
the noise of a pixel, halved by its sign, would otherwise turn up as a change. The wrench of an image does not depend
on its size.

`Layout.ORIGINAL` is the three channels as the original project stores them in `encode_mixed_image`, so that its published weights
can be used. There, three times a difference is put from float32 into uint8 unbounded (`save_data` of its
`data_collection/collect_data.py`, `raw_image_2_representation` of its `shape_reconstruction/sensor.py`): more than 85 grey
levels begin again at zero, modulo 256, on the machines that NumPy is built for (C leaves it open; here it is computed).
Nothing is lost by it, 3 having the inverse 171 modulo 256.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.errors import FileFormatError, InputError
from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.quantities import Deformation, Rectified

LEVELS = 256
ORIGINAL_SCALE, ORIGINAL_INVERSE = 3, 171
RED_PER_LEVEL, GREEN_PER_LEVEL = 5.0, 7.0
"""As bright as the original's own image for people; a bulge is fainter than what it surrounds."""
SAME_SCALE = 1e-3
"""Two images may differ by this part in their mm per pixel and still be of one sensor."""


class ImagesDoNotMatch(InputError):
    """An image and its reference of different sizes, or a size that would distort the skin."""


class NotAMixedImage(FileFormatError):
    """An image that the original project's arithmetic cannot have made."""


class ChannelLayout(StrEnum):
    """Which channels a network is shown, in which order; the name is kept with the model."""

    PLAIN = "darker, brighter, reference"
    """Grey levels, 0 to 255, floating."""
    ORIGINAL = "reference, 3 brighter, 3 darker (mod 256)"
    """The original project's `encode_mixed_image`, its bytes as floating numbers."""


@dataclass(frozen=True)
class DeformationReader:
    """The untouched image of this session, to hold others against; raises `ImagesDoNotMatch`."""

    reference: Rectified
    shape: tuple[int, int] | None = None
    """Rows and columns of what is given; as the images where nothing is said."""

    def __call__(self, rectified: Rectified) -> Deformation:
        """What is darker and brighter, at the size that was asked for."""
        require_match(rectified, self.reference)
        small = resized(rectified, self.shape)
        darker, brighter = split_brightness_change(small.grey, self.small_reference.grey)
        return Deformation(
            darker, brighter, self.small_reference.grey.copy(), self.small_reference.mm_per_px, rectified.stamp_ns
        )

    @cached_property
    def small_reference(self) -> Rectified:
        """The reference at the size that was asked for."""
        return resized(self.reference, self.shape)


def compute_deformation(
    rectified: Rectified, reference: Rectified, shape: tuple[int, int] | None = None
) -> Deformation:
    """One image against its reference. shape: rows and columns. Raises `ImagesDoNotMatch`."""
    return DeformationReader(reference, shape)(rectified)


def resized(rectified: Rectified, shape: tuple[int, int] | None) -> Rectified:
    """The same skin on more or fewer pixels: means over the area of each (where there are more, interpolated)."""
    rows, cols = rectified.grey.shape
    if shape in (None, (rows, cols)):
        return rectified
    require_aspect((rows, cols), shape)
    grey = np.asarray(cv2.resize(rectified.grey, shape[::-1], interpolation=cv2.INTER_AREA))
    return Rectified(grey, rectified.mm_per_px * cols / shape[1], rectified.stamp_ns)


def split_brightness_change(images: Any, references: Any) -> tuple[Any, Any]:
    """Darker and brighter of images of one size, (…, rows, cols); NumPy's or torch's arrays, of integers too."""
    xp = array_namespace_of(images)
    change = xp.astype(references, xp.float32) - xp.astype(images, xp.float32)
    return xp.clip(change, 0, None), xp.clip(-change, 0, None)


def stack_deformation_channels(
    darker: Any, brighter: Any, reference: Any, layout: ChannelLayout = ChannelLayout.PLAIN
) -> Any:
    """The input of a network, (…, 3, rows, cols) float32, from its parts (…, rows, cols) in NumPy or torch."""
    xp = array_namespace_of(darker)
    if layout is ChannelLayout.PLAIN:
        return xp.stack((darker, brighter, reference), axis=-3)
    tripled = [ORIGINAL_SCALE * xp.round(part) for part in (brighter, darker)]
    # A remainder by hand: NumPy's own is slow on floating numbers.
    wrapped = [part - LEVELS * xp.floor(part / LEVELS) for part in tripled]
    return xp.stack((xp.round(reference), *wrapped), axis=-3)


def deformation_channels(
    deformation: Deformation, layout: ChannelLayout = ChannelLayout.PLAIN
) -> Float32[Array, "3 rows cols"]:
    """One deformation as a network is shown it."""
    return np.asarray(
        stack_deformation_channels(deformation.darker, deformation.brighter, deformation.reference, layout)
    )


def encode_mixed_image(deformation: Deformation) -> UInt8[Array, "rows cols 3"]:
    """The original project's image of it: blue the reference, green 3·brighter, red 3·darker, modulo 256.

    Bit for bit where the deformation is of whole grey levels at their own size (`rectified_from_stored_image`).
    """
    return np.ascontiguousarray(
        deformation_channels(deformation, ChannelLayout.ORIGINAL).transpose(1, 2, 0).astype(np.uint8)
    )


def decode_mixed_image(mixed: UInt8[Array, "rows cols 3"], mm_per_px: float, stamp_ns: int = 0) -> Deformation:
    """What the original project's image (BGR) was made of, exactly; raises `NotAMixedImage`."""
    reference, brighter, darker = np.moveaxis(mixed.astype(np.int32), 2, 0)
    brighter, darker = (part * ORIGINAL_INVERSE % LEVELS for part in (brighter, darker))
    impossible = (darker > reference) | (brighter > LEVELS - 1 - reference) | ((darker > 0) & (brighter > 0))
    if impossible.any():
        raise NotAMixedImage(
            f"expected blue the reference, green 3 times brighter and red 3 times darker, got {impossible.mean():.1%} of the "
            "pixels that cannot be; give the PNG files of mixed_image as the original's collect_data.py saved them"
        )
    darker, brighter, reference = (part.astype(np.float32) for part in (darker, brighter, reference))
    return Deformation(darker, brighter, reference, mm_per_px, stamp_ns)


def rectified_from_stored_image(
    image: UInt8[Array, "rows cols *bgr"], mm_per_px: float, stamp_ns: int = 0
) -> Rectified:
    """A rectified image as stored, BGR or grey, in whole grey levels as the original project counts them."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return Rectified(np.asarray(grey, np.float32), mm_per_px, stamp_ns)


def render_deformation(deformation: Deformation) -> UInt8[Array, "rows cols 3"]:
    """For a person: red where darker, green where brighter, black where nothing changed; BGR."""
    green = cv2.convertScaleAbs(deformation.brighter, alpha=GREEN_PER_LEVEL)
    red = cv2.convertScaleAbs(deformation.darker, alpha=RED_PER_LEVEL)
    return np.asarray(cv2.merge([np.zeros_like(green), green, red]))


def require_match(rectified: Rectified, reference: Rectified) -> None:
    """Refuse images that are not of one grid."""
    sizes = [side(image.grey) for image in (rectified, reference)]
    scales = rectified.mm_per_px, reference.mm_per_px
    if sizes[0] != sizes[1] or abs(scales[0] / scales[1] - 1) > SAME_SCALE:
        raise ImagesDoNotMatch(
            f"expected an image and its reference alike, got {sizes[0]} at {scales[0]:.4f} and {sizes[1]} at "
            f"{scales[1]:.4f} mm per pixel; take the reference from the same sensor and session"
        )


def require_aspect(shape: tuple[int, int], wanted: tuple[int, int]) -> None:
    """Refuse a size at which a pixel would not be square: off by more than one row."""
    rows, cols = shape
    fitting = rows * wanted[1] / cols
    if min(wanted) < 1 or abs(wanted[0] - fitting) > 1:
        raise ImagesDoNotMatch(
            f"expected a size with the sides of {cols} x {rows} pixels, got {wanted[1]} x {wanted[0]}; ask for "
            f"{max(wanted[1], 1)} x {max(round(fitting), 1)}"
        )


def side(grey: Shaped[Array, "rows cols"]) -> str:
    """Columns and rows in words."""
    return f"{grey.shape[1]} x {grey.shape[0]} pixels"

"""Brightness channels of a rectified image: darker, brighter, reference, as force networks take them (9DTact, section IV).

Recording, training and live use all call these functions. Differences are computed in floating point, so they do not wrap. An
image and its reference are resized in the same way before they are compared: the noise of single pixels, split by its sign into
two channels, would otherwise not average out and would appear as a change. The wrench of an image does not depend on its size.

`ChannelLayout.ORIGINAL` is the three channels as the original project stores them in its mixed image (`encode_mixed_image`), so
that its published weights can be used. The original casts three times a difference from float32 to uint8 without a bound
(`save_data` of its `data_collection/collect_data.py`, `raw_image_2_representation` of its `shape_reconstruction/sensor.py`).
Differences of more than 85 grey levels therefore wrap modulo 256 on the machines that NumPy is built for; C leaves the result of
the cast undefined, so the remainder is computed here. No information is lost, because 3 has the inverse 171 modulo 256.
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
from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of
from ninedtact.quantities import Deformation, Rectified

LEVELS = 256
ORIGINAL_SCALE, ORIGINAL_INVERSE = 3, 171
RED_PER_LEVEL, GREEN_PER_LEVEL = 5.0, 7.0
"""Display gains, as in the image that the original project shows; bulges change brightness less than dents."""
SAME_SCALE = 1e-3
"""Relative difference in mm per pixel up to which two images are taken to be of one sensor."""


class NotAMixedImage(FileFormatError):
    """An image has pixel values that the original project's mixed image cannot have."""


class ChannelLayout(StrEnum):
    """The channels of a network's input and their order; the text is stored in the model's card."""

    PLAIN = "darker, brighter, reference"
    """Grey levels from 0 to 255 as floating-point numbers."""
    ORIGINAL = "reference, 3 brighter, 3 darker (mod 256)"
    """The bytes of the original project's mixed image as floating-point numbers."""


@dataclass(frozen=True)
class DeformationBuilder:
    """Computes deformations relative to one reference image (no contact); raises `InputError`."""

    reference: Rectified
    shape: tuple[int, int] | None = None
    """Rows and columns of the deformation; None keeps those of the images."""

    def __call__(self, rectified: Rectified) -> Deformation:
        """Return the deformation of an image at the requested size; raises `InputError`."""
        require_same_pixel_grid(rectified, self.reference)
        small = resize_to(rectified, self.shape)
        darker, brighter = split_darker_brighter(small.grey, self.small_reference.grey)
        return Deformation(
            darker, brighter, self.small_reference.grey.copy(), self.small_reference.mm_per_px, rectified.stamp_ns
        )

    @cached_property
    def small_reference(self) -> Rectified:
        """The reference image at the requested size."""
        return resize_to(self.reference, self.shape)


def compute_image_deformation(
    rectified: Rectified, reference: Rectified, shape: tuple[int, int] | None = None
) -> Deformation:
    """Return the darker, brighter and reference channels of one image; raises `InputError`.

    shape: rows and columns of the result; None keeps those of the image.
    """
    return DeformationBuilder(reference, shape)(rectified)


def resize_to(rectified: Rectified, shape: tuple[int, int] | None) -> Rectified:
    """Return the image of the same skin at another size: averaged over each new pixel, or interpolated where it is enlarged."""
    rows, cols = rectified.grey.shape
    if shape in (None, (rows, cols)):
        return rectified
    require_aspect((rows, cols), shape)
    grey = np.asarray(cv2.resize(rectified.grey, shape[::-1], interpolation=cv2.INTER_AREA))
    return Rectified(grey, rectified.mm_per_px * cols / shape[1], rectified.stamp_ns)


def split_darker_brighter(images: Any, references: Any) -> tuple[Any, Any]:
    """Return the darker and the brighter part of the change from references to images (…, rows, cols).

    Both are NumPy or torch arrays of one size, of any numeric type.
    """
    xp = array_namespace_of(images)
    change = xp.astype(references, xp.float32) - xp.astype(images, xp.float32)
    return xp.clip(change, 0, None), xp.clip(-change, 0, None)


def stack_deformation_channels(
    darker: Any, brighter: Any, reference: Any, layout: ChannelLayout = ChannelLayout.PLAIN
) -> Any:
    """Stack the three parts (…, rows, cols) of NumPy or torch to a network's input (…, 3, rows, cols), float32."""
    xp = array_namespace_of(darker)
    if layout is ChannelLayout.PLAIN:
        return xp.stack((darker, brighter, reference), axis=-3)
    tripled = [ORIGINAL_SCALE * xp.round(part) for part in (brighter, darker)]
    # The remainder is computed from floor, because NumPy's remainder is slow for floating-point numbers.
    wrapped = [part - LEVELS * xp.floor(part / LEVELS) for part in tripled]
    return xp.stack((xp.round(reference), *wrapped), axis=-3)


def deformation_network_input(
    deformation: Deformation, layout: ChannelLayout = ChannelLayout.PLAIN
) -> Float32[Array, "3 rows cols"]:
    """Return the input of a network for one deformation."""
    return np.asarray(
        stack_deformation_channels(deformation.darker, deformation.brighter, deformation.reference, layout)
    )


def encode_mixed_image(deformation: Deformation) -> UInt8[Array, "rows cols 3"]:
    """Return the original project's mixed image (BGR): blue is the reference, green 3·brighter, red 3·darker, modulo 256.

    The result is identical bit for bit where the deformation has whole grey levels and was not resized
    (`to_whole_grey_levels`).
    """
    return np.ascontiguousarray(
        deformation_network_input(deformation, ChannelLayout.ORIGINAL).transpose(1, 2, 0).astype(np.uint8)
    )


def deformation_from_mixed_image(
    mixed: UInt8[Array, "rows cols 3"], mm_per_px: float, stamp_ns: int = 0
) -> Deformation:
    """Return the exact deformation that a mixed image (BGR) of the original project encodes; raises `NotAMixedImage`."""
    reference, brighter, darker = np.moveaxis(mixed.astype(np.int32), 2, 0)
    brighter, darker = (part * ORIGINAL_INVERSE % LEVELS for part in (brighter, darker))
    impossible = (darker > reference) | (brighter > LEVELS - 1 - reference) | ((darker > 0) & (brighter > 0))
    if impossible.any():
        raise NotAMixedImage(
            expected="blue the reference, green 3 times brighter and red 3 times darker",
            got=f"{impossible.mean():.1%} of the pixels that cannot be",
            remedy="give the PNG files of mixed_image as the original's collect_data.py saved them",
        )
    darker, brighter, reference = (part.astype(np.float32) for part in (darker, brighter, reference))
    return Deformation(darker, brighter, reference, mm_per_px, stamp_ns)


def to_whole_grey_levels(image: UInt8[Array, "rows cols *bgr"], mm_per_px: float, stamp_ns: int = 0) -> Rectified:
    """Return a stored rectified image, BGR or grey, in whole grey levels as in the original project."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return Rectified(np.asarray(grey, np.float32), mm_per_px, stamp_ns)


def render_brightness_change(deformation: Deformation) -> UInt8[Array, "rows cols 3"]:
    """Return an image (BGR) for display: red where darker, green where brighter, black where nothing changed."""
    green = cv2.convertScaleAbs(deformation.brighter, alpha=GREEN_PER_LEVEL)
    red = cv2.convertScaleAbs(deformation.darker, alpha=RED_PER_LEVEL)
    return np.asarray(cv2.merge([np.zeros_like(green), green, red]))


def require_same_pixel_grid(rectified: Rectified, reference: Rectified) -> None:
    """Raise `InputError` where an image and its reference differ in size or in mm per pixel."""
    sizes = [format_image_size(image.grey) for image in (rectified, reference)]
    scales = rectified.mm_per_px, reference.mm_per_px
    if sizes[0] != sizes[1] or abs(scales[0] / scales[1] - 1) > SAME_SCALE:
        raise InputError(
            expected="an image and its reference alike",
            got=f"{sizes[0]} at {scales[0]:.4f} and {sizes[1]} at {scales[1]:.4f} mm per pixel",
            remedy="take the reference from the same sensor and session",
        )


def require_aspect(shape: tuple[int, int], wanted: tuple[int, int]) -> None:
    """Raise `InputError` for a size whose aspect ratio is off by more than one row, so that pixels would not be square."""
    rows, cols = shape
    fitting = rows * wanted[1] / cols
    if min(wanted) < 1 or abs(wanted[0] - fitting) > 1:
        raise InputError(
            expected=f"a size with the sides of {cols} x {rows} pixels",
            got=f"{wanted[1]} x {wanted[0]}",
            remedy=f"ask for {max(wanted[1], 1)} x {max(round(fitting), 1)}",
        )


def format_image_size(grey: Shaped[Array, "rows cols"]) -> str:
    """Return the columns and rows of an image as text."""
    return f"{grey.shape[1]} x {grey.shape[0]} pixels"

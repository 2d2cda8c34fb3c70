"""The positions of the pin imprints, located on the skin rather than in the image, and which of the pins are detected.

Each imprint is resampled through the lens model as seen from straight above. There it is round, its window is a disc, and its
centroid is not biased by the oblique view. Lens and centres are refined in turn. `measure_pins` searches every pin where a lens
predicts it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.lens_fit import LensFit
from ninedtact.design import PinBoard
from ninedtact.shape.lens_and_rectification import LensModel, Points, Projection, central_mm_per_px

_PATCH_SAMPLES = 41
"""Number of samples across a patch."""
_MIN_RELATIVE_DARKENING = 0.2
"""Fraction of an imprint's depth below which darkening is ignored, because the skirts of neighbouring imprints overlap."""
_CENTROID_ITERATIONS = 5
_PROFILE_RINGS = 26
"""Number of rings of an imprint's radial profile."""


@dataclass(frozen=True)
class _PinPatches:
    """Square patches of the skin around n points, seen from straight above."""

    darkening: Float[Array, "n samples samples"]
    """Darkening below the plane through the ring around each patch, zero and above."""
    x_mm: Float[Array, "samples samples"]
    y_mm: Float[Array, "samples samples"]

    @property
    def depth(self) -> Float[Array, " n"]:
        """Contrast of each imprint, in the image's unit."""
        return self.darkening.max(axis=(1, 2))

    @property
    def centroid_mm(self) -> Points:
        """Return the centre of what is darker than `_MIN_RELATIVE_DARKENING` of each imprint's depth, about the patch's centre."""
        weight = np.maximum(self.darkening - _MIN_RELATIVE_DARKENING * self.depth[:, None, None], 0)
        total = np.maximum(weight.sum(axis=(1, 2)), 1e-12)
        return np.column_stack([(weight * axis).sum(axis=(1, 2)) / total for axis in (self.x_mm, self.y_mm)])


def locate_imprints_mm(
    image: Float32[Array, "rows cols"], lens: Projection, points_mm: Points, radius_mm: float
) -> Points:
    """Return the centres on the skin of the imprints near these points, through this lens."""
    for _ in range(_CENTROID_ITERATIONS):
        points_mm = points_mm + _extract_pin_patches(image, lens, points_mm, radius_mm).centroid_mm
    return points_mm


def imprint_radius_mm(
    image: Float32[Array, "rows cols"], lens: Projection, points_mm: Points, radius_mm: float
) -> float:
    """Return the radius at which imprints with these centres are half as dark as in the middle, the median over the pins."""
    patches = _extract_pin_patches(image, lens, points_mm, radius_mm)
    ring = (np.hypot(patches.x_mm, patches.y_mm) / radius_mm * _PROFILE_RINGS).astype(int).ravel()
    inside = ring < _PROFILE_RINGS
    count = np.bincount(ring[inside])
    middles_mm = (np.arange(_PROFILE_RINGS) + 0.5) * radius_mm / _PROFILE_RINGS
    radii = []
    for darkening, depth in zip(patches.darkening, patches.depth, strict=True):
        profile = np.bincount(ring[inside], darkening.ravel()[inside]) / count / depth
        outer = int(np.argmax(profile < 0.5))  # the last ring is on the edge of the disc, where it is zero
        radii.append(np.interp(0.5, profile[[outer, outer - 1]], middles_mm[[outer, outer - 1]]))
    return float(np.median(radii))


def _extract_pin_patches(
    image: Float32[Array, "rows cols"], lens: Projection, points_mm: Points, radius_mm: float
) -> _PinPatches:
    """Return the patches of the skin around each point, resampled through the lens within a disc."""
    axis = np.linspace(-radius_mm, radius_mm, _PATCH_SAMPLES)
    x, y = np.meshgrid(axis, axis)
    offsets = np.column_stack([x.ravel(), y.ravel()])
    source = lens.to_px((points_mm[:, None] + offsets).reshape(-1, 2)).astype(np.float32)
    seen = _sample_bilinear(image, source).reshape(len(points_mm), _PATCH_SAMPLES, _PATCH_SAMPLES)
    distance = np.hypot(x, y)
    ring = (distance > 0.85 * radius_mm) & (distance <= radius_mm)
    darker = _fit_ring_plane(seen, ring, x, y) - seen
    return _PinPatches(np.maximum(darker, 0) * (distance <= radius_mm), x, y)


def _fit_ring_plane(
    seen: Float32[Array, "n samples samples"],
    ring: Bool[Array, "samples samples"],
    x_mm: Float[Array, "samples samples"],
    y_mm: Float[Array, "samples samples"],
) -> Float[Array, "n samples samples"]:
    """Return the plane through each patch's ring: the background without the pin, with any gradient of a glare."""
    ones = np.ones_like(x_mm)
    columns = np.stack([ones, x_mm, y_mm])
    on_ring = columns[:, ring]
    planes = np.linalg.solve(on_ring @ on_ring.T, on_ring @ seen[:, ring].T)
    return np.tensordot(planes.T, columns, axes=1)


def _sample_bilinear(image: Float32[Array, "rows cols"], points_px: Float32[Array, "n 2"]) -> Float32[Array, " n"]:
    """Return bilinear samples; the points are arranged in two dimensions because OpenCV limits the sides of a map."""
    side = int(np.ceil(np.sqrt(len(points_px))))
    padded = np.resize(points_px, (side, side, 2))
    field = cv2.remap(image, padded[..., 0], padded[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(field).ravel()[: len(points_px)]


IMPRINT_RADIUS_PITCHES = 0.52
"""Radius of the disc in which a centre is sought, in pitches; it is as large as fits without the neighbours."""
_MIN_RELATIVE_CONTRAST = 0.12
"""Contrast, relative to the median pin, below which a pin is not detected."""
_MIN_CONTRAST_TO_NOISE = 1.5
"""Contrast, in standard deviations of a lightly smoothed pixel, below which a pin is not detected."""
_MAX_OFFSET_PITCHES = 0.25
"""Largest distance of a centre from its predicted position, in pitches; anything farther away is not the pin."""
_STRAY_ERROR_PITCHES, _STRAY_ERROR_RATIO = 0.10, 5.0
"""A pin is rejected (glare, dirt) where its leave-one-out error exceeds this many pitches and this many times the median."""


def measure_pins(
    image: Float32[Array, "rows cols"], lens: LensModel, points_mm: Points, noise: float, board: PinBoard
) -> tuple[Points, Float[Array, " n"], Bool[Array, " n"]]:
    """Return centre and contrast of the imprint at each pin's place, and whether it counts as detected."""
    radius_mm = IMPRINT_RADIUS_PITCHES * board.pitch_mm
    seen_mm = locate_imprints_mm(image, lens, points_mm, radius_mm)
    points_px = lens.to_px(seen_mm)
    contrast = _extract_pin_patches(image, lens, seen_mm, radius_mm).depth
    near = np.hypot(*(seen_mm - points_mm).T) < _MAX_OFFSET_PITCHES * board.pitch_mm
    margin_px = board.pin_diameter_mm / 2 / central_mm_per_px(lens, board.pitch_mm)
    dark = contrast > max(_MIN_RELATIVE_CONTRAST * float(np.median(contrast)), _MIN_CONTRAST_TO_NOISE * noise)
    return points_px, contrast, dark & near & _is_inside_image(points_px, image.shape, margin_px)


def _is_inside_image(points_px: Points, shape: tuple[int, ...], margin_px: float) -> Bool[Array, " n"]:
    """Return whether these pixels are inside the image with a margin of a pin's width."""
    x, y = points_px.T
    rows, cols = shape
    return (x >= margin_px) & (y >= margin_px) & (x <= cols - 1 - margin_px) & (y <= rows - 1 - margin_px)


def find_stray_pins(fit: LensFit, board: PinBoard) -> Bool[Array, " n"]:
    """Return the pins that contradict the fit to all others."""
    error_mm = np.hypot(*fit.leave_one_out_errors_mm.T)
    return error_mm > max(_STRAY_ERROR_PITCHES * board.pitch_mm, _STRAY_ERROR_RATIO * float(np.median(error_mm)))

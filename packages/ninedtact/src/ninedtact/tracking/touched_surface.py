"""The part of a height map that an object shapes: where it holds the skin down, and beside it.

Where an object holds the skin, the height of the skin is that of the object's surface. Beside it the skin hangs free, but steeply,
and falls to the object's outline: on a flat face, that is all that shows where it is and how far it has turned. Both change a
little while skin is dragged along, smoothly, because the gel is thick (`smooth_fields`).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap, HeightSource, centred_axis_mm

BESIDE_MM = 0.4
"""Width of the skin beside the object that is compared too."""
SMOOTHING_MM = 0.1
"""Standard deviation of the smoothing of heights before slopes are taken."""
_POINT_PITCH_MM = 0.25
"""Distance of the points that are compared."""
_MIN_POINTS, _MAX_POINTS = 60, 3000
_SHORTEST_WAVE_MM = 6.0
"""Wavelength from which a change of heights is smooth: more than twice the thickness of the gel."""
_FREE = 4.0
"""How many times more the skin may change beside the object than where it is held."""
_MARGIN_MM = 1.0
"""Distance beyond the points at which the waves have their crests."""


@dataclass(frozen=True)
class TouchedSurface:
    """The skin that an object shapes, in one reading: smoothed heights and slopes on pixels, and points of it."""

    z_mm: Float32[Array, "rows cols"]
    slope_x: Float32[Array, "rows cols"]
    slope_y: Float32[Array, "rows cols"]
    is_shaped: Float32[Array, "rows cols"]
    """One where the object holds the skin and beside it, zero elsewhere."""
    mm_per_px: float
    camera_distance_mm: float
    points_mm: Float[Array, "n 3"]
    """Points of the surface in the sensor's frame."""
    point_area_mm2: float
    """Area for which one point stands."""
    is_beside: Bool[Array, " n"]
    """Whether a point lies beside the object, where the skin hangs free."""

    @cached_property
    def centre_mm(self) -> Float[Array, "3"]:
        """The mean of the points."""
        return self.points_mm.mean(axis=0)

    @cached_property
    def radius_of_gyration_mm(self) -> float:
        """Root mean square distance of the points from their centre."""
        return float(np.sqrt(((self.points_mm - self.centre_mm) ** 2).sum(axis=1).mean()))

    @cached_property
    def smooth_fields(self) -> Float[Array, "n fields"]:
        """Heights at the points by which skin may change smoothly: cosines, whose sum has a standard deviation of one under the
        object where each has an independent coefficient of this deviation."""
        places = self.points_mm[:, :2]
        corner_mm, sides_mm = places.min(axis=0) - _MARGIN_MM, np.ptp(places, axis=0) + 2 * _MARGIN_MM
        along = [np.arange(int(2 * side / _SHORTEST_WAVE_MM) + 1) for side in sides_mm]
        x, y = (
            np.cos(np.pi * np.outer(place, number))
            for place, number in zip(((places - corner_mm) / sides_mm).T, along, strict=True)
        )
        per_mm = np.hypot(along[0][:, None] / sides_mm[0], along[1] / sides_mm[1]) / 2
        fields = (x[:, :, None] * y[:, None, :])[:, per_mm <= 1 / _SHORTEST_WAVE_MM]
        size = np.where(self.is_beside, _FREE, 1.0) / np.sqrt((fields**2).mean(axis=0).sum())
        return np.asarray(fields * size[:, None])

    def sample(self, points_mm: Float[Array, "n 3"]) -> Float[Array, "4 n"]:
        """Return height, slopes along x and y, and whether the skin is shaped, at the lines of sight to these points."""
        rows, cols = self.z_mm.shape
        scale = (1 + points_mm[:, 2] / self.camera_distance_mm) * self.mm_per_px
        at = (
            (points_mm[:, axis] / scale + (side - 1) / 2).astype(np.float32)[None]
            for axis, side in ((0, cols), (1, rows))
        )
        x, y = at
        return cv2.remap(self._fields, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)[0].T.astype(float)

    @cached_property
    def _fields(self) -> Float32[Array, "rows cols 4"]:
        """Everything that `sample` returns, as the channels of one image."""
        return np.asarray(cv2.merge([self.z_mm, self.slope_x, self.slope_y, self.is_shaped]))


def extract_touched_surface(height: HeightMap, contact: Bool[Array, "rows cols"]) -> TouchedSurface | None:
    """Return the skin that is shaped by what touches; None where too little of it is measured to compare.

    contact: the pixels at which an object holds the skin (`Reading.contact`).
    """
    px = height.mm_per_px
    shaped = _shaped_pixels(height, contact)
    every_pixel = max(round(_POINT_PITCH_MM / px), 1)
    rows, cols = (number * every_pixel for number in np.nonzero(shaped[::every_pixel, ::every_pixel]))
    if len(rows) < _MIN_POINTS:
        return None
    every_point = -(-len(rows) // _MAX_POINTS)
    rows, cols = rows[::every_point], cols[::every_point]
    smoothed = replace(height, z_mm=cv2.GaussianBlur(height.z_mm, (0, 0), SMOOTHING_MM / px))
    return TouchedSurface(
        smoothed.z_mm,
        *_slopes(smoothed),
        shaped.astype(np.float32),
        px,
        height.camera_distance_mm,
        smoothed.points_at(rows, cols),
        (every_pixel * px) ** 2 * every_point,
        ~contact[rows, cols],
    )


def _shaped_pixels(height: HeightMap, contact: Bool[Array, "rows cols"]) -> UInt8[Array, "rows cols"]:
    """Return one where the skin is measured and is held by an object or beside it, zero elsewhere."""
    beside_px = 2 * max(round(BESIDE_MM / height.mm_per_px), 1) + 1
    measured = cv2.erode((height.source == HeightSource.MEASURED.value).astype(np.uint8), np.ones((3, 3), np.uint8))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (beside_px, beside_px))
    return np.asarray(cv2.bitwise_and(measured, cv2.dilate(contact.astype(np.uint8), disc)))


def _slopes(height: HeightMap) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
    """Return the slopes of the skin along x and y."""
    z_mm, px = height.z_mm, height.mm_per_px
    u, v = (centred_axis_mm(side, px) for side in z_mm.shape[::-1])
    along_u, along_v = (cv2.Sobel(z_mm, cv2.CV_32F, *order, ksize=3, scale=1 / (8 * px)) for order in ((1, 0), (0, 1)))
    # Pixels are lines of sight, which meet deep skin closer together (shape.surface).
    spread = 1 + (z_mm + u * along_u + v[:, None] * along_v) / height.camera_distance_mm
    return np.asarray(along_u / spread, np.float32), np.asarray(along_v / spread, np.float32)

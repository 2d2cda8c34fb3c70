"""The part of a height map that is the surface of the object that touches.

Where an object holds the skin down, the skin lies on it: its height is the height of the object's surface. At the rim, skin hangs
free beside the object, so that the rim is left out.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap, HeightSource

RIM_MM = 0.2
"""Width of the rim that is left out, because skin there hangs free beside the object."""
SMOOTHING_MM = 0.1
"""Standard deviation of the smoothing of heights before slopes are taken."""
_POINT_PITCH_MM = 0.15
"""Distance of the points that are compared."""
_MIN_POINTS, _MAX_POINTS = 60, 5000


@dataclass(frozen=True)
class TouchedSurface:
    """The surface of what touches, in one reading: smoothed heights and slopes on pixels, and points of it."""

    z_mm: Float32[Array, "rows cols"]
    slope_x: Float32[Array, "rows cols"]
    slope_y: Float32[Array, "rows cols"]
    is_held: Float32[Array, "rows cols"]
    """One where the object holds the skin, zero elsewhere."""
    mm_per_px: float
    camera_distance_mm: float
    points_mm: Float[Array, "n 3"]
    """Points of the surface in the sensor's frame."""
    point_area_mm2: float
    """Area for which one point stands."""

    @property
    def centre_mm(self) -> Float[Array, "3"]:
        """The mean of the points."""
        return self.points_mm.mean(axis=0)

    def sample(self, points_mm: Float[Array, "n 3"]) -> Float[Array, "4 n"]:
        """Return height, slopes along x and y, and whether the skin is held, at the lines of sight to these points."""
        rows, cols = self.z_mm.shape
        scale = (1 + points_mm[:, 2] / self.camera_distance_mm) * self.mm_per_px
        at = (
            (points_mm[:, axis] / scale + (side - 1) / 2).astype(np.float32)[None]
            for axis, side in ((0, cols), (1, rows))
        )
        x, y = at
        return np.stack(
            [
                cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)[0]
                for field in (self.z_mm, self.slope_x, self.slope_y, self.is_held)
            ]
        ).astype(float)


def extract_touched_surface(height: HeightMap, contact: Bool[Array, "rows cols"]) -> TouchedSurface | None:
    """Return the surface of what touches; None where too little of it is measured to compare.

    contact: the pixels at which an object holds the skin (`Reading.contact`).
    """
    px = height.mm_per_px
    rim = 2 * max(round(RIM_MM / px), 1) + 1
    measured = contact & (height.source == HeightSource.MEASURED.value)
    held = cv2.erode(measured.astype(np.uint8), np.ones((rim, rim), np.uint8))
    every = max(round(_POINT_PITCH_MM / px), 1)
    rows, cols = (number * every for number in np.nonzero(held[::every, ::every]))
    if len(rows) < _MIN_POINTS:
        return None
    every_point = -(-len(rows) // _MAX_POINTS)
    rows, cols = rows[::every_point], cols[::every_point]
    z_mm = cv2.GaussianBlur(height.z_mm, (0, 0), SMOOTHING_MM / px)
    slope_x, slope_y = (cv2.Sobel(z_mm, cv2.CV_32F, *order, ksize=3, scale=1 / (8 * px)) for order in ((1, 0), (0, 1)))
    points_mm = replace(height, z_mm=z_mm).points_at(rows, cols)
    area_mm2 = (every * px) ** 2 * every_point
    distance_mm = height.camera_distance_mm
    return TouchedSurface(z_mm, slope_x, slope_y, held.astype(np.float32), px, distance_mm, points_mm, area_mm2)

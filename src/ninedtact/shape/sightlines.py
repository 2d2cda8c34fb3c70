"""Where the skin that a pixel sees really is: a pixel of a height map is a line of sight, not a place.

The camera stands under the centre of the skin, at distance D. The line of sight through (u, v) on the untouched plane
meets skin of height z at (x, y) = (u, v)·k with k = 1 + z/D. From the two tangents of that surface along u and v, the
outward normal is along (−dz/du, −dz/dv, n) with n = 1 + (z + u·dz/du + v·dz/dv)/D, and one unit of (u, v) covers k·n
units of (x, y). With D infinite, k = n = 1.
"""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.quantities import Coverage, HeightMap, centred_axis_mm
from ninedtact.shape.slope import slope

Grid = Float32[Array, "rows cols"]

HALVINGS = 16
"""Of the range of all heights, to find the height at a place: down to a tenth of a micrometre."""


def spread(height: HeightMap) -> Grid:
    """k: how much farther from the centre than its pixel the skin is."""
    away = height.z_mm * np.float32(1 / height.camera_distance_mm)
    away += 1
    return np.asarray(away)


def uprightness(height: HeightMap, slope_x: Grid, slope_y: Grid) -> Grid:
    """n: third component of a normal along (−dz/du, −dz/dv, n)."""
    u, v = plane_mm(*height.z_mm.shape, height.mm_per_px)
    rise = u * slope_x
    cv2.accumulateProduct(v, slope_y, rise)
    nearness = 1 / height.camera_distance_mm
    return np.asarray(cv2.addWeighted(rise, nearness, height.z_mm, nearness, 1))


def footprint_mm2(height: HeightMap) -> Grid:
    """Area of the untouched plane above which the skin of each pixel lies."""
    return np.asarray(spread(height) * uprightness(height, *slope(height)) * np.float32(height.mm_per_px**2))


def from_straight_below(height: HeightMap) -> HeightMap:
    """The same skin on a grid of places: each pixel has the height at its own (x, y), as from an infinite distance.

    Places that no line of sight of the map reaches are out of view.
    """
    place = np.stack(plane_mm(*height.z_mm.shape, height.mm_per_px))
    seen_mm = np.where(height.in_view, height.z_mm, np.float32(0))
    low, high = (np.full_like(seen_mm, end) for end in (seen_mm.min(), seen_mm.max()))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        above = middle > sampled(seen_mm, pixel_of(height, place, middle), cv2.INTER_LINEAR)
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    pixel = pixel_of(height, place, (low + high) / 2)
    z_mm, coverage = sampled(seen_mm, pixel, cv2.INTER_LINEAR), sampled(height.coverage, pixel, cv2.INTER_NEAREST)
    return replace(height, z_mm=z_mm, coverage=coverage, camera_distance_mm=np.inf)


def pixel_of(height: HeightMap, place_mm: Float32[Array, "2 rows cols"], z_mm: Grid) -> Float32[Array, "2 rows cols"]:
    """Column and row that see skin of these heights at these places."""
    rows, cols = height.z_mm.shape
    plane = place_mm / (1 + z_mm * np.float32(1 / height.camera_distance_mm))
    middle = np.array([(cols - 1) / 2, (rows - 1) / 2], np.float32)[:, None, None]
    return np.asarray(plane / np.float32(height.mm_per_px) + middle)


def sampled(field: Array, pixel: Float32[Array, "2 rows cols"], interpolation: int) -> Array:
    """A field between its pixels; heights repeat beyond the border, coverage ends there."""
    end = cv2.BORDER_CONSTANT if field.dtype == np.uint8 else cv2.BORDER_REPLICATE
    return np.asarray(
        cv2.remap(field, pixel[0], pixel[1], interpolation, borderMode=end, borderValue=Coverage.OUT_OF_VIEW)
    )


@lru_cache(maxsize=8)
def plane_mm(rows: int, cols: int, mm_per_px: float) -> tuple[Grid, Grid]:
    """Coordinates of every pixel on the untouched plane; read-only, as every caller gets the same two arrays."""
    x, y = np.meshgrid(centred_axis_mm(cols, mm_per_px), centred_axis_mm(rows, mm_per_px))
    for plane in (x, y):
        plane.flags.writeable = False
    return x, y

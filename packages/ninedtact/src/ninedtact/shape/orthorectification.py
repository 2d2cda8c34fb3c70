"""Orthorectification: from heights along lines of sight to heights at places of the skin.

A pixel of a height map is a line of sight, not a place. The camera stands under the centre of the skin, at distance D. The line of
sight through (u, v) on the plane of the untouched skin meets skin of height z at (x, y) = (u, v)·(1 + z/D). The height at a place
is therefore found at the pixel of (x, y) / (1 + z/D), which is an equation for z. Two solvers are used:

* bisection on the map's own grid (`orthorectify`), which converges however steep the skin is;
* fixed-point iteration (`find_pixels_of_skin_places`), which is fast, and whose error shrinks in each iteration by the slope of
  the skin times the slope of the line of sight. Coarse grids of heights are smooth enough for it.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.quantities import HeightMap, HeightSource, skin_grid_mm

Grid = Float32[Array, "rows cols"]
Places = Float32[Array, "2 rows cols"]
"""x and y in mm, or column and row, of every point of a grid."""

_BISECTIONS = 16
"""Number of bisections of the range of all heights; 16 give a tenth of a micrometre."""
_GRID_ITERATIONS = 4
"""Number of fixed-point iterations on the grid of a network's input; more would help only where the skin is steepest."""


@dataclass(frozen=True)
class SkinGrid:
    """A grid of square pixels about the centre of the skin."""

    rows: int
    cols: int
    mm_per_px: float


@checks_arguments
def orthorectify(height: HeightMap) -> HeightMap:
    """Return the same skin with the height at each pixel's own (x, y), as a camera at infinite distance would see it.

    Places that no line of sight of the map reaches are out of view.
    """
    place_mm = np.stack(skin_grid_mm(height.z_mm.shape, height.mm_per_px))
    seen_mm = np.where(height.in_view, height.z_mm, np.float32(0))
    low, high = (np.full_like(seen_mm, end) for end in (seen_mm.min(), seen_mm.max()))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        above = middle > sample_field(seen_mm, _pixels_of_map(height, place_mm, middle), cv2.INTER_LINEAR)
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    pixel = _pixels_of_map(height, place_mm, (low + high) / 2)
    z_mm = sample_field(seen_mm, pixel, cv2.INTER_LINEAR)
    source = sample_field(height.source, pixel, cv2.INTER_NEAREST)
    return replace(height, z_mm=z_mm, source=source, camera_distance_mm=np.inf)


def orthorectified_heights(height: HeightMap, grid: SkinGrid) -> Grid:
    """Return the heights in mm at the places of a coarse grid; beyond the view the heights of its border are repeated."""
    field, pitch_mm = _average_to_pitch(height, grid.mm_per_px)
    place_mm = np.stack(skin_grid_mm((grid.rows, grid.cols), grid.mm_per_px))
    pixel = find_pixels_of_skin_places(field, pitch_mm, place_mm, height.camera_distance_mm, _GRID_ITERATIONS)
    return np.asarray(sample_field(field, pixel, cv2.INTER_CUBIC))


def find_pixels_of_skin_places(
    z_mm: Float32[Array, "map_rows map_cols"],
    pitch_mm: tuple[float, float],
    place_mm: Places,
    camera_distance_mm: float,
    iterations: int,
) -> Places:
    """Return column and row of the line of sight that meets the skin at each place, by fixed-point iteration.

    z_mm: heights along lines of sight, on pixels of pitch_mm along x and y. place_mm: x and y of the places.
    """
    found_mm = np.zeros_like(place_mm[0])
    for _ in range(iterations):
        pixel = _pixels_of_places(z_mm.shape, pitch_mm, place_mm, found_mm, camera_distance_mm)
        found_mm = sample_field(z_mm, pixel, cv2.INTER_LINEAR)
    return _pixels_of_places(z_mm.shape, pitch_mm, place_mm, found_mm, camera_distance_mm)


def sample_field(field: Array, pixel: Places, interpolation: int) -> Array:
    """Interpolate a field at columns and rows. Beyond the border heights (float32) repeat, and height sources (uint8) are out of
    view."""
    border = cv2.BORDER_CONSTANT if field.dtype == np.uint8 else cv2.BORDER_REPLICATE
    return np.asarray(
        cv2.remap(field, pixel[0], pixel[1], interpolation, borderMode=border, borderValue=HeightSource.OUT_OF_VIEW)
    )


def _pixels_of_map(height: HeightMap, place_mm: Places, z_mm: Grid) -> Places:
    """Return column and row of a height map's pixels that see skin of these heights at these places."""
    pitch_mm = height.mm_per_px, height.mm_per_px
    return _pixels_of_places(height.z_mm.shape, pitch_mm, place_mm, z_mm, height.camera_distance_mm)


def _pixels_of_places(
    shape: tuple[int, int], pitch_mm: tuple[float, float], place_mm: Places, z_mm: Grid, camera_distance_mm: float
) -> Places:
    """Return column and row of the line of sight through skin of these heights at these places."""
    rows, cols = shape
    plane_mm = place_mm / (1 + z_mm * np.float32(1 / camera_distance_mm))
    pitch, middle = (np.array(pair, np.float32)[:, None, None] for pair in (pitch_mm, ((cols - 1) / 2, (rows - 1) / 2)))
    return np.asarray(plane_mm / pitch + middle)


def _average_to_pitch(height: HeightMap, mm_per_px: float) -> tuple[Grid, tuple[float, float]]:
    """Return heights averaged over pixels of about this size, and the exact pitch in mm along x and y.

    The pixels fit the map a whole number of times, so that they need not be quite square.
    """
    sides = height.z_mm.shape[1], height.z_mm.shape[0]
    fewer = tuple(max(round(side * height.mm_per_px / mm_per_px), 1) for side in sides)
    small = height.z_mm if fewer == sides else cv2.resize(height.z_mm, fewer, interpolation=cv2.INTER_AREA)
    pitch = [side * height.mm_per_px / less for side, less in zip(sides, fewer, strict=True)]
    return np.asarray(small), (pitch[0], pitch[1])

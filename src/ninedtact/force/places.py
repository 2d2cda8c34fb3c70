"""Heights on a coarse grid of places: lines of sight undone at next to no cost.

The line of sight through pixel P sees the skin at X = P·(1 + z/D), D the camera's distance (`shape.sightlines`), so the height at
place X is looked for at P = X / (1 + z/D). The search runs on the coarse grid alone.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap, centred_axis_mm

STEPS = 5
"""Of the search for the pixel that sees a place; more would help only where the skin is steepest."""
Grid = Float32[Array, "rows cols"]


@dataclass(frozen=True)
class PlaceGrid:
    """Square pixels about the skin's centre."""

    rows: int
    cols: int
    mm_per_px: float


def heights_at_places(height: HeightMap, grid: PlaceGrid) -> Grid:
    """Heights in mm on a grid of places, lines of sight undone; beyond the view they repeat."""
    seen = shrunk(height, grid.mm_per_px)
    nearness = np.float32(1 / height.camera_distance_mm)
    place = places(grid)
    z_mm = np.zeros(place.shape[1:], np.float32)
    for step in range(STEPS):
        last = step == STEPS - 1
        z_mm = seen.at(place / (1 + z_mm * nearness), cv2.INTER_CUBIC if last else cv2.INTER_LINEAR)
    return z_mm


@dataclass(frozen=True)
class Shrunk:
    """A field on larger pixels, which need not be quite square."""

    field: Grid
    pitch_mm: tuple[float, float]
    """Along x and along y."""

    def at(self, plane_mm: Float32[Array, "2 rows cols"], interpolation: int) -> Grid:
        """Its values at points x, y of the untouched plane."""
        rows, cols = self.field.shape
        x, y = (
            plane_mm[axis] / np.float32(self.pitch_mm[axis]) + np.float32((side - 1) / 2)
            for axis, side in enumerate((cols, rows))
        )
        return np.asarray(cv2.remap(self.field, x, y, interpolation, borderMode=cv2.BORDER_REPLICATE))


def shrunk(height: HeightMap, mm_per_px: float) -> Shrunk:
    """Means over the area of pixels as near to this size as fit a whole number of times."""
    sides = height.z_mm.shape[1], height.z_mm.shape[0]
    fewer = tuple(max(round(side * height.mm_per_px / mm_per_px), 1) for side in sides)
    small = height.z_mm if fewer == sides else cv2.resize(height.z_mm, fewer, interpolation=cv2.INTER_AREA)
    pitch = [side * height.mm_per_px / less for side, less in zip(sides, fewer, strict=True)]
    return Shrunk(np.asarray(small), (pitch[0], pitch[1]))


def places(grid: PlaceGrid) -> Float32[Array, "2 rows cols"]:
    """x and y of every pixel of a grid."""
    x, y = (centred_axis_mm(side, grid.mm_per_px) for side in (grid.cols, grid.rows))
    return np.stack(np.meshgrid(x, y))

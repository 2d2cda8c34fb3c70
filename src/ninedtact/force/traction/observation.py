"""What one reading shows of the skin, on the cells."""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.force.traction.cells import BEYOND, Cells
from ninedtact.force.traction.refusals import require_view
from ninedtact.quantities import Coverage, HeightMap
from ninedtact.shape.sightlines import pixel_of, sampled

View = Float32[Array, "rows cols"]

NOT_SMOOTH = 0.8
"""Standard deviation that white noise of one keeps when its mean over 3 x 3 cells, weighted 1 2 1, is taken off."""
LOOKS = 5
"""For the line of sight that meets a place."""
OF_MEDIAN = 1.4826
"""Standard deviation of Gaussian noise over the median of its size."""


@dataclass(frozen=True)
class Observation:
    """Fields over the places of the skin, as seen from straight below."""

    change: View
    """Relative change of brightness; mm where heights are what is observed."""
    noise: float
    """Standard deviation of the same from image to image, one cell."""
    error: View
    """What the calibration leaves uncertain in it."""
    z_mm: View
    """Height as the depth reader has it: where to begin, and where contact may be."""
    in_view: View
    """One where a cell is seen, zero where not."""
    beyond: View
    """Part of a cell that is deeper than calibrated."""


def facts(below: HeightMap) -> tuple[View, View]:
    """Heights, and one where they are in view."""
    return below.z_mm, below.in_view.astype(np.float32)


def placed(height: HeightMap, cells: Cells) -> tuple[HeightMap, Float32[Array, "2 rows cols"], View]:
    """The map on the cells' places; where, on a grid of lines of sight as coarse, each place is seen; what is too deep."""
    require_view(bool(height.in_view.any()))
    seen = part(height.coverage != Coverage.OUT_OF_VIEW.value, cells) * on_image(cells)
    coverage = np.where(seen > 0.5, Coverage.MEASURED, Coverage.OUT_OF_VIEW).astype(np.uint8)
    coarse = replace(height, z_mm=shrunk(height.z_mm, cells), coverage=coverage, mm_per_px=cells.pitch_mm)
    pixel = pixel_meeting(coarse, np.stack(cells.places_mm))
    coverage = np.asarray(sampled(coverage, pixel, cv2.INTER_NEAREST))
    below = replace(coarse, z_mm=seen_at(coarse.z_mm, pixel), coverage=coverage, camera_distance_mm=np.inf)
    return below, pixel, seen_at(part(height.coverage == Coverage.EXTRAPOLATED.value, cells), pixel)


def pixel_meeting(height: HeightMap, place_mm: Float32[Array, "2 rows cols"]) -> Float32[Array, "2 rows cols"]:
    """Column and row of the line of sight that meets the skin at each place: guess its height, look there, and again.

    Every look comes nearer by the skin's slope times the line's, of which the latter is at most 0.9; the cells are steep nowhere.
    """
    z_mm, seen_mm = np.zeros_like(place_mm[0]), np.where(height.in_view, height.z_mm, np.float32(0))
    for _ in range(LOOKS):
        z_mm = seen_at(seen_mm, pixel_of(height, place_mm, z_mm))
    return pixel_of(height, place_mm, z_mm)


def part(where: Bool[Array, "a b"], cells: Cells) -> View:
    """Of every cell; mostly it is all of every cell, or none."""
    if where.all() or not where.any():
        return np.full(cells.shape, where.flat[0], np.float32)
    return shrunk(where.astype(np.float32), cells)


def seen_at(field: View, pixel: Float32[Array, "2 rows cols"]) -> View:
    """A field of lines of sight at the places that they meet."""
    return np.asarray(sampled(field, pixel, cv2.INTER_LINEAR), np.float32)


def shrunk(field: Float32[Array, "a b"], cells: Cells) -> View:
    """Means over the cells; beyond the image its border is repeated."""
    down, across = (averaging(*sides) for sides in zip(field.shape, cells.image_shape, strict=True))
    return down @ field @ across.T


@lru_cache(maxsize=16)
def averaging(pixels: int, cells: int) -> Float32[Array, "view pixels"]:
    """Part of each cell that lies on each pixel, along one axis."""
    ends = np.arange(cells + 1) * (pixels / cells)
    until = np.clip(ends[:, None] - np.arange(pixels), 0, 1)
    inside = np.diff(until, axis=0) * (cells / pixels)
    return np.pad(inside, ((BEYOND, BEYOND), (0, 0)), mode="edge").astype(np.float32)


def on_image(cells: Cells) -> Float32[Array, "rows cols"]:
    """One on the image's cells, zero around it."""
    return np.pad(np.ones(cells.image_shape, np.float32), BEYOND)


def roughness(field: Float[Array, "rows cols"]) -> float:
    """Noise of one cell, by what is not smooth in most cells: contacts are few, or smooth."""
    smooth = cv2.GaussianBlur(field, (3, 3), 0.85)
    return float(np.median(np.abs(field - smooth))) * OF_MEDIAN / NOT_SMOOTH

"""What one reading shows of the skin, on the cells."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.force.traction.cells import BEYOND, Cells
from ninedtact.force.traction.refusals import require_view
from ninedtact.quantities import Coverage, HeightMap
from ninedtact.shape.sightlines import from_straight_below, pixel_of, sampled

View = Float32[Array, "rows cols"]

NOT_SMOOTH = 0.8
"""Standard deviation that white noise of one keeps when its mean over 3 x 3 cells, weighted 1 2 1, is taken off."""
OF_MEDIAN = 1.4826
"""Standard deviation of Gaussian noise over the median of its size."""


@dataclass(frozen=True)
class Observation:
    """Fields over the places of the skin, as seen from straight below."""

    change: View
    """Relative change of brightness; mm where heights are what is observed."""
    noise: float
    """Standard deviation of the same from picture to picture, one cell."""
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
    seen = part(height.coverage != Coverage.OUT_OF_VIEW.value, cells) * on_picture(cells)
    coverage = np.where(seen > 0.5, Coverage.MEASURED, Coverage.OUT_OF_VIEW).astype(np.uint8)
    coarse = replace(height, z_mm=shrunk(height.z_mm, cells), coverage=coverage, mm_per_px=cells.pitch_mm)
    below = from_straight_below(coarse)
    pixel = pixel_of(coarse, np.stack(cells.places_mm), below.z_mm)
    return below, pixel, seen_at(part(height.coverage == Coverage.EXTRAPOLATED.value, cells), pixel)


def part(where: Bool[Array, "a b"], cells: Cells) -> View:
    """Of every cell; mostly it is all of every cell, or none."""
    if where.all() or not where.any():
        return np.full(cells.shape, where.flat[0], np.float32)
    return shrunk(where.astype(np.float32), cells)


def seen_at(field: View, pixel: Float32[Array, "2 rows cols"]) -> View:
    """A field of lines of sight at the places that they meet."""
    return np.asarray(sampled(field, pixel, cv2.INTER_LINEAR), np.float32)


def shrunk(field: Float32[Array, "a b"], cells: Cells) -> View:
    """Means over the cells; beyond the picture its border is repeated."""
    inside = cv2.resize(field, cells.picture_shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.copyMakeBorder(inside, *(BEYOND,) * 4, cv2.BORDER_REPLICATE), np.float32)


def on_picture(cells: Cells) -> Float32[Array, "rows cols"]:
    """One on the picture's cells, zero around it."""
    inside = np.ones(cells.picture_shape, np.float32)
    return np.asarray(cv2.copyMakeBorder(inside, *(BEYOND,) * 4, cv2.BORDER_CONSTANT, value=0.0), np.float32)


def roughness(field: Float[Array, "rows cols"]) -> float:
    """Noise of one cell, by what is not smooth in most cells: contacts are few, or smooth."""
    smooth = cv2.GaussianBlur(field, (3, 3), 0.85)
    return float(np.median(np.abs(field - smooth))) * OF_MEDIAN / NOT_SMOOTH

"""How steep the skin is: its slope along x and along y, in mm of height per mm."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int
from numpy import ndarray as Array
from numpy.lib.stride_tricks import sliding_window_view

from ninedtact.quantities import Coverage, HeightMap

Grid = Float32[Array, "rows cols"]

SOBEL_WEIGHT = 8.0
"""Sobel's difference spans two pixels and is summed over three lines with weights 1, 2, 1."""
LINES = np.array([[1], [2], [1]], np.float32)
NEIGHBOURHOOD = np.ones((3, 3), np.uint8)


def slope(height: HeightMap) -> tuple[Grid, Grid]:
    """Slopes dz/dx and dz/dy (mm/mm), by Sobel's differences; heights out of view take no part."""
    along_x, along_y = slope_everywhere(height.z_mm, height.mm_per_px)
    if height.coverage.min() == Coverage.OUT_OF_VIEW:
        rows, cols = rim_of_view(height.in_view)
        along_x[rows, cols], along_y[rows, cols] = slope_at(height, rows, cols)
    return along_x, along_y


def slope_everywhere(z_mm: Grid, mm_per_px: float) -> tuple[Grid, Grid]:
    """Both slopes of a grid that is wholly in view."""
    scale = 1 / (SOBEL_WEIGHT * mm_per_px)
    along_x = cv2.Sobel(z_mm, cv2.CV_32F, 1, 0, scale=scale, borderType=cv2.BORDER_REPLICATE)
    along_y = cv2.Sobel(z_mm, cv2.CV_32F, 0, 1, scale=scale, borderType=cv2.BORDER_REPLICATE)
    # At the border the neighbour outside repeats the pixel itself, so half of the difference is missing.
    for border in (along_x[:, 0], along_x[:, -1], along_y[0], along_y[-1]):
        border *= 2
    return along_x, along_y


def rim_of_view(seen: Bool[Array, "rows cols"]) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """Rows and columns of the pixels in view that have a neighbour out of view."""
    surrounded = cv2.erode(seen.view(np.uint8), NEIGHBOURHOOD).view(bool)
    # numpy finds places in one dimension ten times faster than in two.
    rows, cols = np.unravel_index(np.flatnonzero(seen & ~surrounded), seen.shape)
    return rows, cols


def slope_at(
    height: HeightMap, rows: Int[Array, " n"], cols: Int[Array, " n"]
) -> tuple[Float32[Array, " n"], Float32[Array, " n"]]:
    """Slopes at single pixels, from their neighbours in view alone."""
    z_mm, seen = around(height.z_mm, rows, cols), around(height.in_view, rows, cols)
    along_x = mean_step(z_mm, seen)
    along_y = mean_step(z_mm.transpose(0, 2, 1), seen.transpose(0, 2, 1))
    return along_x / np.float32(height.mm_per_px), along_y / np.float32(height.mm_per_px)


def around(field: Array, rows: Int[Array, " n"], cols: Int[Array, " n"]) -> Array:
    """The 3 x 3 neighbourhoods of single pixels, zeros outside the grid."""
    return np.asarray(sliding_window_view(np.pad(field, 1), (3, 3))[rows, cols])


def mean_step(z_mm: Float32[Array, "n 3 3"], seen: Bool[Array, "n 3 3"]) -> Float32[Array, " n"]:
    """Mean of the steps between columns, weighted as Sobel does, over those whose both ends are seen; 0 without any."""
    both = seen[:, :, 1:] & seen[:, :, :-1]
    steps = np.where(both, np.diff(z_mm, axis=2), np.float32(0))
    weight = (LINES * both).sum(axis=(1, 2))
    return np.asarray((LINES * steps).sum(axis=(1, 2)) / np.maximum(weight, 1))

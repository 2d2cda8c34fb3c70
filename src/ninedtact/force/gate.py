"""Whether anything touches at all: without contact the force is zero, exactly."""

from collections.abc import Callable

import cv2
import numpy as np

from ninedtact.quantities import HeightMap

Touching = Callable[[HeightMap], bool]
CELL_MM = 0.6
"""Skin is pressed in over more than a pixel: means over cells of this size are looked at."""
SHALLOWEST_MM = 0.03
TIMES_NOISE = 6.0


def is_touched(height: HeightMap) -> bool:
    """Some cell of the skin lies deeper than its noise and the calibration's own error would put it."""
    rows, cols = height.z_mm.shape
    cell_px = max(CELL_MM / height.mm_per_px, 1.0)
    size = max(round(cols / cell_px), 1), max(round(rows / cell_px), 1)
    cells = np.asarray(cv2.resize(height.z_mm, size, interpolation=cv2.INTER_AREA))
    return bool(cells.min() < -max(SHALLOWEST_MM, TIMES_NOISE * height.noise_mm))

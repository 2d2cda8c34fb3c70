"""A sensor's rectification as the original project's index maps: of the raw image's size, nearest pixel."""

import numpy as np
from jaxtyping import Float, Int32
from numpy import ndarray as Array

from ninedtact.calibration.record import LensTable, MapTable, PinTable
from ninedtact.calibration.sensor_folder import SensorFolder, projection
from ninedtact.calibration.upstream.layout import OUT_OF_VIEW_PX
from ninedtact.errors import NinedtactError
from ninedtact.shape.rectification import Rectification

Index = Int32[Array, "raw_rows raw_cols"]


class UpstreamCannotHold(NinedtactError):
    """A sensor that the original project's layout has no room for, or a place where it may not be written."""


def index_maps(sensor: SensorFolder) -> tuple[Index, Index, tuple[int, int]]:
    """Row and column of the raw pixel, (0, 0) where the camera sees nothing, and the row and column of the centre."""
    rectify, lens = sensor.rectification, sensor.record.lens
    require_room(rectify)
    start = grid_start(rectify)
    x, y = np.rint(np.moveaxis(extended_px(rectify, lens, start), -1, 0))
    raw_rows, raw_cols = rectify.raw_shape
    seen = (x >= 0) & (x < raw_cols) & (y >= 0) & (y < raw_rows)
    rows, cols = rectify.source_px.shape[:2]
    # The original finds its crop by int(centre - size / 2): for an odd size the centre is one beyond the middle.
    centre = start[0] + (rows + 1) // 2, start[1] + (cols + 1) // 2
    return np.where(seen, y, 0).astype(np.int32), np.where(seen, x, 0).astype(np.int32), centre


def require_room(rectify: Rectification) -> None:
    """Refuse a grid larger than the raw image, whose size the maps have."""
    (rows, cols), (raw_rows, raw_cols) = rectify.source_px.shape[:2], rectify.raw_shape
    if rows > raw_rows or cols > raw_cols:
        raise UpstreamCannotHold(
            f"expected raw images of at least {cols} x {rows} pixels, the size of the rectified one, got "
            f"{raw_cols} x {raw_rows}; calibrate the sensor with larger images"
        )


def grid_start(rectify: Rectification) -> tuple[int, int]:
    """First row and column of the grid in the maps: where its middle lies as in the raw image, if there is room."""
    (rows, cols), (raw_rows, raw_cols) = rectify.source_px.shape[:2], rectify.raw_shape
    x, y = rectify.source_px[rows // 2, cols // 2]
    top = np.clip(round(float(y)) - rows // 2, 0, raw_rows - rows)
    left = np.clip(round(float(x)) - cols // 2, 0, raw_cols - cols)
    return int(top), int(left)


def extended_px(
    rectify: Rectification, lens: LensTable | PinTable | MapTable, start: tuple[int, int]
) -> Float[Array, "raw_rows raw_cols 2"]:
    """Source pixels of the grid, and around it those of the lens; nothing around a grid given pixel by pixel."""
    (top, left), (rows, cols) = start, rectify.source_px.shape[:2]
    extended = np.full((*rectify.raw_shape, 2), OUT_OF_VIEW_PX)
    if not isinstance(lens, MapTable):
        y, x = np.indices(rectify.raw_shape) - np.array([top + (rows - 1) / 2, left + (cols - 1) / 2])[:, None, None]
        points_mm = np.column_stack([x.ravel(), y.ravel()]) * rectify.mm_per_px
        extended = projection(lens, rectify.raw_shape).to_px(points_mm).reshape(extended.shape)
    extended[top : top + rows, left : left + cols] = rectify.source_px
    return extended

"""The calibration folder of the original 9DTact project, as its files stand on the disk (docs/references.md).

    sensor_N/camera_calibration/row_index.npy, col_index.npy    raw pixel that each pixel of the rectified image shows
    sensor_N/camera_calibration/position_scale.npy              row and column of the central pin, mm per pixel
    sensor_N/depth_calibration/Pixel_to_Depth.npy               depth in mm for every grey level of darkening

The rectified image has the raw image's size. What lies outside the raw image shows pixel (0, 0). The size of the
crop about the central pin is not in the folder but in the user's `shape_config.yaml` (`crop_size`, rows first); it
starts at int(centre - size / 2).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int32
from numpy import ndarray as Array

from ninedtact.calibration.upstream.files import (
    UpstreamFolderDamaged,
    read_numbers,
    require_whole_numbers,
    sensor_folder_in,
    write_numbers,
)
from ninedtact.design import FieldOfView

ROW_INDEX = "camera_calibration/row_index.npy"
COL_INDEX = "camera_calibration/col_index.npy"
POSITION_SCALE = "camera_calibration/position_scale.npy"
PIXEL_TO_DEPTH = "depth_calibration/Pixel_to_Depth.npy"
FILES = (ROW_INDEX, COL_INDEX, POSITION_SCALE, PIXEL_TO_DEPTH)

GREY_LEVELS = 256
OUT_OF_VIEW_PX = -1.0
"""Source of a pixel that shows nothing, in our maps."""
COARSEST_MM_PER_PX = 1.0
"""Beyond it the scale is pixels per mm, which the original's own variable name says it is."""


@dataclass(frozen=True)
class UpstreamCalibration:
    """The numbers of one folder."""

    row_index: Int32[Array, "rows cols"]
    col_index: Int32[Array, "rows cols"]
    position_scale: Float[Array, "3"]
    pixel_to_depth_mm: Float[Array, " levels"]

    @property
    def mm_per_px(self) -> float:
        """Scale of the rectified image."""
        return float(self.position_scale[2])

    def start(self, view: FieldOfView) -> tuple[int, int]:
        """First row and column of the crop, cut to whole pixels as the original does."""
        row, col = self.position_scale[:2]
        return int(row - view.rows / 2), int(col - view.cols / 2)

    def source_px(self, view: FieldOfView) -> Float32[Array, "view_rows view_cols 2"]:
        """Raw pixel (x, y) of every pixel of the crop, outside the image where there is none."""
        row, col = self.start(view)
        crop = np.s_[row : row + view.rows, col : col + view.cols]
        source = np.stack([self.col_index[crop], self.row_index[crop]], axis=-1).astype(np.float32)
        source[~source.any(axis=-1)] = OUT_OF_VIEW_PX
        return source


def read_upstream(folder: Path, view: FieldOfView) -> UpstreamCalibration:
    """Read `sensor_N`, or the one `sensor_N` in a folder; raises `UpstreamFolderDamaged`."""
    where = sensor_folder_in(folder, FILES)
    row_index, col_index = read_index(where / ROW_INDEX, 0), read_index(where / COL_INDEX, 1)
    require_one_size(where, row_index.shape, col_index.shape)
    calibration = UpstreamCalibration(
        row_index,
        col_index,
        read_position_scale(where / POSITION_SCALE),
        read_depth_list(where / PIXEL_TO_DEPTH),
    )
    require_crop(where, calibration, view)
    return calibration


def write_upstream(folder: Path, calibration: UpstreamCalibration) -> None:
    """Write the four files into an existing folder; raises `FileNotWritten`."""
    write_numbers(folder / ROW_INDEX, calibration.row_index)
    write_numbers(folder / COL_INDEX, calibration.col_index)
    write_numbers(folder / POSITION_SCALE, calibration.position_scale)
    write_numbers(folder / PIXEL_TO_DEPTH, calibration.pixel_to_depth_mm)


def read_index(path: Path, axis: int) -> Int32[Array, "rows cols"]:
    """An index map that stays inside the raw image, which has the map's own size."""
    index = read_numbers(path, 2)
    require_whole_numbers(path, index)
    size = index.shape[axis]
    if index.min() < 0 or index.max() >= size:
        raise UpstreamFolderDamaged(
            f"expected pixels 0 to {size - 1} in {path}, got {index.min():g} to {index.max():g}; calibrate "
            "the camera again"
        )
    return index.astype(np.int32)


def read_position_scale(path: Path) -> Float[Array, "3"]:
    """Centre row, centre column, and a scale that can be one."""
    numbers = read_numbers(path, 1)
    if numbers.size != 3:
        raise UpstreamFolderDamaged(
            f"expected row, column and mm per pixel in {path}, got {numbers.size} numbers; calibrate the camera again"
        )
    if not 0 < numbers[2] < COARSEST_MM_PER_PX:
        raise UpstreamFolderDamaged(
            f"expected mm per pixel (about 0.05) as the third number of {path}, got {numbers[2]:g}; if that is pixels "
            "per mm, store its inverse"
        )
    return numbers


def read_depth_list(path: Path) -> Float[Array, " levels"]:
    """A list that knows a depth for at least one grey level."""
    depth_mm = read_numbers(path, 1)
    if depth_mm.size > GREY_LEVELS or not (depth_mm[1:] > 0).any():
        raise UpstreamFolderDamaged(
            f"expected depths in mm for up to {GREY_LEVELS} grey levels in {path}, got {depth_mm.size} numbers of "
            f"which {int((depth_mm[1:] > 0).sum())} are depths; calibrate the depth again"
        )
    return depth_mm


def require_one_size(folder: Path, shape: tuple[int, ...], other: tuple[int, ...]) -> None:
    """Refuse maps that do not belong together."""
    if shape != other:
        raise UpstreamFolderDamaged(
            f"expected index maps of one size in {folder}, got {shape} and {other}; calibrate the camera again"
        )


def require_crop(folder: Path, calibration: UpstreamCalibration, view: FieldOfView) -> None:
    """Refuse maps that do not contain the crop."""
    shape = calibration.row_index.shape
    row, col = calibration.position_scale[:2] - np.array([view.rows, view.cols]) / 2
    if row < 0 or col < 0 or row + view.rows > shape[0] or col + view.cols > shape[1]:
        raise UpstreamFolderDamaged(
            f"expected a crop of {view.rows} x {view.cols} (rows x columns) about the central pin inside the "
            f"{shape[0]} x {shape[1]} maps of {folder}, got one that reaches beyond them; give the crop_size of your "
            "shape_config.yaml"
        )

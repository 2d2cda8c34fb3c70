"""Files of the calibration folder of the original 9DTact project (docs/references.md): reading with checks of every array, and
writing.

    sensor_N/camera_calibration/row_index.npy, col_index.npy    raw pixel that each pixel of the rectified image shows
    sensor_N/camera_calibration/position_scale.npy              row and column of the central pin, mm per pixel
    sensor_N/depth_calibration/Pixel_to_Depth.npy               depth in mm for every grey level of darkening

The rectified image has the raw image's size. Pixels outside the raw image have the index (0, 0). The size of the crop about the
central pin is not in the folder but in the user's `shape_config.yaml` (`crop_size`, rows first); it starts at int(centre - size /
2).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int32, Shaped
from numpy import ndarray as Array
from scipy.optimize import isotonic_regression

from ninedtact.atomic_write import write_file_atomically
from ninedtact.calibration.ball.contact_circle import MIN_PRESS_DEPTH_MM
from ninedtact.checked_reading import NPY_READ_ERRORS
from ninedtact.design import RectifiedImageSize
from ninedtact.errors import FileFormatError
from ninedtact.shape.lens_and_rectification import OUT_OF_VIEW_PX

NAME = re.compile(r"sensor_\w+")


def _require(
    holds: bool | np.bool_, expected: str, got: str, remedy: str = "copy the file again or calibrate again"
) -> None:
    """Raise `FileFormatError` where a condition does not hold."""
    if not holds:
        raise FileFormatError(expected=expected, got=got, remedy=remedy)


def find_original_sensor_folder(folder: Path, files: Sequence[str]) -> Path:
    """Return the folder itself where it contains one of the files, or the only `sensor_N` in it."""
    if any((folder / file).exists() for file in files):
        return folder
    inside = sorted(path for path in folder.glob("sensor_*") if path.is_dir() and NAME.fullmatch(path.name))
    _require(
        len(inside) == 1,
        f"{folder} to be a sensor_N folder of the original project, or to hold one",
        ", ".join(path.name for path in inside) if inside else "none" if folder.is_dir() else "no such folder",
        "name the folder that holds camera_calibration and depth_calibration",
    )
    return inside[0]


def read_finite_npy(path: Path, dimensions: int) -> Float[Array, "..."]:
    """Return the finite numbers of a .npy file with this many dimensions; raises `FileFormatError`."""
    array = _load_npy(path)
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        kind = str(getattr(array, "dtype", "an archive"))
        raise FileFormatError(expected=f"an array of numbers in {path}", got=kind, remedy="copy the file again")
    is_shaped = array.ndim == dimensions and array.size > 0
    _require(is_shaped, f"{dimensions} dimension{'s' if dimensions > 1 else ''} in {path}", f"shape {array.shape}")
    numbers = np.array(array, float)
    infinite = int((~np.isfinite(numbers)).sum())
    _require(infinite == 0, f"finite numbers in {path}", f"{infinite} that are not")
    return numbers


def _load_npy(path: Path) -> object:
    """Return the content of a .npy file, memory-mapped, so that a damaged header cannot cause an excessive allocation."""
    remedy = "copy the whole sensor_N folder of the original project"
    _require(path.is_file(), str(path), "no such file", remedy)
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except NPY_READ_ERRORS as trouble:
        first_line = (str(trouble).splitlines() or [type(trouble).__name__])[0]
        raise FileFormatError(
            expected=f"a whole .npy file without Python objects in {path}", got=first_line, remedy="copy the file again"
        ) from trouble


def write_npy(path: Path, numbers: Shaped[Array, "..."]) -> None:
    """Write a .npy file; raises `FileNotWritten`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = BytesIO()
    np.save(content, numbers, allow_pickle=False)
    write_file_atomically(path, content.getvalue())


ROW_INDEX = "camera_calibration/row_index.npy"
COL_INDEX = "camera_calibration/col_index.npy"
POSITION_SCALE = "camera_calibration/position_scale.npy"
PIXEL_TO_DEPTH = "depth_calibration/Pixel_to_Depth.npy"
ORIGINAL_FILES = (ROW_INDEX, COL_INDEX, POSITION_SCALE, PIXEL_TO_DEPTH)

GREY_LEVELS = 256
FINEST_MM_PER_PX, COARSEST_MM_PER_PX = 0.005, 1.0
"""Smallest scale of a sensor, and scale above which the value is pixels per mm, as the original's variable name says."""
_STEP_PX = 8
"""Distance over which the steps of an index map are measured; its whole numbers are uneven from pixel to pixel."""
_MAX_MAGNIFICATION_FACTOR = 6.0
"""Largest factor between the area that a pixel shows and the median of all. It is 2.4 in a real folder of the original project, and
2.2 in the export of real sensors (`export_original_calibration`).
"""
_MAX_WRONG_SHARE = 0.001
"""Fraction of the crop that may be beyond it, for single pixels that were interpolated badly; there are none in these folders."""
_MAX_CENTRE_OFFSET_PX = 8.0
"""Largest distance of the central pin from its pixel in the raw image; it is one pixel in these folders."""
_MAX_BEND = 0.5
"""Largest deviation of a depth list from the straight line to its end, as a fraction of its end; 0.04 in a real folder of the
original project, and 0.12 to 0.15 in the export of real sensors.
"""
_SLOPE_RANGE = 0.004, 0.25
"""Smallest and largest depth in mm per grey level, eight times less and more than that of a real sensor."""
_MAX_FALL_MM = 0.1
"""Largest deviation (RMS) of a depth list from the nearest one that does not fall."""


@dataclass(frozen=True)
class OriginalCalibration:
    """The content of one calibration folder."""

    row_index: Int32[Array, "rows cols"]
    col_index: Int32[Array, "rows cols"]
    position_scale: Float[Array, "3"]
    pixel_to_depth_mm: Float[Array, " levels"]

    @property
    def mm_per_px(self) -> float:
        """Scale of the rectified image."""
        return float(self.position_scale[2])

    def start(self, view: RectifiedImageSize) -> tuple[int, int]:
        """Return the first row and column of the crop, truncated to whole pixels as in the original."""
        row, col = self.position_scale[:2]
        return int(row - view.rows / 2), int(col - view.cols / 2)

    def source_px(self, view: RectifiedImageSize) -> Float32[Array, "view_rows view_cols 2"]:
        """Return the raw pixel (x, y) of every pixel of the crop; `OUT_OF_VIEW_PX` where there is none."""
        row, col = self.start(view)
        crop = np.s_[row : row + view.rows, col : col + view.cols]
        source = np.stack([self.col_index[crop], self.row_index[crop]], axis=-1).astype(np.float32)
        source[~source.any(axis=-1)] = OUT_OF_VIEW_PX
        return source


def read_original_calibration(folder: Path, view: RectifiedImageSize, thickness_mm: float) -> OriginalCalibration:
    """Read `sensor_N`, or the one `sensor_N` in a folder, of a gel of this thickness; raises `FileFormatError`."""
    where = find_original_sensor_folder(folder, ORIGINAL_FILES)
    row_index, col_index = _read_index_map(where / ROW_INDEX, 0), _read_index_map(where / COL_INDEX, 1)
    shapes = row_index.shape, col_index.shape
    _require(shapes[0] == shapes[1], f"index maps of one size in {where}", f"{shapes[0]} and {shapes[1]}")
    calibration = OriginalCalibration(
        row_index,
        col_index,
        _read_position_scale(where / POSITION_SCALE),
        _read_depth_list(where / PIXEL_TO_DEPTH, thickness_mm),
    )
    _require_crop_inside(where, calibration, view)
    _require_lens_maps(where, calibration, view)
    _require_centre_in_place(where, calibration, view)
    return calibration


def write_original_calibration(folder: Path, calibration: OriginalCalibration) -> None:
    """Write the four files into an existing folder; raises `FileNotWritten`."""
    write_npy(folder / ROW_INDEX, calibration.row_index)
    write_npy(folder / COL_INDEX, calibration.col_index)
    write_npy(folder / POSITION_SCALE, calibration.position_scale)
    write_npy(folder / PIXEL_TO_DEPTH, calibration.pixel_to_depth_mm)


def _read_index_map(path: Path, axis: int) -> Int32[Array, "rows cols"]:
    """Return an index map, checked to stay inside the raw image, which has the map's own size."""
    index = read_finite_npy(path, 2)
    _require(bool((index == np.rint(index)).all()), f"whole numbers in {path}", "fractions")
    last, got = index.shape[axis] - 1, f"{index.min():g} to {index.max():g}"
    _require(index.min() >= 0 and index.max() <= last, f"pixels 0 to {last} in {path}", got)
    return index.astype(np.int32)


def _read_position_scale(path: Path) -> Float[Array, "3"]:
    """Return the centre row, the centre column and a plausible scale."""
    numbers = read_finite_npy(path, 1)
    _require(numbers.size == 3, f"row, column and mm per pixel in {path}", f"{numbers.size} numbers")
    _require(
        FINEST_MM_PER_PX < numbers[2] < COARSEST_MM_PER_PX,
        f"mm per pixel (about 0.05) as the third number of {path}",
        f"{numbers[2]:g}",
        "if that is pixels per mm, store its inverse",
    )
    return numbers


def _read_depth_list(path: Path, thickness_mm: float) -> Float[Array, " levels"]:
    """Return a depth list, checked to hold a depth for at least one grey level, none beyond the gel, and to rise."""
    depth_mm = read_finite_npy(path, 1)
    size, known = depth_mm.size, depth_mm[1:][depth_mm[1:] > 0]
    _require(
        size <= GREY_LEVELS and known.size > 0,
        f"depths in mm for up to {GREY_LEVELS} grey levels in {path}",
        f"{size} numbers of which {known.size} are depths",
    )
    _require(
        depth_mm[1:].min() >= 0 and _SLOPE_RANGE[0] <= known.max() / size <= _SLOPE_RANGE[1],
        f"depths in mm, none below zero and about 0.03 mm more for every grey level, in {path}",
        f"{depth_mm[1:].min():g} to {known.max():g} mm for {size} levels",
    )
    fall_mm = float(np.sqrt(np.mean((isotonic_regression(known).x - known) ** 2)))
    _require(
        fall_mm <= _MAX_FALL_MM,
        f"depths that rise with the darkening in {path}",
        f"a list that is {fall_mm:.2f} mm (RMS) from any that does",
    )
    _require(
        known.max() >= MIN_PRESS_DEPTH_MM,
        f"depths to at least {MIN_PRESS_DEPTH_MM:g} mm in {path}",
        f"a list of {size} levels that ends at {known.max():g} mm",
        "copy the whole file again, or calibrate the depth again with a deeper press",
    )
    _require(
        (bend := _measure_bend(depth_mm)) <= _MAX_BEND,
        f"depths that rise about evenly with the darkening in {path}",
        f"a list that is {bend:.0%} of its end from even",
    )
    _require(
        known.max() <= thickness_mm,
        f"depths up to the gel's thickness of {thickness_mm:g} mm in {path}",
        f"{known.max():g} mm",
        "give the thickness of your gel with --gel-mm, or calibrate the depth again",
    )
    return depth_mm


def _measure_bend(depth_mm: Float[Array, " levels"]) -> float:
    """Return the largest deviation of a list's depths from the straight line to its end, as a fraction of its end."""
    level = np.flatnonzero(depth_mm > 0)
    level = level[level > 0]
    rising = np.asarray(isotonic_regression(depth_mm[level]).x) / depth_mm[level].max()
    return float(np.abs(rising - rising[-1] * level / level[-1]).max())


def _require_lens_maps(folder: Path, calibration: OriginalCalibration, view: RectifiedImageSize) -> None:
    """Refuse index maps that no lens gives: mirrored, folded, constant or torn somewhere, or far from even."""
    magnification, maps = _measure_magnification(calibration.source_px(view)), f"{folder / ROW_INDEX} and {COL_INDEX}"
    _require(magnification.size > 0, f"a pixel for most of the crop in {maps}", "almost none")
    middle = float(np.median(magnification))
    _require(
        middle >= 0,
        f"index maps of an image that is not mirrored in {folder}",
        "mirrored ones",
        f"check that {ROW_INDEX} and {COL_INDEX} are not exchanged, or calibrate the camera again",
    )
    least, most = middle / _MAX_MAGNIFICATION_FACTOR, middle * _MAX_MAGNIFICATION_FACTOR
    wrong = float(np.mean((magnification <= 0) | (magnification < least) | (magnification > most)))
    _require(
        wrong <= _MAX_WRONG_SHARE,
        f"the smooth maps of a lens in {maps}, which rise everywhere at about the same rate",
        f"maps that do not on {wrong:.1%} of the crop",
    )


def _measure_magnification(source_px: Float32[Array, "rows cols 2"]) -> Float[Array, " places"]:
    """Return the raw pixels per rectified pixel, an area with the sign of the map's handedness, wherever a raw pixel is given."""
    step = min(_STEP_PX, *(side - 1 for side in source_px.shape[:2]))
    corner, right, below = source_px[:-step, :-step], source_px[:-step, step:], source_px[step:, :-step]
    (x_right, y_right), (x_below, y_below) = (np.moveaxis(end - corner, -1, 0) / step for end in (right, below))
    seen = np.logical_and.reduce([(one > OUT_OF_VIEW_PX).all(axis=-1) for one in (corner, right, below)])
    return np.asarray(x_right * y_below - x_below * y_right, float)[seen]


def _require_centre_in_place(folder: Path, calibration: OriginalCalibration, view: RectifiedImageSize) -> None:
    """Refuse index maps that move the central pin: the original rectifies an image about it. A crop that would reach beyond the
    maps is moved inside.
    """
    centre, half = calibration.position_scale[:2], np.array([view.rows, view.cols]) / 2
    row, col = centre.astype(int)
    shown = np.array([calibration.row_index[row, col], calibration.col_index[row, col]])
    off_px = np.abs(np.clip(shown, half, np.array(calibration.row_index.shape) - half) - centre)
    _require(
        off_px.max() <= _MAX_CENTRE_OFFSET_PX,
        f"index maps in {folder} that leave the central pin at row {centre[0]:g}, column {centre[1]:g}",
        f"ones that show row {shown[0]}, column {shown[1]} there",
        f"copy {ROW_INDEX}, {COL_INDEX} and {POSITION_SCALE} of one calibration",
    )


def _require_crop_inside(folder: Path, calibration: OriginalCalibration, view: RectifiedImageSize) -> None:
    """Refuse maps that do not contain the crop."""
    rows, cols = calibration.row_index.shape
    row, col = calibration.position_scale[:2] - np.array([view.rows, view.cols]) / 2
    _require(
        row >= 0 and col >= 0 and row + view.rows <= rows and col + view.cols <= cols,
        f"a crop of {view.rows} x {view.cols} (rows x columns) about the central pin inside the {rows} x {cols} maps of {folder}",
        "one that reaches beyond them",
        "give the crop_size of your shape_config.yaml",
    )

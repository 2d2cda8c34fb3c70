"""Import and export of calibrations of the original 9DTact project (docs/references.md for its code): its index maps become a
sensor's rectification, its `Pixel_to_Depth` list (depth in mm for every grey level of darkening) becomes a depth curve, and the
reverse. Exported maps have the raw image's size and take the nearest pixel.

An import followed by an export preserves exactly both index maps, position and scale, and every depth of the list that rises. The
list's first entry becomes 0 (the original leaves an artefact there), levels without pixels (entries of 0) are interpolated, and
entries that fall are replaced by the nearest list that does not.

The original displays list[level] - list[2] (`lighting_threshold`), some 0.05 mm less than its list gives; this package displays the
list itself.
"""

import shutil
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int32
from numpy import ndarray as Array
from scipy.optimize import isotonic_regression

from ninedtact.atomic_write import write_file_atomically
from ninedtact.calibration.ball.ball_fit import anchor_depth_curve_at_zero
from ninedtact.calibration.ball.ball_press import simulate_height_noise_mm
from ninedtact.calibration.board.board_fit import calibrated_area_mm
from ninedtact.calibration.original_9dtact.folder_format import (
    ORIGINAL_FILES,
    POSITION_SCALE,
    OriginalCalibration,
    find_original_sensor_folder,
    read_original_calibration,
    write_npy,
    write_original_calibration,
)
from ninedtact.calibration.save import ORIGINAL_FOLDER, PIXEL_MAP_FILE, create_sensor_folder, to_sensor_toml
from ninedtact.calibration.sensor_folder import (
    SENSOR_FILE,
    SensorFolder,
    build_projection,
    load_sensor,
)
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    DepthTable,
    GridTable,
    LensModelTable,
    PinMapTable,
    PixelMapTable,
    SensorTomlRecord,
)
from ninedtact.design import SensorDesign
from ninedtact.errors import FileFormatError, OutputError
from ninedtact.quantities import HeightSource
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.shape.depth import DepthCurve, Smoothing
from ninedtact.shape.lens_and_rectification import OUT_OF_VIEW_PX, Area, Rectification

PUBLISHED_SCATTER_MM = 0.0304
"""Standard deviation of the scatter about the list. The folder does not contain it; this is the paper's value on balls."""
LAST_LEVEL = 255


def _curve_from_depth_list(pixel_to_depth_mm: Float[Array, " levels"]) -> DepthCurve:
    """Return the list as a curve: zero at zero, rising, with levels without a depth interpolated."""
    known = np.flatnonzero(pixel_to_depth_mm > 0)
    known = known[known > 0]
    rising = np.asarray(isotonic_regression(pixel_to_depth_mm[known]).x)
    return anchor_depth_curve_at_zero(
        "difference", known.astype(float), rising, np.full(known.size, PUBLISHED_SCATTER_MM)
    )


def _depth_list_from_curve(sensor: SensorFolder) -> Float[Array, " levels"]:
    """Return the depth for every whole grey level up to the end of the sensor's curve.

    A ratio is converted to grey levels at the mean brightness of the sensor's own reference image. Where the image is brighter or
    darker than that, the list's depths are wrong in the same way as those of the original's own lists.
    """
    curve = sensor.depth.curve
    brightness = 1.0 if curve.signal == "difference" else _mean_reference_grey(sensor)
    last = min(int(np.ceil(curve.darkening[-1] * brightness)), LAST_LEVEL)
    return np.interp(np.arange(last + 1) / brightness, curve.darkening, curve.indentation_mm)


def _mean_reference_grey(sensor: SensorFolder) -> float:
    """Return the mean grey level of the reference image before the ball; raises `SensorFolderDamaged`."""
    rectify = sensor.rectification
    rectified = rectify(sensor.stored_image("ball_reference"))
    return float(rectified.grey[rectify.height_source != HeightSource.OUT_OF_VIEW].mean())


Index = Int32[Array, "raw_rows raw_cols"]


def _build_index_maps(sensor: SensorFolder) -> tuple[Index, Index, tuple[int, int]]:
    """Return row and column of the raw pixel, (0, 0) where the camera sees nothing, and the row and column of the centre."""
    rectify, lens = sensor.rectification, sensor.record.lens
    _require_grid_fits(rectify)
    start = _grid_start(rectify)
    x, y = np.rint(np.moveaxis(_extend_source_px(rectify, lens, start), -1, 0))
    raw_rows, raw_cols = rectify.raw_shape
    seen = (x >= 0) & (x < raw_cols) & (y >= 0) & (y < raw_rows)
    rows, cols = rectify.source_px.shape[:2]
    # The original starts its crop at int(centre - size / 2), so for an odd size the centre is one pixel beyond the middle.
    centre = start[0] + (rows + 1) // 2, start[1] + (cols + 1) // 2
    return np.where(seen, y, 0).astype(np.int32), np.where(seen, x, 0).astype(np.int32), centre


def _require_grid_fits(rectify: Rectification) -> None:
    """Refuse a grid larger than the raw image, which has the size of the maps."""
    (rows, cols), (raw_rows, raw_cols) = rectify.source_px.shape[:2], rectify.raw_shape
    if rows > raw_rows or cols > raw_cols:
        raise OutputError(
            expected=f"raw images of at least {cols} x {rows} pixels, the size of the rectified one",
            got=f"{raw_cols} x {raw_rows}",
            remedy="calibrate the sensor with larger images",
        )


def _grid_start(rectify: Rectification) -> tuple[int, int]:
    """Return the first row and column of the grid in the maps: its centre stays at its raw pixel if there is room."""
    (rows, cols), (raw_rows, raw_cols) = rectify.source_px.shape[:2], rectify.raw_shape
    x, y = rectify.source_px[rows // 2, cols // 2]
    top = np.clip(round(float(y)) - rows // 2, 0, raw_rows - rows)
    left = np.clip(round(float(x)) - cols // 2, 0, raw_cols - cols)
    return int(top), int(left)


def _extend_source_px(
    rectify: Rectification, lens: LensModelTable | PinMapTable | PixelMapTable, start: tuple[int, int]
) -> Float[Array, "raw_rows raw_cols 2"]:
    """Return the source pixels of the grid, and around it those of the lens; none around a grid given pixel by pixel."""
    (top, left), (rows, cols) = start, rectify.source_px.shape[:2]
    extended = np.full((*rectify.raw_shape, 2), OUT_OF_VIEW_PX)
    if not isinstance(lens, PixelMapTable):
        y, x = np.indices(rectify.raw_shape) - np.array([top + (rows - 1) / 2, left + (cols - 1) / 2])[:, None, None]
        points_mm = np.column_stack([x.ravel(), y.ravel()]) * rectify.mm_per_px
        extended = build_projection(lens, rectify.raw_shape).to_px(points_mm).reshape(extended.shape)
    extended[top : top + rows, left : left + cols] = rectify.source_px
    return extended


CAMERA_NOISE = 0.5
"""Noise of one pixel in grey levels. The folder contains no image; the cameras seen so far have 0.42."""
USUAL_GREY = 160
_MIN_SEEN_SHARE, _MAX_SEEN_SHARE = 0.5, 1.25
"""Smallest part of the sensing area, and largest multiple of the gel's opening, that a crop shows along each side. That of the
published sensor shows 0.98 of the one and 0.82 of the other; a margin is left for other builds.
"""


def import_original_calibration(
    folder: Path, out: Path, design: SensorDesign = SensorDesign(), sensor_id: str | None = None
) -> SensorFolder:
    """Write a sensor folder from `sensor_N`, or from a folder that holds one; pixels are rectified exactly as there.

    The crop is the design's field of view. There is no certificate, and no reference image to detect drift; the noise is that of a
    usual camera through this sensor's list. An older sensor folder at `out` is replaced. Raises `FileFormatError`,
    `SensorFolderNotReplaceable`, `FileNotWritten`, `OSError`.
    """
    source = find_original_sensor_folder(folder, ORIGINAL_FILES)
    calibration = read_original_calibration(source, design.field_of_view, design.gel.thickness_mm)
    _require_skin_in_view(source, calibration, design)
    with create_sensor_folder(out) as partial:
        write_npy(partial / PIXEL_MAP_FILE, calibration.source_px(design.field_of_view))
        for file in ORIGINAL_FILES:
            (partial / ORIGINAL_FOLDER / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / file, partial / ORIGINAL_FOLDER / file)
        digest = sha256((partial / PIXEL_MAP_FILE).read_bytes()).hexdigest()
        record = _make_imported_record(calibration, design, sensor_id or source.resolve().name, digest)
        write_file_atomically(partial / SENSOR_FILE, to_sensor_toml(record))
    return load_sensor(out)


def _require_skin_in_view(source: Path, calibration: OriginalCalibration, design: SensorDesign) -> None:
    """Refuse a scale with which the crop would show far more or far less of the skin than the design has."""
    view, area = design.field_of_view, design.sensing_area
    seen_mm = np.array([view.cols, view.rows]) * calibration.mm_per_px
    least_mm, most_mm = _MIN_SEEN_SHARE * np.array(area.size_mm), _MAX_SEEN_SHARE * np.array(area.opening_mm)
    if (seen_mm < least_mm).any() or (seen_mm > most_mm).any():
        raise FileFormatError(
            expected=f"a crop of {least_mm[0]:.0f} x {least_mm[1]:.0f} to {most_mm[0]:.0f} x {most_mm[1]:.0f} mm "
            "of the skin",
            got=f"{view.cols} x {view.rows} pixels of {calibration.mm_per_px:g} mm, {seen_mm[0]:.1f} x "
            f"{seen_mm[1]:.1f} mm",
            remedy="give the crop_size of your shape_config.yaml, or correct the third number of "
            f"{source / POSITION_SCALE}, mm per pixel",
        )


def _make_imported_record(
    calibration: OriginalCalibration, design: SensorDesign, sensor_id: str, digest: str
) -> SensorTomlRecord:
    area, (rows, cols) = _calibrated_area_mm(calibration, design), calibration.row_index.shape
    rectify = Rectification(calibration.source_px(design.field_of_view), calibration.mm_per_px, (rows, cols), area)
    curve = _curve_from_depth_list(calibration.pixel_to_depth_mm)
    return SensorTomlRecord(
        format=SENSOR_FORMAT,
        id=sensor_id,
        created=datetime.now(UTC).replace(microsecond=0),
        software=f"ninedtact {version('ninedtact')}, imported from the original project",
        design=design,
        grid=GridTable(calibration.mm_per_px, rows, cols, area),
        lens=PixelMapTable(PIXEL_MAP_FILE, digest),
        depth=DepthTable("table", _typical_noise_mm(curve, rectify), Smoothing(), curve),
    )


def _typical_noise_mm(curve: DepthCurve, rectify: Rectification) -> float:
    """Return the noise of the height that the noise of a usual camera causes."""
    even = np.full((*rectify.raw_shape, 3), USUAL_GREY, np.uint8)
    return simulate_height_noise_mm(
        partial(DepthReader, curve, lens_source=rectify.height_source), rectify, even, CAMERA_NOISE
    )


def _calibrated_area_mm(calibration: OriginalCalibration, design: SensorDesign) -> Area:
    """Return the area of the pins; the original's crop is up to a pixel off its central pin."""
    view = design.field_of_view
    start, half = np.array(calibration.start(view)), (np.array([view.rows, view.cols]) - 1) / 2
    y, x = (calibration.position_scale[:2] - start - half) * calibration.mm_per_px
    left, right, top, bottom = calibrated_area_mm(design)
    return float(left + x), float(right + x), float(top + y), float(bottom + y)


def export_original_calibration(sensor: SensorFolder, out: Path) -> None:
    """Write the original project's layout into the new folder `out` (`…/calibration/sensor_N`), all or nothing.

    Index maps take the nearest raw pixel; for the list of grey levels see `_depth_list_from_curve`. Raises
    `OutputError`, `FileFormatError`, `SensorFolderDamaged`, `FileNotWritten`, `OSError`.
    """
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise OutputError(
            expected=f"{out} to be new or an empty folder", got="one with content", remedy="choose another name"
        )
    calibration = replace(_maps_to_export(sensor), pixel_to_depth_mm=_depth_list_from_curve(sensor))
    with create_sensor_folder(out) as partial:
        write_original_calibration(partial, calibration)


def _maps_to_export(sensor: SensorFolder) -> OriginalCalibration:
    """Return the maps that were imported, or maps made from the sensor's lens."""
    view, kept = sensor.record.design.field_of_view, sensor.path / ORIGINAL_FOLDER
    if not (isinstance(sensor.record.lens, PixelMapTable) and kept.is_dir()):
        row_index, col_index, centre = _build_index_maps(sensor)
        scale = np.array([*centre, sensor.record.grid.mm_per_px], float)
        return OriginalCalibration(row_index, col_index, scale, np.zeros(1))
    calibration = read_original_calibration(kept, view, sensor.record.design.gel.thickness_mm)
    if not np.array_equal(calibration.source_px(view), sensor.rectification.source_px):
        raise FileFormatError(expected=f"{kept} as it was imported", got="other maps", remedy="import the sensor again")
    return calibration

"""Calibrations of the original 9DTact project, to and fro (docs/references.md for its code).

What an import and an export after it preserve exactly: both index maps everywhere, position and scale, and every depth
of the list that rises. The list's first entry becomes 0 (the original leaves an artefact there), levels that no pixel
had (entries of 0) are interpolated, and entries that dip are replaced by the nearest list that does not.

The original shows list[level] - list[2] (`lighting_threshold`), some 0.05 mm less than its list says; we show the list.
"""

import shutil
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ninedtact.calibration.ball.fit import repeatability_mm
from ninedtact.calibration.flow import calibrated_area_mm
from ninedtact.calibration.record import FORMAT, Depth, Grid, MapTable, SensorRecord
from ninedtact.calibration.sensor_folder import RECORD, SensorFolder, load_sensor, new_sensor_folder, record_toml
from ninedtact.calibration.upstream.depth import curve_from_list, list_from_curve
from ninedtact.calibration.upstream.files import UpstreamFolderDamaged, sensor_folder_in, write_numbers
from ninedtact.calibration.upstream.layout import FILES, UpstreamCalibration, read_upstream, write_upstream
from ninedtact.calibration.upstream.map import UpstreamCannotHold, index_maps
from ninedtact.design import SensorDesign
from ninedtact.shape.depth import DepthCurve, DepthReader, Smoothing
from ninedtact.shape.rectification import Area, Rectification
from ninedtact.whole_file import write_whole

KEPT = "upstream"
"""Folder in an imported sensor that keeps the four files as they were, so that an export can give them back."""
MAP = "rectification.npy"
CAMERA_NOISE = 0.5
"""Grey levels of one pixel; no image came with the folder, and the cameras seen so far have 0.42."""
USUAL_GREY = 160


def import_upstream(
    folder: Path, out: Path, design: SensorDesign = SensorDesign(), sensor_id: str | None = None
) -> SensorFolder:
    """Write a sensor folder from `sensor_N`, or from a folder that holds one; pixels are rectified exactly as there.

    The crop is the design's field of view. There is no certificate, and no image to compare today's skin with; the
    noise is that of a usual camera through this sensor's list. An older sensor folder at `out` is replaced.
    Raises `UpstreamFolderDamaged`, `SensorFolderRefused`, `FileNotWritten`, `OSError`.
    """
    source = sensor_folder_in(folder, FILES)
    calibration = read_upstream(source, design.field_of_view)
    with new_sensor_folder(out) as partial:
        write_numbers(partial / MAP, calibration.source_px(design.field_of_view))
        for file in FILES:
            (partial / KEPT / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / file, partial / KEPT / file)
        digest = sha256((partial / MAP).read_bytes()).hexdigest()
        record = imported_record(calibration, design, sensor_id or source.resolve().name, digest)
        write_whole(partial / RECORD, record_toml(record))
    return load_sensor(out)


def imported_record(
    calibration: UpstreamCalibration, design: SensorDesign, sensor_id: str, digest: str
) -> SensorRecord:
    """Everything that `sensor.toml` can say of an imported sensor."""
    area, (rows, cols) = area_mm(calibration, design), calibration.row_index.shape
    rectify = Rectification(calibration.source_px(design.field_of_view), calibration.mm_per_px, (rows, cols), area)
    curve = curve_from_list(calibration.pixel_to_depth_mm)
    return SensorRecord(
        format=FORMAT,
        id=sensor_id,
        created=datetime.now(UTC).replace(microsecond=0),
        software=f"ninedtact {version('ninedtact')}, imported from the original project",
        design=design,
        grid=Grid(calibration.mm_per_px, rows, cols, area),
        lens=MapTable(MAP, digest),
        depth=Depth("table", usual_noise_mm(curve, rectify), Smoothing(), curve),
    )


def usual_noise_mm(curve: DepthCurve, rectify: Rectification) -> float:
    """What the noise of a usual camera does to the height."""
    even = np.full((*rectify.raw_shape, 3), USUAL_GREY, np.uint8)
    return repeatability_mm(partial(DepthReader, curve, lens_coverage=rectify.coverage), rectify, even, CAMERA_NOISE)


def area_mm(calibration: UpstreamCalibration, design: SensorDesign) -> Area:
    """Where the pins were; the original's crop lies up to a pixel beside its central pin."""
    view = design.field_of_view
    start, half = np.array(calibration.start(view)), (np.array([view.rows, view.cols]) - 1) / 2
    y, x = (calibration.position_scale[:2] - start - half) * calibration.mm_per_px
    left, right, top, bottom = calibrated_area_mm(design)
    return float(left + x), float(right + x), float(top + y), float(bottom + y)


def export_upstream(sensor: SensorFolder, out: Path) -> None:
    """Write the original project's layout into the new folder `out` (`…/calibration/sensor_N`), all or nothing.

    Index maps take the nearest raw pixel; for the list of grey levels see `list_from_curve`. Raises
    `UpstreamCannotHold`, `UpstreamFolderDamaged`, `SensorFolderDamaged`, `FileNotWritten`, `OSError`.
    """
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise UpstreamCannotHold(
            f"expected {out} to be new or an empty folder, got one with content; choose another name"
        )
    calibration = replace(exported_maps(sensor), pixel_to_depth_mm=list_from_curve(sensor))
    with new_sensor_folder(out) as partial:
        write_upstream(partial, calibration)


def exported_maps(sensor: SensorFolder) -> UpstreamCalibration:
    """The maps that were imported, or maps made from the sensor's lens."""
    view, kept = sensor.record.design.field_of_view, sensor.path / KEPT
    if not (isinstance(sensor.record.lens, MapTable) and kept.is_dir()):
        row_index, col_index, centre = index_maps(sensor)
        scale = np.array([*centre, sensor.record.grid.mm_per_px], float)
        return UpstreamCalibration(row_index, col_index, scale, np.zeros(1))
    calibration = read_upstream(kept, view)
    if not np.array_equal(calibration.source_px(view), sensor.rectification.source_px):
        raise UpstreamFolderDamaged(f"expected {kept} as it was imported, got other maps; import the sensor again")
    return calibration

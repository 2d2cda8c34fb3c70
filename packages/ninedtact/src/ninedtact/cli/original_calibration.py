"""ninedtact import-calibration, export-calibration: sensors of the original 9DTact project, to and fro."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_result, sensor_replacement
from ninedtact.cli.shared_options import JsonOption
from ninedtact.design import SensorDesign

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder


@dataclass(frozen=True)
class ImportCalibrationCommand:
    """Turn a calibration of the original 9DTact project into a sensor folder.

    Pixels are rectified as they were there, depths read from its list. Force, the twin and the check for drift need images of
    a ball: add them with ninedtact calibrate --from-import.
    """

    folder: tyro.conf.Positional[Path]
    """The original's `sensor_N` folder, or the folder that holds a single one."""
    out: Path
    """Sensor folder to write; an older one there is replaced."""
    rows: int = SensorDesign().field_of_view.rows
    """First number of `crop_size` in the original's shape_config.yaml."""
    cols: int = SensorDesign().field_of_view.cols
    """Second number of `crop_size`."""
    gel_mm: float = SensorDesign().gel.thickness_mm
    """Thickness of the translucent gel; no depth of the list can be beyond it."""
    id: str | None = None
    """Name of the sensor; the original folder's name if not given."""
    json: JsonOption = False

    def run(self) -> int:
        """Import, and say what was taken over."""
        from ninedtact.calibration.original_9dtact.import_export import import_original_calibration

        standard = SensorDesign()
        view = replace(standard.field_of_view, rows=self.rows, cols=self.cols)
        design = replace(standard, field_of_view=view, gel=replace(standard.gel, thickness_mm=self.gel_mm))
        with sensor_replacement(self.out):
            sensor = import_original_calibration(self.folder, self.out, design, self.id)
        return print_result(self.json, _to_json_dict(sensor), _format_import(sensor))


@dataclass(frozen=True)
class ExportCalibrationCommand:
    """Write a sensor's calibration in the layout of the original 9DTact project."""

    sensor: Path
    """Sensor folder."""
    out: Path
    """New folder, the original's `calibration/sensor_N`."""
    json: JsonOption = False

    def run(self) -> int:
        """Export, and say what to set there."""
        from ninedtact.calibration.original_9dtact.folder_format import ORIGINAL_FILES
        from ninedtact.calibration.original_9dtact.import_export import export_original_calibration

        sensor = load_sensor_with_notices(self.sensor)
        export_original_calibration(sensor, self.out)
        files = [str(self.out / file) for file in ORIGINAL_FILES]
        return print_result(self.json, {**_to_json_dict(sensor), "files": files}, _format_export(sensor, self.out))


def _to_json_dict(sensor: "SensorFolder") -> dict[str, object]:
    record = sensor.record
    return {
        "sensor": str(sensor.path),
        "id": sensor.id,
        "mm_per_px": record.grid.mm_per_px,
        "crop_size": [record.design.field_of_view.rows, record.design.field_of_view.cols],
        "range_mm": sensor.depth.curve.max_indentation_mm,
        "noise_mm": sensor.depth.noise_mm,
    }


def _format_import(sensor: "SensorFolder") -> Iterator[str]:
    record = sensor.record
    yield f"sensor {sensor.id} imported: {sensor.path}"
    yield f"  scale  {record.grid.mm_per_px:.5f} mm per pixel, depth to {sensor.depth.curve.max_indentation_mm:.2f} mm"
    yield "  it gives heights, but no force, no twin and no 'ninedtact check': these need images of a ball, and none came with it"
    yield f"  to add these: {sensor.completion_command}"


def _format_export(sensor: "SensorFolder", out: Path) -> Iterator[str]:
    """Where it went, and the two settings that are not in the folder."""
    view, name = sensor.record.design.field_of_view, out.resolve().name
    yield f"sensor {sensor.id} exported: {out}"
    number = name.removeprefix("sensor_")
    where = f"sensor_id: {number}" if number != name else f"rename {name} to sensor_N, sensor_id: N"
    yield f"  in the original's shape_config.yaml: {where}, crop_size: [{view.rows}, {view.cols}]"

"""The folder of a sensor that looks straight at its skin and knows its twin: enough to simulate and to rectify, at once."""

from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

import cv2

from ninedtact.calibration.save import to_sensor_toml
from ninedtact.calibration.sensor_folder import SENSOR_FILE
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    DepthTable,
    GridTable,
    LensModelTable,
    SensorTomlRecord,
    StoredCalibrationImage,
    TwinFitQuality,
    TwinTable,
)
from ninedtact.design import Gel, SensorDesign
from ninedtact.shape.deblurring import Deblurring
from ninedtact.shape.depth import DepthCurve, Smoothing
from ninedtact.simulation.twin import default_twin

ROWS, COLS, MM_PER_PX = 480, 640, 0.05
UNITS_PER_MM = 2 / (COLS * MM_PER_PX)


def twin_folder(path: Path, for_force: bool = False) -> Path:
    """Write it; for_force: with bulges and the point spread, which force by physics needs."""
    twin = default_twin()
    path.mkdir()
    cv2.imwrite(str(path / "untouched.png"), twin.renderer(None))
    digest = sha256((path / "untouched.png").read_bytes()).hexdigest()
    curve, deblurring = DepthCurve("ratio", (0.0, 0.4), (0.0, 2.0), (0.0, 0.01)), None
    if for_force:
        curve, deblurring = replace(curve, brightening=(0.0, 0.2), bulge_mm=(0.0, 0.5)), Deblurring(0.45)
    record = SensorTomlRecord(
        format=SENSOR_FORMAT,
        id="twin",
        created=datetime(2026, 1, 1, tzinfo=UTC),
        software="test",
        design=SensorDesign(),
        grid=GridTable(MM_PER_PX, ROWS, COLS, calibrated_area_mm=(-12.0, 12.0, -9.0, 9.0)),
        lens=LensModelTable((UNITS_PER_MM, 0.0, 0.0, 0.0, UNITS_PER_MM, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0)),
        depth=DepthTable("ratio", 0.01, Smoothing(), curve, deblurring=deblurring),
        twin=TwinTable(Gel(), twin.renderer.light, 1.0, TwinFitQuality(0.1, 0.4, 2.0, (0.0, 0.0), 100.0, 1.0, {})),
        images={"ball_reference": StoredCalibrationImage("untouched.png", digest)},
    )
    (path / SENSOR_FILE).write_bytes(to_sensor_toml(record))
    return path

"""Real images and sensors calibrated from them: the folder in NINEDTACT_REAL_DATA, or ../shared/real beside the repository."""

import os
import sys
from functools import cache
from pathlib import Path

import numpy as np

from ninedtact import CalibrationImages, CalibrationSettings, SensorFolder, calibrate, read_image
from ninedtact.calibration.procedure import Calibration
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.depth import DepthMethod

PRESSES = ("board_reference", "board", "ball_reference", "ball")


REAL = Path(os.environ.get("NINEDTACT_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "real"))


def sensor_folders() -> list[Path]:
    """Return the folders of all sensors that have the four images; ends the program with a sentence when there are none."""
    found = [path for path in sorted(REAL.glob("sensor_*")) if all((path / f"{p}.png").is_file() for p in PRESSES)]
    if not found:
        sys.exit(f"expected folders sensor_a and so on with real images in {REAL}, got none; set NINEDTACT_REAL_DATA")
    return found


def sensor_folder(name: str) -> Path:
    """Return the folder of one sensor; ends the program with a sentence when it is not there."""
    found = {path.name: path for path in sensor_folders()}
    if name not in found:
        sys.exit(f"expected {name} among the real images, got {', '.join(found)}; set NINEDTACT_REAL_DATA")
    return found[name]


def calibration_images(name: str) -> CalibrationImages:
    """Return the four images of a sensor."""
    return CalibrationImages(**{press: read_image(sensor_folder(name) / f"{press}.png") for press in PRESSES})


@cache
def calibrated(name: str, method: DepthMethod) -> Calibration:
    """Return a sensor, calibrated from its four images once in a process."""
    return calibrate(calibration_images(name), settings=CalibrationSettings(method=method))


def real_sensor(name: str, method: DepthMethod = "physics") -> tuple[dict[str, np.ndarray], CalibratedShape]:
    """Return the images of a sensor by name, and the path from a frame to its height."""
    made = calibrated(name, method)
    return vars(made.images), SensorFolder(Path(), made.record).shape

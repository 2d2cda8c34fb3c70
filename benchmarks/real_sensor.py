"""A real sensor, calibrated from its four pictures, without writing anything."""

from pathlib import Path

import numpy as np
from real_pictures import PRESSES, sensor_folder

from ninedtact import CalibrationPictures, CalibrationSettings, SensorFolder, calibrate, read_picture
from ninedtact.calibration.ball.fit import Method
from ninedtact.shape.calibrated import CalibratedShape


def real_sensor(name: str, method: Method = "physics") -> tuple[dict[str, np.ndarray], CalibratedShape]:
    """Its pictures by name, and the path from a frame to its height."""
    folder = sensor_folder(name)
    pictures = {press: read_picture(folder / f"{press}.png") for press in PRESSES}
    made = calibrate(CalibrationPictures(**pictures), settings=CalibrationSettings(method=method))
    return pictures, SensorFolder(Path(), made.record).shape

"""A real sensor, calibrated from its four images, without writing anything."""

from pathlib import Path

import numpy as np
from real_images import PRESSES, sensor_folder

from ninedtact import CalibrationImages, CalibrationSettings, SensorFolder, calibrate, read_image
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.depth import DepthMethod


def real_sensor(name: str, method: DepthMethod = "physics") -> tuple[dict[str, np.ndarray], CalibratedShape]:
    """Its images by name, and the path from a frame to its height."""
    folder = sensor_folder(name)
    images = {press: read_image(folder / f"{press}.png") for press in PRESSES}
    made = calibrate(CalibrationImages(**images), settings=CalibrationSettings(method=method))
    return images, SensorFolder(Path(), made.record).shape

"""The original project's `Pixel_to_Depth` list (depth in mm for every grey level of darkening), to and fro."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import isotonic_regression

from ninedtact.calibration.ball.depth_curve import anchored
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.images import read_image
from ninedtact.quantities import Coverage
from ninedtact.shape.depth import DepthCurve

PUBLISHED_SCATTER_MM = 0.0304
"""The scatter about the list is not in the folder; this is the standard deviation that the paper found on balls."""
LAST_LEVEL = 255


def curve_from_list(pixel_to_depth_mm: Float[Array, " levels"]) -> DepthCurve:
    """The list as a curve: zero at zero, rising, levels without a depth interpolated."""
    known = np.flatnonzero(pixel_to_depth_mm > 0)
    known = known[known > 0]
    rising = np.asarray(isotonic_regression(pixel_to_depth_mm[known]).x)
    return anchored("difference", known.astype(float), rising, np.full(known.size, PUBLISHED_SCATTER_MM))


def list_from_curve(sensor: SensorFolder) -> Float[Array, " levels"]:
    """Depth for every whole grey level up to the end of the sensor's curve.

    A ratio becomes grey levels at the mean brightness of the sensor's own untouched image; where the image is
    brighter or darker than that, the list's depths are off as they are with the original's own lists.
    """
    curve = sensor.record.depth.curve
    brightness = 1.0 if curve.signal == "difference" else mean_brightness(sensor)
    last = min(int(np.ceil(curve.darkening[-1] * brightness)), LAST_LEVEL)
    return np.interp(np.arange(last + 1) / brightness, curve.darkening, curve.indentation_mm)


def mean_brightness(sensor: SensorFolder) -> float:
    """Mean grey level of the untouched skin before the ball; raises `SensorFolderDamaged`."""
    rectify = sensor.rectification
    rectified = rectify(sensor.image("ball_reference", read_image))
    return float(rectified.grey[rectify.coverage != Coverage.OUT_OF_VIEW].mean())

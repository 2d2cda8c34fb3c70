"""The shape path of a sensor without a calibration, from images that are already rectified.

Each image is taken to show the skin from border to border, its columns along x, and the gel and its light to be those of the
published design. Positions are then as right as the width of the view is known, and depths have an unknown scale: light and gel of
sensors of one design differ by a third.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.calibration.ball.ball_fit import depth_curve_of_brightness_model
from ninedtact.design import PUBLISHED_RECTIFIED_COLS, SensorDesign, rectified_mm_per_px
from ninedtact.errors import InputError
from ninedtact.quantities import Frame
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.deblurring import Deblurring
from ninedtact.shape.depth import TYPICAL_GLOBAL_DIMMING, TYPICAL_POINT_SPREAD_MM, GlobalDimmingModel
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.simulation.gel_brightness import BrightnessModel

SMALLEST_COLS, SMALLEST_ROWS = 40, 30
"""Smallest image from which contact and motion are read."""
_LARGEST_ASPECT = 3.0
_RELATIVE_DEPTH_ERROR = 0.35
"""Standard deviation of the scale of depth."""
_DEEPEST = 0.9
"""Part of the gel's thickness to which the curve goes."""
_FLOOR = 0.1
"""Weight of smoothness in the deblurring, the largest that calibrations choose (`ball_fit`)."""


def nominal_shape(shape: tuple[int, int], mm_per_px: float | None = None, design: SensorDesign = SensorDesign()) -> CalibratedShape:
    """Return the shape path for rectified images of this shape (rows, cols).

    mm_per_px: of these images; None takes the view to be as wide as that of the design. Images are enlarged to the width of the
    published rectified image, on which all filters are stated in pixels. Raises `InputError` for images that are too small.
    """
    rows, cols = shape
    if cols < SMALLEST_COLS or rows < SMALLEST_ROWS or max(cols / rows, rows / cols) > _LARGEST_ASPECT:
        raise InputError(
            expected=f"rectified images of {SMALLEST_COLS}x{SMALLEST_ROWS} pixels or more, up to three times as wide as high",
            got=f"{cols}x{rows}",
            remedy="give larger ones",
        )
    if mm_per_px is not None and not 0.01 <= mm_per_px * cols / PUBLISHED_RECTIFIED_COLS <= 1:
        raise InputError(
            expected="mm per pixel with which the view is 5 to 460 mm wide",
            got=f"{mm_per_px:g}, which makes {mm_per_px * cols:.3g} mm",
            remedy="divide the width of the view by the columns of the image",
        )
    finer = PUBLISHED_RECTIFIED_COLS / cols
    grid = round(rows * finer), PUBLISHED_RECTIFIED_COLS
    pitch_mm = rectified_mm_per_px((PUBLISHED_RECTIFIED_COLS, 0), design) if mm_per_px is None else mm_per_px / finer
    x, y = (np.linspace(0.5, side - 0.5, many, endpoint=False) for side, many in ((cols, 1), (rows, 1)))
    across, down = ((np.arange(many) + 0.5) * side / many - 0.5 for side, many in ((cols, grid[1]), (rows, grid[0])))
    source_px = np.stack(np.meshgrid(across, down), axis=-1).astype(np.float32)
    reach = grid[1] * pitch_mm / 2, grid[0] * pitch_mm / 2
    rectify = Rectification(source_px, pitch_mm, (rows, cols), (-reach[0], reach[0], -reach[1], reach[1]))
    light = BrightnessModel()
    curve = depth_curve_of_brightness_model(light, _DEEPEST * light.thickness_mm)
    curve = replace(curve, error_mm=tuple(_RELATIVE_DEPTH_ERROR * depth_mm for depth_mm in curve.indentation_mm))
    return CalibratedShape(
        rectify,
        curve,
        0.0,
        1 / light.inverse_distance_per_mm,
        loss=GlobalDimmingModel(TYPICAL_GLOBAL_DIMMING),
        deblurring=Deblurring(TYPICAL_POINT_SPREAD_MM, _FLOOR),
    )

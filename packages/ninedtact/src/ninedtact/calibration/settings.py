"""The choices of a calibration, which are the options of `ninedtact calibrate` too."""

from dataclasses import dataclass
from typing import Literal

from ninedtact.bounds import checks_arguments
from ninedtact.shape.depth import DepthMethod, Smoothing

LensKind = Literal["model", "paper"]


@checks_arguments
@dataclass(frozen=True)
class CalibrationSettings:
    """How to calibrate; the defaults suit every sensor seen so far. Raises `InputError` for a choice that does not exist."""

    lens: LensKind = "model"
    """Lens model, or the paper's map (central anchors, equidistant grid, cubic radial basis) for reproduction."""
    camera_rotation_deg: Literal["auto", 0, 90, 180, 270] = "auto"
    """Angle from the image's columns to the sensor's x axis, clockwise on the screen."""
    method: DepthMethod = "physics"
    """Depth from contact mechanics and light, fitted to the whole image of the ball, or from the ball's cap alone: from the
    brightness factor (ratio), or from the paper's mapping list of grey differences (table)."""
    smoothing: Smoothing = Smoothing()
    camera_mirrored: bool = False
    """The camera mirrors its images left to right, which neither board nor ball shows: what moves to the right on the sensor, seen
    from the camera, moves to the left in the image. Without this option F_x, T_y and T_z would have the wrong sign."""

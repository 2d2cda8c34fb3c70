"""The shape path of a sensor without a calibration, from images that are already rectified.

An image is taken to show the skin from border to border, its columns along x, and gel and light to be those of the published
design. Positions are then as right as the width of the view is known. Depths and loads have an unknown scale: gel and light of
sensors of one design differ by a third and more.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array
from scipy.ndimage import distance_transform_edt

from ninedtact.calibration.ball.ball_fit import depth_curve_of_brightness_model
from ninedtact.design import PUBLISHED_RECTIFIED_COLS, rectified_mm_per_px
from ninedtact.errors import InputError
from ninedtact.quantities import EstimateWarning
from ninedtact.shape.calibrated_shape import MIN_LIT_GREY_LEVEL, CalibratedShape, ReferenceUnusable
from ninedtact.shape.deblurring import Deblurring
from ninedtact.shape.depth import TYPICAL_GLOBAL_DIMMING, TYPICAL_POINT_SPREAD_MM, GlobalDimmingModel
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.simulation.gel_brightness import BrightnessModel

_SMALLEST_COLS, _SMALLEST_ROWS = 40, 30
"""Smallest view from which contact and motion are read."""
_LARGEST_ASPECT = 3.0
_VIEW_WIDTHS_MM = 4.0, 200.0
"""Widths of sensing areas (`design.SensingArea`)."""
_RELATIVE_DEPTH_ERROR = 0.35
"""Standard deviation of the scale of depth."""
_DEEPEST = 0.9
"""Part of the gel's thickness to which the depth curve goes."""
_SMOOTHNESS = 0.1
"""Weight of smoothness in the deblurring, the largest that calibrations choose."""
_LIT_SHARE = 0.5
"""Share of the pixels of a row or column that show skin, below which it is a part of a black border."""

Lit = Bool[Array, "raw_rows raw_cols"]


@dataclass(frozen=True)
class View:
    """The rectangle of an image that shows skin, px."""

    left: int
    top: int
    cols: int
    rows: int


def find_view(reference: Float32[Array, "raw_rows raw_cols"]) -> tuple[View, Lit]:
    """Return the part of a grey image without contact that is not black border, and which of its pixels are lit.

    Raises `ReferenceUnusable` for an image that is dark, and `InputError` for a view that is too small or narrow.
    """
    lit = cv2.medianBlur(reference, 3) > MIN_LIT_GREY_LEVEL
    if not lit.any():
        raise ReferenceUnusable(
            expected="lit reference images (no contact)",
            got=f"a mean grey level of {reference.mean():.0f} of 255",
            remedy="name frames in which the sensor's light is on; differences must lie about mid-grey",
        )
    most = max(float(lit.mean(axis=axis).max()) for axis in (0, 1))
    across, down = (np.flatnonzero(lit.mean(axis=axis) > _LIT_SHARE * most) for axis in (0, 1))
    view = View(int(across[0]), int(down[0]), int(np.ptp(across)) + 1, int(np.ptp(down)) + 1)
    sides = view.cols, view.rows
    if view.cols < _SMALLEST_COLS or view.rows < _SMALLEST_ROWS or max(sides) > _LARGEST_ASPECT * min(sides):
        raise InputError(
            expected=f"rectified images of {_SMALLEST_COLS}x{_SMALLEST_ROWS} pixels or more, with an aspect ratio of at most "
            f"{_LARGEST_ASPECT:g} without black borders",
            got=f"{view.cols}x{view.rows}",
            remedy="give the images of the whole view",
        )
    return view, np.asarray(lit)


def _nearest_lit(source_px: Float[Array, "rows cols 2"], lit: Lit) -> Float[Array, "rows cols 2"]:
    """Return the positions with those on black corners moved to the nearest skin: next to black, skin would look pressed."""
    skin = cv2.erode(lit.astype(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE) > 0
    if skin.all():
        return source_px
    rows, cols = distance_transform_edt(~skin, return_distances=False, return_indices=True)
    at = tuple(np.clip(np.rint(source_px[..., axis]), 0, lit.shape[1 - axis] - 1).astype(int) for axis in (1, 0))
    nearest = np.stack([cols[at], rows[at]], axis=-1)
    return np.where(skin[at][..., None], source_px, nearest)


def nominal_shape(reference: Float32[Array, "raw_rows raw_cols"], mm_per_px: float | None = None) -> CalibratedShape:
    """Return the shape path for rectified images like this grey one without contact.

    mm_per_px: of the images; None takes their view to be as wide as that of the published design. The view is enlarged to the
    width of the published rectified image, to which all filters belong. Raises as `find_view` does, and `InputError` for an
    impossible scale.
    """
    view, lit = find_view(reference)
    scale = rectified_mm_per_px((view.cols, view.rows)) if mm_per_px is None else mm_per_px
    least, most = _VIEW_WIDTHS_MM
    if not least <= scale * view.cols <= most:
        raise InputError(
            expected=f"mm per pixel with which the view is {least:g} to {most:g} mm wide",
            got=f"{scale:g}, with which {view.cols} columns are {scale * view.cols:.3g} mm",
            remedy="divide the width of the view in mm by its columns",
        )
    per_pixel = view.cols / PUBLISHED_RECTIFIED_COLS
    rows, cols = round(view.rows / per_pixel), PUBLISHED_RECTIFIED_COLS
    pitch_mm = scale * per_pixel
    across, down = ((np.arange(many) + 0.5) * per_pixel - 0.5 for many in (cols, rows))
    x, y = np.meshgrid(view.left + across, view.top + down)
    source_px = _nearest_lit(np.stack([x, y], axis=-1), lit).astype(np.float32)
    right, bottom = cols * pitch_mm / 2, rows * pitch_mm / 2
    light = BrightnessModel()
    curve = depth_curve_of_brightness_model(light, _DEEPEST * light.thickness_mm)
    return CalibratedShape(
        Rectification(source_px, pitch_mm, reference.shape, (-right, right, -bottom, bottom)),
        replace(curve, error_mm=tuple(_RELATIVE_DEPTH_ERROR * depth_mm for depth_mm in curve.indentation_mm)),
        0.0,
        1 / light.inverse_distance_per_mm,
        loss=GlobalDimmingModel(TYPICAL_GLOBAL_DIMMING),
        deblurring=Deblurring(TYPICAL_POINT_SPREAD_MM, _SMOOTHNESS),
        warnings=(EstimateWarning.NOT_CALIBRATED,),
    )

"""The camera calibration as the paper does it, for reproduction and as the yardstick of every certificate."""

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from scipy import ndimage
from scipy.interpolate import RBFInterpolator

from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.brightness import smooth_gaussian
from ninedtact.errors import InputError
from ninedtact.shape.lens import PinMap, Points, central_mm_per_px

Point = Float[Array, "2"]


class CentralPinMissing(InputError):
    """The paper's way needs a board with a pin in the middle."""


def fit_published_pin_map(fit: BoardFit) -> tuple[PinMap, float]:
    """The paper's map through integer pin centres, and its mm per pixel from the five central anchors."""
    if not (fit.board.rows % 2 and fit.board.cols % 2):
        raise CentralPinMissing(
            f"expected a board with a pin in the middle for the paper's way, got {fit.board.cols} x {fit.board.rows} pins; "
            "use the lens model, which needs none"
        )
    points_px = integer_pin_centres_px(fit)
    return PinMap(fit.points_mm, points_px), _anchored_mm_per_px(fit.points_mm, points_px, fit.board.pitch_mm)


def _anchor_scales(points_mm: Points, points_px: Points, pitch_mm: float) -> Float[Array, " k"]:
    """Pitch over the distance in pixels of the central pin from each of its four neighbours."""
    distance_mm = np.hypot(*points_mm.T)
    middle, around = distance_mm < 0.1 * pitch_mm, np.abs(distance_mm - pitch_mm) < 0.1 * pitch_mm
    return np.asarray(pitch_mm / np.hypot(*(points_px[around] - points_px[middle]).T))


def _anchored_mm_per_px(points_mm: Points, points_px: Points, pitch_mm: float) -> float:
    """mm per pixel from the five central anchors: their mean distance."""
    return float(1 / (1 / _anchor_scales(points_mm, points_px, pitch_mm)).mean())


def anchored_mm_per_px_std(points_mm: Points, points_px: Points, pitch_mm: float) -> float:
    """Standard error of `_anchored_mm_per_px`, from the scatter of the four distances."""
    scales = _anchor_scales(points_mm, points_px, pitch_mm)
    return float(np.std(scales, ddof=1) / np.sqrt(len(scales)))


def integer_pin_centres_px(fit: BoardFit) -> Points:
    """Centre of each spot's pixels that are darker than half its depth, cut to whole pixels; predicted pins stay."""
    image = smooth_gaussian(fit.change, 1.5)
    half_step = 0.45 * fit.board.pitch_mm / central_mm_per_px(fit.lens, fit.board.pitch_mm)
    seen = [_integer_spot_centre(image, point, round(half_step)) for point in fit.points_px]
    return np.where(fit.found[:, None], seen, fit.points_px)


def _integer_spot_centre(image: Float32[Array, "rows cols"], point_px: Point, reach_px: int) -> Point:
    """Integer centroid of the thresholded spot around one point."""
    column, row = np.round(point_px).astype(int)
    top, left = max(row - reach_px, 0), max(column - reach_px, 0)
    piece = image[top : row + reach_px + 1, left : column + reach_px + 1]
    level = (np.median(piece) + piece[row - top, column - left]) / 2
    spots, _ = ndimage.label(piece < level)
    rows, columns = np.nonzero(spots == spots[row - top, column - left])
    return np.floor([left + columns.mean(), top + rows.mean()])


def published_leave_one_out_errors_mm(points_mm: Points, points_px: Points) -> Points:
    """Leave-one-out errors of the paper's map, image to skin, each pin predicted by a map through all others."""
    return np.array([_leave_one_out_error_mm(points_mm, points_px, pin) for pin in range(len(points_mm))])


def _leave_one_out_error_mm(points_mm: Points, points_px: Points, pin: int) -> Point:
    """Where the other pins put this one, minus where it is."""
    others = np.arange(len(points_mm)) != pin
    backwards = RBFInterpolator(points_px[others], points_mm[others], kernel="cubic")
    return np.asarray(backwards(points_px[pin : pin + 1])[0] - points_mm[pin])

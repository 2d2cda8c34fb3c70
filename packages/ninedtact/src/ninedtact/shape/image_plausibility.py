"""Checks whether an image can be a press on the sensor that its reference image shows, before anything is read from it.

Light is lost or gained as a whole where an LED fails, a lamp shines in or the exposure changes. A press changes it locally: gel
keeps its volume, so dents and bulges balance over the view, and half of the view keeps nearly the brightness of the reference
image. A gain or gamma that is taken out of an image (`light_change`) must leave the border of the view even, and is judged
itself: on the image as it was taken, so that no correction makes the light of another sensor plausible. The limits leave a factor
of two or more around 600 simulated presses of up to 12 N on six sensors and the images of real ones, but for the mean height: a
deep press that is measured from the reference image of another moment takes four fifths of it. An image of another sensor of the
same make may have the same light. Where one image is asked about (`require_plausible_image`), the fine structure of its skin is
therefore compared with that of the reference image as well.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.quantities import EstimateWarning, HeightMap, HeightSource, Rectified
from ninedtact.shape.light_change import LightChange
from ninedtact.shape.skin_identity import shows_another_skin

_COLS, _ROWS = 32, 24
"""Number of cells of the coarse image on which light is compared."""
_EVERY_PX = 4
_MIN_GREY, _MAX_GREY = 15.0, 250.0
"""Mean grey level below which an image is dark, and level from which a cell is overexposed."""
_MAX_OVEREXPOSED = 0.5
_DARKEST_MEDIAN = 0.6
_MEDIAN_RANGE = 0.8, 1.2
"""Median brightness relative to the reference image; wide deep presses dim the whole image by up to a tenth."""
_MAX_BRIGHTENING = 1.3
"""Brightness relative to the reference image above which gel cannot bulge."""
_BRIGHT_PERCENTILE = 99.5
_MAX_MEAN_HEIGHT_MM = 0.25
"""Largest mean height of the view, either way: gel that is pressed in bulges elsewhere, and little of it beyond the view."""
_UNCHANGED_SHARE = 0.6
"""Share of the view, that nearest to the median, in which the structure of the light is compared."""
_MAX_SPREAD = 0.06
"""Largest deviation of the relative brightness from its median within that share."""
_STRUCTURE_RANGE = 0.75, 1.3
"""Slope of the image's log brightness over the reference image's within that share; zero for an image without structure."""
_BORDER_TILES = 6, 8
"""Tiles of the view, by rows and columns, of which those along its border are compared."""
MAX_BORDER_SPREAD = 0.016
"""Deviation of the relative brightness of border tiles from their median, for the same share of them. Gel that is pressed leaves it
below 0.009, and under pin boards below 0.011; between two sensors it is 0.012 to 0.08."""
_MAX_STEADY_BORDER_SPREAD = 0.024
"""The same where no gain or gamma was taken out: a wide object near the border brightens it, up to 0.022 under 30 N."""
_MIN_STRUCTURE = 0.03
"""Standard deviation of the reference image's log brightness from which the slope is known."""

_ADVICE = {
    EstimateWarning.IMAGE_DARK: (
        "an image taken with the sensor's light on, got a dark one; switch the light on and take it again"
    ),
    EstimateWarning.IMAGE_OVEREXPOSED: (
        "an image that is not overexposed, got a white one; lower the exposure and take it again"
    ),
    EstimateWarning.IMAGE_UNLIKE_REFERENCE: (
        "a press on the skin of the reference image, got an image that no press explains; give images of one sensor and one "
        "session, the reference image without contact, and check that every LED lights"
    ),
}

_Cells = Float32[Array, "rows cols"]


class ImageImplausible(InputError):
    """An image cannot be a press on the sensor that its reference image shows."""


def require_plausible_image(
    name: str, image: Rectified, reference: Rectified, height: HeightMap, light: LightChange = LightChange()
) -> None:
    """Raise `ImageImplausible`, with the name of the image, where it cannot be a press on this sensor.

    image, height, light: as for `find_image_warnings`.
    """
    for warning in find_image_warnings(image, reference, height, light):
        raise ImageImplausible(f"{name}: expected {_ADVICE[warning]}")
    if shows_another_skin(image.grey, reference.grey):
        raise ImageImplausible(
            f"{name}: expected a press on the skin of the reference image, got an image without the fine structure of that skin, "
            "because it is of another sensor or gel, or more compressed; give images of one sensor, exposure and compression"
        )


def find_image_warnings(
    image: Rectified,
    reference: Rectified,
    height: HeightMap,
    light: LightChange = LightChange(),
    knows_depth: bool = True,
) -> tuple[EstimateWarning, ...]:
    """Return why an image cannot be a press on this sensor; empty for a plausible image.

    image: in the light of the reference image, where a change of light was taken out. height: the height map read from it. light:
    what was taken out. knows_depth: whether the heights have a known scale; the light along the border of the view is that of
    calibrated sensors, too.
    """
    corrected, then = _shrink(image.grey), np.maximum(_shrink(reference.grey), np.float32(1))
    now = light.restore(corrected)
    seen = _shrink((height.source != HeightSource.OUT_OF_VIEW).astype(np.float32)) > 0.9
    if not seen.any():
        return ()
    exposure = _find_exposure_warning(now[seen], then[seen])
    if exposure is not None:
        return (exposure,)
    ratio = corrected / then
    median = float(np.median((now / then)[seen]))
    mean_height_mm = float(_shrink(height.z_mm)[seen].mean())
    is_corrected = (light.gain, light.gamma) != (1, 1)
    differs = (
        not _MEDIAN_RANGE[0] <= median <= _MEDIAN_RANGE[1]
        or np.percentile(ratio[seen], _BRIGHT_PERCENTILE) > _MAX_BRIGHTENING
        or not _has_same_structure(np.log(np.maximum(now, 1)), np.log(then), seen)
    )
    if knows_depth:
        most_spread = MAX_BORDER_SPREAD if is_corrected else _MAX_STEADY_BORDER_SPREAD
        differs |= abs(mean_height_mm) > _MAX_MEAN_HEIGHT_MM or _border_spread(ratio, seen) > most_spread
    return (EstimateWarning.IMAGE_UNLIKE_REFERENCE,) if differs else ()


def find_exposure_warning(
    grey: UInt8[Array, "rows cols"], reference: UInt8[Array, "rows cols"]
) -> EstimateWarning | None:
    """Return whether an image is dark or overexposed, without a calibration; None for one that is neither."""
    now, then = (_shrink(image.astype(np.float32)) for image in (grey, reference))
    return _find_exposure_warning(now.ravel(), np.maximum(then, np.float32(1)).ravel())


def _find_exposure_warning(now: Float32[Array, " cells"], then: Float32[Array, " cells"]) -> EstimateWarning | None:
    """Return whether cells are dark or overexposed; those of the reference image are at least one."""
    if now.mean() < _MIN_GREY or np.median(now / then) < _DARKEST_MEDIAN:
        return EstimateWarning.IMAGE_DARK
    if (now >= _MAX_GREY).mean() > _MAX_OVEREXPOSED:
        return EstimateWarning.IMAGE_OVEREXPOSED
    return None


def _has_same_structure(now: _Cells, then: _Cells, seen: Bool[Array, "rows cols"]) -> bool:
    """Return whether the least changed part of the view has the light distribution of the reference image; logarithms of both."""
    change = now[seen] - then[seen]
    deviation = np.abs(change - np.median(change))
    spread = float(np.quantile(deviation, _UNCHANGED_SHARE))
    near, reference = now[seen][deviation <= spread], then[seen][deviation <= spread]
    structure = reference - reference.mean()
    if structure.std() < _MIN_STRUCTURE:
        return spread <= _MAX_SPREAD
    slope = float(structure @ (near - near.mean()) / (structure @ structure))
    return spread <= _MAX_SPREAD and _STRUCTURE_RANGE[0] <= slope <= _STRUCTURE_RANGE[1]


def border_light_unevenness(image: Rectified, reference: Rectified) -> float:
    """Return how much the light along the border of the view changed unevenly, as a fraction; all of the view shows skin."""
    now, then = (_shrink(one.grey) for one in (image, reference))
    return _border_spread(now / np.maximum(then, np.float32(1)), np.ones(now.shape, bool))


def _border_spread(ratio: _Cells, seen: Bool[Array, "rows cols"]) -> float:
    """Return how much the tiles along the border of the view differ in their change of brightness, as a fraction."""
    change = np.log(np.maximum(ratio, np.float32(1e-3)))
    known = np.where(seen, change, np.median(change[seen]))
    down, across = _BORDER_TILES
    tiles = np.median(known.reshape(down, _ROWS // down, across, _COLS // across), axis=(1, 3))
    border = np.concatenate([tiles[0], tiles[-1], tiles[1:-1, 0], tiles[1:-1, -1]])
    return float(np.quantile(np.abs(border - np.median(border)), _UNCHANGED_SHARE))


def _shrink(field: Float32[Array, "a b"]) -> _Cells:
    """Return the means of a field over the cells, from every fourth row and column, which is quick."""
    few = np.ascontiguousarray(field[::_EVERY_PX, ::_EVERY_PX])
    return np.asarray(cv2.resize(few, (_COLS, _ROWS), interpolation=cv2.INTER_AREA))

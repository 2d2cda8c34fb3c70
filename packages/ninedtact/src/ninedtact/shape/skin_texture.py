"""The fine structure of a skin, by which it is recognised: specks, bubbles, grain and old imprints, each sensor's own.

Images are compared at one size, by the logarithm of their brightness in a band between camera noise and light. Tiles are compared
one by one, so that a press or a new mark affects only the tiles that contain it.
"""

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

Field = Float32[Array, "down across"]

_MARGIN_PX = 12
"""Width of the margin that is cut off, because it shows housing and glare instead of skin."""
_TILES = (6, 8)
_LONG_SIDE_PX = 320
"""Size at which images are compared; the structure is still well sampled."""
_FINE_PX, _COARSE_PX = 1.5, 6.0
"""Band of the structure: finer detail is camera noise and compression, coarser detail is light."""
_BAND_NOISE = 0.171
"""Standard deviation that this band leaves of white noise: √(1/4πa² + 1/4πb² - 1/π(a² + b²)) for Gaussians a and b."""
_MIN_GREY = 8.0
"""Grey level below which a logarithm is mostly noise."""
FAINTEST_STRUCTURE = 7e-4
"""Contrast below which a skin is too uniform to be recognised: real ones have at least 1.0e-3, a rendered one 5e-4."""

_MAX_CONTRAST_RATIO = 1.5
"""Strength of the structure, relative to the reference image's, above which a tile shows the border of a contact."""
_MAX_CHANGE = 0.05
"""Change of a tile's brightness relative to the median change, above which the tile is pressed or bulges."""
_MIN_UNTOUCHED_SHARE = 0.15
"""Share of tiles that must be without contact before a skin is called another one; a pin board leaves none."""
_SAME_SKIN = 0.36
"""Median correlation of the tiles without contact below which they show another skin: at most 0.28 between three real sensors, at
least 0.58 for presses on one of them (0.42 as JPEG of quality 75), and at least 0.69 for 160 simulated presses of up to 12 N."""
_MIN_CONTRAST = 6e-4
"""Contrast of the reference image below which a rectified skin is too uniform for this decision."""


def log_brightness(grey: Float32[Array, "rows cols"]) -> Field:
    """Return the logarithm of the grey levels of an image, at the size of comparison."""
    logarithm = np.log(np.maximum(grey, np.float32(_MIN_GREY)))
    factor = _LONG_SIDE_PX / max(grey.shape)
    return (
        logarithm
        if factor == 1
        else np.asarray(cv2.resize(logarithm, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA))
    )


def fine_structure(image: Field) -> Field:
    """Return the detail of a logarithm of brightness between the two sizes of the band."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), _FINE_PX) - cv2.GaussianBlur(image, (0, 0), _COARSE_PX))


def remove_margin(image: Array) -> Array:
    """Return the image without its margin."""
    return image[_MARGIN_PX:-_MARGIN_PX, _MARGIN_PX:-_MARGIN_PX]


def split_into_tiles(image: Array) -> list[Array]:
    """Return the inside of the image in equal tiles, with more along the longer side."""
    down, across = _TILES if image.shape[0] <= image.shape[1] else _TILES[::-1]
    return [
        tile for band in np.array_split(remove_margin(image), down) for tile in np.array_split(band, across, axis=1)
    ]


def structure_similarity(earlier: Field, later: Field) -> float:
    """Return the median correlation of the tiles of two fine structures."""
    pairs = zip(split_into_tiles(earlier), split_into_tiles(later), strict=True)
    return float(np.median([_pearson_correlation(first, second) for first, second in pairs]))


def structure_contrast(earlier: Field, later: Field) -> float:
    """Return the contrast of the fine structure of the earlier of two images, the median over its tiles, corrected for noise."""
    second = np.abs(np.diff(later - earlier, n=2, axis=1))
    # 0.6745 and √6 as in `press_brightness.estimate_pixel_noise`; √2 because the difference contains the noise of two images.
    noise = _BAND_NOISE * float(np.median(second)) / 0.6745 / np.sqrt(6) / np.sqrt(2)
    strength = float(np.median([tile.std() for tile in split_into_tiles(fine_structure(earlier))]))
    return float(np.sqrt(max(strength**2 - noise**2, 0.0)))


def shows_another_skin(grey: Float32[Array, "rows cols"], reference_grey: Float32[Array, "rows cols"]) -> bool:
    """Return whether an image, pressed or not, lacks the fine structure of the reference image where nothing touches the skin.

    False also where that cannot be told: the skin is too uniform, or an object covers nearly all of it.
    """
    image, reference = log_brightness(grey), log_brightness(reference_grey)
    if structure_contrast(reference, image) < _MIN_CONTRAST:
        return False
    change = image - reference
    fields = fine_structure(reference), fine_structure(image), np.abs(change - np.median(change))
    correlations = [
        _pearson_correlation(then, now)
        for then, now, changed in zip(*map(split_into_tiles, fields), strict=True)
        if now.std() < _MAX_CONTRAST_RATIO * then.std() and changed.mean() < _MAX_CHANGE
    ]
    enough = len(correlations) >= _MIN_UNTOUCHED_SHARE * _TILES[0] * _TILES[1]
    return enough and float(np.median(correlations)) < _SAME_SKIN


def _pearson_correlation(first: Field, second: Field) -> float:
    """Return Pearson's correlation, zero where one image is constant."""
    first, second = first - first.mean(), second - second.mean()
    scale = np.sqrt((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / scale) if scale > 0 else 0.0

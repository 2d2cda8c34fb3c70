"""Recognition of a skin and of its motion by its fine structure: specks, bubbles, grain and old imprints, each sensor's own.

Images are compared at one size, by the logarithm of their brightness in a band between camera noise and light. Tiles are compared
one by one, so that a press or a new mark affects only the tiles that contain it.

The motion is found by least squares after Lucas & Kanade (1981) over the whole image, with the rotation as a third unknown; errors
follow from leaving out one tile at a time (docs/references.md). A motion vector is (shift x, shift y, turn) in pixels, where the
turn is the displacement of the middle of the right border; turns are positive clockwise on the screen. The structure is faint (a
thousandth of the brightness), yet it determines the motion to a tenth of a pixel, because the whole image contributes. A change of
scale is not fitted: contours of the camera's own shading correction widen and narrow with the light and would appear as one.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.quantities import BgrImage
from ninedtact.robust_noise import noise_by_second_differences, robust_std
from ninedtact.shape.lens_and_rectification import to_grey_float

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


def skin_texture_contrast(earlier: Field, later: Field) -> float:
    """Return the contrast of the fine structure of the earlier of two images, the median over its tiles, corrected for noise."""
    # √2 because the difference contains the noise of two images.
    noise = _BAND_NOISE * noise_by_second_differences(later - earlier, axis=1) / np.sqrt(2)
    strength = float(np.median([tile.std() for tile in split_into_tiles(fine_structure(earlier))]))
    return float(np.sqrt(max(strength**2 - noise**2, 0.0)))


def shows_another_skin(grey: Float32[Array, "rows cols"], reference_grey: Float32[Array, "rows cols"]) -> bool:
    """Return whether an image, pressed or not, lacks the fine structure of the reference image where nothing touches the skin.

    False also where that cannot be told: the skin is too uniform, or an object covers nearly all of it.
    """
    image, reference = log_brightness(grey), log_brightness(reference_grey)
    if skin_texture_contrast(reference, image) < _MIN_CONTRAST:
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


Motion = Float[Array, "3"]
HIGH_SIMILARITY = 0.5
"""Similarity above which the motion found from a start at rest is accepted without a second first guess."""
_MAX_ITERATIONS = 10
_CONVERGED_STEP_PX = 0.003
_HALF_WEIGHT_STDS = 2.0
"""Number of standard deviations at which a difference has half weight."""
_CLIPPED_STDS = 6.0


@dataclass(frozen=True)
class _Registration:
    """A motion, its standard errors, and the similarity of the images once it is undone."""

    motion: Motion
    error: Motion
    correlation: float


def _register_images(earlier: Field, later: Field) -> _Registration:
    """Return the motion from the earlier image to the later one."""
    found = _fit_motion(earlier, later, np.zeros(3))
    if found.correlation > HIGH_SIMILARITY:
        return found
    return max(
        found, _fit_motion(earlier, later, _phase_correlation_shift(earlier, later)), key=lambda fit: fit.correlation
    )


def _fit_motion(earlier: Field, later: Field, motion: Motion) -> _Registration:
    """Return the least-squares motion from a first guess, iterated until it converges."""
    for _ in range(_MAX_ITERATIONS):
        normal, right = _normal_equations(earlier, _undo_motion(later, motion))
        step = np.linalg.pinv(normal.sum(axis=0)) @ right.sum(axis=0)
        motion = motion + step
        if np.abs(step).max() < _CONVERGED_STEP_PX:
            break
    return _Registration(
        motion, _jackknife_error(normal, right), structure_similarity(earlier, _undo_motion(later, motion))
    )


def _normal_equations(earlier: Field, later: Field) -> tuple[Float[Array, "tiles 3 3"], Float[Array, "tiles 3"]]:
    """Return the normal equations of every tile: gradient times motion equals the difference of the images."""
    down, right = np.gradient((earlier + later) / 2)
    y, x = (np.indices(earlier.shape) - (np.array(earlier.shape)[:, None, None] - 1) / 2) / (earlier.shape[1] / 2)
    lacking = earlier - later
    terms = np.stack([right, down, x * down - y * right, lacking], axis=-1)
    spread = robust_std(lacking)
    weight = 1 / (1 + (lacking / (_HALF_WEIGHT_STDS * spread + 1e-9)) ** 2)
    weighted = split_into_tiles(weight[..., None] * terms[..., :3])
    sums = np.array(
        [
            weighted_tile.reshape(-1, 3).T @ tile.reshape(-1, 4)
            for weighted_tile, tile in zip(weighted, split_into_tiles(terms), strict=True)
        ]
    )
    return sums[..., :3], sums[..., 3]


def _jackknife_error(normal: Float[Array, "tiles 3 3"], right: Float[Array, "tiles 3"]) -> Motion:
    """Return the standard error by the jackknife over tiles, which includes errors that neighbouring pixels share."""
    without = (np.linalg.pinv(normal.sum(axis=0) - normal) @ (right.sum(axis=0) - right)[..., None])[..., 0]
    return np.asarray(np.sqrt((len(normal) - 1) * without.var(axis=0)))


def _phase_correlation_shift(earlier: Field, later: Field) -> Motion:
    """Return a first guess of a large shift, by phase correlation."""
    parts = [remove_margin(field) for field in (earlier, later)]
    first, second = (np.clip(part / (np.median(np.abs(part)) + 1e-9), -_CLIPPED_STDS, _CLIPPED_STDS) for part in parts)
    (x, y), _ = cv2.phaseCorrelate(first, second, cv2.createHanningWindow(first.shape[::-1], cv2.CV_32F))
    return np.array([x, y, 0.0])


def _undo_motion(image: Array, motion: Motion, border: int = cv2.BORDER_REPLICATE) -> Array:
    """Return an image of any type with a motion undone; border: OpenCV's border mode."""
    rows, cols = image.shape[:2]
    middle, angle = np.array([(cols - 1) / 2, (rows - 1) / 2]), motion[2] / (cols / 2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = np.column_stack([turn, middle + motion[:2] - turn @ middle])
    way = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, matrix, (cols, rows), flags=way, borderMode=border))


_MIN_SAME_SKIN_SIMILARITY = 0.3
"""Similarity above which two images show the same skin: at least 0.4 for one skin (also compressed, noisy, or at half the light),
at most 0.25 for different ones.
"""
MAX_SHIFT_PX = 0.6
"""Largest shift, 0.03 mm on the skin. Real skins are displaced by up to 0.45 px after the board has been pressed on them."""
MAX_TURN_DEG = 0.3
"""Largest rotation, 1.7 px at the image's border; real skins rotate by up to 0.1°."""
_SUBTRACTED_STANDARD_ERRORS = 2.0
"""Number of standard errors that are subtracted from a motion before it is compared with its limit."""


@dataclass(frozen=True)
class SkinMotion:
    """Motion of the skin from one image to another, in pixels (x, y) of the raw image."""

    shift_px: tuple[float, float]
    """Shift of the middle of the image."""
    turn_deg: float
    """Rotation, clockwise on the screen."""
    shift_error_px: float
    """Standard error of the shift, of the worse axis."""
    turn_error_deg: float
    correlation: float
    """Correlation of the fine structure, once the motion is undone."""
    contrast: float
    """Standard deviation of the structure in the earlier image, as a fraction of the brightness, corrected for noise."""

    @property
    def distance_px(self) -> float:
        """Length of the shift."""
        return float(np.hypot(*self.shift_px))

    @property
    def observable(self) -> bool:
        """Whether the skin has enough structure to be recognised."""
        return self.contrast >= FAINTEST_STRUCTURE

    @property
    def is_same_skin(self) -> bool:
        """Whether the two images show the same skin; only then is the motion meaningful."""
        return self.observable and self.correlation >= _MIN_SAME_SKIN_SIMILARITY

    @property
    def is_displaced(self) -> bool:
        """Whether a skin that was recognised is displaced or rotated by more than the limits, beyond the error."""
        shifted = self.distance_px - _SUBTRACTED_STANDARD_ERRORS * self.shift_error_px > MAX_SHIFT_PX
        turned = abs(self.turn_deg) - _SUBTRACTED_STANDARD_ERRORS * self.turn_error_deg > MAX_TURN_DEG
        return self.is_same_skin and (shifted or turned)

    def undone(self, image: BgrImage) -> BgrImage:
        """Return the later image with the motion undone, borders repeated."""
        return _undo_motion(image, self.vector(image.shape))

    def valid_mask(self, shape: tuple[int, ...]) -> Field:
        """Return a mask above zero where the image with the motion undone shows what the camera saw."""
        return _undo_motion(np.ones(shape[:2], np.float32), self.vector(shape), cv2.BORDER_CONSTANT)

    def vector(self, shape: tuple[int, ...]) -> Motion:
        """Return the motion vector in pixels; zero where the skin was not recognised."""
        turn_px = np.deg2rad(self.turn_deg) * shape[1] / 2
        return np.array([*self.shift_px, turn_px]) * self.is_same_skin


def measure_skin_motion(before: BgrImage, after: BgrImage) -> SkinMotion:
    """Return the motion between two reference images of the same size."""
    earlier, later = log_brightness(to_grey_float(before)), log_brightness(to_grey_float(after))
    found = _register_images(fine_structure(earlier), fine_structure(later))
    scale, half_width = max(before.shape) / max(earlier.shape), earlier.shape[1] / 2
    x, y, turn = found.motion.tolist()
    return SkinMotion(
        (x * scale, y * scale),
        float(np.rad2deg(turn / half_width)),
        float(found.error[:2].max() * scale),
        float(np.rad2deg(found.error[2] / half_width)),
        found.correlation,
        skin_texture_contrast(earlier, later),
    )

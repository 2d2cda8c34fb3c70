"""Measurement of drift: a reference image of today compared with the reference images of the calibration. In:
`CalibratedReference`, loaded from a sensor folder, and a raw image. Out: `DriftMeasurement`, which
`diagnosis_and_reference_check` interprets.

    images → motion of the skin → motion undone → light (gain, field, colour) → marks or a contact → findings

The motion of the skin is that of its fine structure: specks, bubbles, old imprints. The method is least squares after Lucas &
Kanade (1981) over the whole image, with the rotation as a third unknown; errors follow from leaving out one tile at a time
(docs/references.md). A motion vector is (shift x, shift y, turn) in pixels, where the turn is the displacement of the middle of
the right border; turns are positive clockwise on the screen.

The structure is faint (a thousandth of the brightness), yet it determines the motion to a tenth of a pixel, because the whole
image contributes. A change of scale is not fitted: contours of the camera's own shading correction widen and narrow with the
light and would appear as one.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from ninedtact.calibration.drift.brightness_change import BrightnessChange, separate_brightness_change
from ninedtact.calibration.press_brightness import (
    BgrImage,
    estimate_pixel_noise,
    flat_fielded_brightness_change,
    relative_brightness,
    require_usable_exposure,
    to_grey_float,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import require_image_size
from ninedtact.quantities import Frame, HeightSource, Rectified
from ninedtact.shape.depth import DepthCurve
from ninedtact.shape.lens_and_rectification import OUT_OF_VIEW_PX, Rectification
from ninedtact.shape.skin_texture import (
    FAINTEST_STRUCTURE,
    Field,
    fine_structure,
    log_brightness,
    remove_margin,
    split_into_tiles,
    structure_contrast,
    structure_similarity,
)

Motion = Float[Array, "3"]

_HIGH_SIMILARITY = 0.5
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
    if found.correlation > _HIGH_SIMILARITY:
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
    spread = np.median(np.abs(lacking)) / 0.6745
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
        structure_contrast(earlier, later),
    )


_FLIPS = {"turned by 180°": -1, "mirrored left to right": 1, "mirrored top to bottom": 0}
"""Ways in which a camera's driver may flip images, with OpenCV's flip code."""
_MIN_FLIP_SHIFT_PX = 5.0
"""Shift above which flipped images are tested too: the skin may be the same one rotated or mirrored, because old imprints of the
board look alike from both sides.
"""
_WORST_PERCENTILE = 99
"""Percentile of the view that represents its worst error, so that single pixels do not."""
_NEIGHBOURHOOD_PX = 20


@dataclass(frozen=True)
class CalibratedReference:
    """The reference images of a sensor's calibration."""

    lens_image: BgrImage
    """Reference image before the board; the lens was calibrated for the skin in this position."""
    depth_image: BgrImage
    """Reference image before the ball; the depth curve was calibrated in this light."""
    rectify: Rectification
    curve: DepthCurve

    @cached_property
    def rectified_reference(self) -> Rectified:
        """The depth image on the skin's grid."""
        return self.rectify(Frame(self.depth_image))

    def on_skin_grid(self) -> "CalibratedReference":
        """Return the same references as rectified grey images, to be compared with images that are rectified already."""
        lens_image, depth_image = (
            _rectify_to_bgr(self.rectify, image) for image in (self.lens_image, self.depth_image)
        )
        rows, cols = depth_image.shape[:2]
        own_px = np.moveaxis(np.indices((rows, cols), np.float32)[::-1], 0, -1)
        source_px = np.where(self.view_mask[..., None], own_px, np.float32(OUT_OF_VIEW_PX))
        rectify = Rectification(source_px, self.rectify.mm_per_px, (rows, cols), self.rectify.calibrated_area_mm)
        return CalibratedReference(lens_image, depth_image, rectify, self.curve)

    @property
    def view_mask(self) -> Bool[Array, "rows cols"]:
        """The pixels at which the camera sees the skin."""
        return self.rectify.height_source != HeightSource.OUT_OF_VIEW

    @property
    def mm_per_raw_px(self) -> float:
        """Scale of the raw image in the middle of the skin, the mean of all directions."""
        source = self.rectify.source_px
        row, col = source.shape[0] // 2, source.shape[1] // 2
        reach = min(_NEIGHBOURHOOD_PX, source.shape[0] - 1 - row, source.shape[1] - 1 - col)
        across = source[row, col + reach] - source[row, col - reach]
        down = source[row + reach, col] - source[row - reach, col]
        raw_px = np.sqrt(np.abs(np.linalg.det(np.stack([across, down]))))
        return float(2 * reach * self.rectify.mm_per_px / raw_px)

    def height_mm(self, change: Float[Array, "*shape"], grey: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the depth that corresponds to a relative change of brightness; brightening counts as the depth that it
        would hide.
        """
        signal = np.abs(change) * (grey if self.curve.signal == "difference" else 1.0)
        return np.asarray(np.interp(signal, self.curve.darkening, self.curve.indentation_mm))

    def worst_height_mm(self, other: BgrImage) -> float:
        """Return the height error, at the worst of the view, of measuring one image with this one as its reference."""
        then = self.rectified_reference
        ratio = cv2.GaussianBlur(relative_brightness(self.rectify(Frame(other)), then), (0, 0), 3.0) - 1
        return float(np.percentile(self.height_mm(ratio, then.grey)[self.view_mask], _WORST_PERCENTILE))


def _rectify_to_bgr(rectify: Rectification, image: BgrImage) -> BgrImage:
    """Return a raw image rectified, in whole grey levels."""
    grey = np.rint(rectify(Frame(image)).grey).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))


@dataclass(frozen=True)
class DriftMeasurement:
    """All measurements on one image."""

    known: CalibratedReference
    moved: SkinMotion
    """Motion since the board press."""
    nearest: SkinMotion
    """Motion since the ball press."""
    flipped: str | None
    """How the image is flipped relative to the calibration's; None where it is not."""
    change: BrightnessChange
    colour: tuple[float, float, float]
    """Relative change of blue, green and red, relative to their mean."""
    height_mm: float
    """Height error, at the worst of the view, if the calibration's reference image were kept."""


def load_calibrated_reference(sensor: SensorFolder) -> CalibratedReference:
    """Load the reference images. A sensor whose lens was imported has only that of the ball.

    Raises `SensorFolderDamaged`, also for an imported sensor without images, and `DepthNotCalibrated`.
    """
    depth_image = sensor.stored_image("ball_reference").image
    lens_image = depth_image if sensor.is_imported else sensor.stored_image("board_reference").image
    return CalibratedReference(lens_image, depth_image, sensor.rectification, sensor.depth.curve)


def measure_drift(known: CalibratedReference, today: BgrImage) -> DriftMeasurement:
    """Measure what has changed; raises `ImageUnusable` for a dark or overexposed image, `ImageSizeWrong`.

    today: raw image (rows, cols, 3) of the skin, which should be without contact.
    """
    require_image_size(today, *known.rectify.raw_shape, "today's image")
    require_usable_exposure("reference image", today)
    nearest = measure_skin_motion(known.depth_image, today)
    moved = measure_skin_motion(known.lens_image, today)
    return DriftMeasurement(
        known,
        moved if moved.is_same_skin else nearest,
        nearest,
        _detect_flip(known.depth_image, today, nearest),
        _measure_brightness_change(known, today, nearest),
        _measure_colour_change(known.depth_image, today),
        known.worst_height_mm(today),
    )


def _detect_flip(known: BgrImage, today: BgrImage, motion: SkinMotion) -> str | None:
    """Return how today's image is flipped, or None."""
    if motion.correlation > _HIGH_SIMILARITY and motion.distance_px < _MIN_FLIP_SHIFT_PX:
        return None
    ways = {way: measure_skin_motion(known, np.asarray(cv2.flip(today, code))) for way, code in _FLIPS.items()}
    best = max(ways, key=lambda way: ways[way].correlation)
    return best if ways[best].is_same_skin and ways[best].correlation > motion.correlation else None


def _measure_brightness_change(known: CalibratedReference, today: BgrImage, motion: SkinMotion) -> BrightnessChange:
    """Return the change of the skin's brightness with its motion undone, where both images show it."""
    grey = float(to_grey_float(known.depth_image).mean())
    noise = estimate_pixel_noise(flat_fielded_brightness_change(known.depth_image, today)) / grey
    seen = known.view_mask & (known.rectify.resample(motion.valid_mask(today.shape)) > 0)
    return separate_brightness_change(
        known.rectified_reference, known.rectify(Frame(motion.undone(today))), seen, noise
    )


def _measure_colour_change(known: BgrImage, today: BgrImage) -> tuple[float, float, float]:
    """Return the change of each channel's brightness, the median over the image, relative to the mean of the channels."""
    gains = np.median(today.astype(np.float32) / np.maximum(known, 1), axis=(0, 1))
    blue, green, red = (gains / gains.mean() - 1).tolist()
    return blue, green, red

"""The measurement of all that has changed in an image without contact since the reference images of a sensor's calibration.

images → motion of the skin → motion undone → light (gain, field, colour, gamma) → marks or a contact
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from ninedtact.calibration.brightness_change import (
    OVEREXPOSED,
    BrightnessChange,
    dim_warning,
    estimate_pixel_noise,
    flat_fielded_brightness_change,
    relative_brightness,
    require_usable_exposure,
    separate_brightness_change,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import require_image_size
from ninedtact.quantities import BgrImage, Frame, HeightSource, Rectified
from ninedtact.shape.deblurring import block_means
from ninedtact.shape.depth import DepthCurve
from ninedtact.shape.image_plausibility import border_light_unevenness
from ninedtact.shape.lens_and_rectification import OUT_OF_VIEW_PX, Rectification, to_grey_float
from ninedtact.shape.light_change import GammaFit, LightBands, LightCorrection, fit_gamma
from ninedtact.shape.sharpness import Sharpness, is_compressed, is_smoother, measure_sharpness
from ninedtact.shape.skin_identity import HIGH_SIMILARITY, SkinMotion, measure_skin_motion

FLIPS = {"turned by 180°": -1, "mirrored left to right": 1, "mirrored top to bottom": 0}
"""Ways in which a camera's driver may flip images, with OpenCV's flip code."""
_MIN_FLIP_SHIFT_PX = 5.0
"""Shift above which flipped images are tested too: the skin may be the same one rotated or mirrored, because old imprints of the
board look alike from both sides.
"""
_MIN_FLIP_SIMILARITY, _MIN_FLIP_GAIN = 0.45, 0.03
"""Similarity of a flipped image, and what it gains by the flip: the contours of even light are alike from both sides."""
_WORST_PERCENTILE = 99
"""Percentile of the view that represents its worst error, so that single pixels do not."""
_NEIGHBOURHOOD_PX = 20
_CELL_PX = 8
"""Side of the cells on which gamma is fitted, rectified pixels."""
_MAX_FULL = 0.1
"""Share of overexposed raw pixels in a rectified one from which its brightness is not compared."""


@dataclass(frozen=True)
class CalibratedReference:
    """The reference images of a sensor's calibration."""

    lens_image: BgrImage
    """Reference image before the board; the lens was calibrated for the skin in this position."""
    depth_image: BgrImage
    """Reference image before the ball; the depth curve was calibrated in this light."""
    rectify: Rectification
    curve: DepthCurve | None
    """None where no depth is calibrated yet; all heights are zero then."""

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
        if self.curve is None:
            return np.zeros(np.shape(change))
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
    dim: str | None = None
    """Why the image is too dim for its skin to be recognised, in words; None where it is not."""
    sharpness: Sharpness | None = None
    """Sharpness relative to the calibration's images; None where it cannot be told."""
    is_smoothed: bool = False
    """Whether the image lacks the noise of the camera, as a blurred one does."""
    gamma: GammaFit | None = None
    """Gamma and gain that explain the change of the brightness; None where they cannot be told."""
    border_light_unevenness: float = 0.0
    """How much the light along the border of the view changed unevenly, which a press leaves as it is."""
    bands: LightBands | None = None
    """Bands of a dimmed light in today's image, which all else is measured without."""
    is_compressed: bool = False
    """Whether one of the images was compressed in blocks, which hide and feign the structure of the skin."""

    def equivalent_height_mm(self, change: float) -> float:
        """Return the depth that corresponds to a relative change at the image's mean brightness."""
        grey = float(self.known.rectified_reference.grey.mean())
        return float(self.known.height_mm(np.array(change), np.array(grey)))


def load_calibrated_reference(sensor: SensorFolder) -> CalibratedReference:
    """Load the reference images. A sensor whose lens was imported has only that of the ball.

    Raises `SensorFolderDamaged`, also for an imported sensor without images, and `CalibrationError`.
    """
    depth_image = sensor.stored_image("ball_reference").image
    lens_image = depth_image if sensor.is_imported else sensor.stored_image("board_reference").image
    return CalibratedReference(lens_image, depth_image, sensor.rectification, sensor.depth.curve)


def measure_drift(known: CalibratedReference, today: BgrImage) -> DriftMeasurement:
    """Measure what has changed; raises `CalibrationError` for a dark or overexposed image, `FileFormatError`.

    today: raw image (rows, cols, 3) of the skin, which should be without contact.
    """
    require_image_size(today, *known.rectify.raw_shape, "today's image")
    require_usable_exposure("reference image", today)
    is_blocky = any(map(is_compressed, (today, known.lens_image, known.depth_image)))
    nearest = measure_skin_motion(known.depth_image, today)
    bands = LightCorrection(known.rectify)(known.rectify(Frame(nearest.undone(today))), known.rectified_reference)[
        1
    ].bands
    if bands is not None:
        today = np.clip(np.rint(today / bands.factor_over(today.shape)), 0, 255).astype(np.uint8)
        nearest = measure_skin_motion(known.depth_image, today)
    moved = measure_skin_motion(known.lens_image, today)
    change = _measure_brightness_change(known, today, nearest)
    if change.contact is not None and moved.is_same_skin and known.lens_image is not known.depth_image:
        # What the skin looked like already before the board was pressed is no contact.
        since_board = _measure_brightness_change(replace(known, depth_image=known.lens_image), today, moved)
        change = change if since_board.contact is not None else since_board
    return DriftMeasurement(
        known,
        moved if moved.is_same_skin else nearest,
        nearest,
        _detect_flip(known.depth_image, today, nearest),
        change,
        _measure_colour_change(known.depth_image, today),
        known.worst_height_mm(today),
        dim_warning(today),
        measure_sharpness((known.lens_image, known.depth_image), nearest.undone(today)),
        is_smoother(today, known.depth_image),
        _fit_gamma(known, today, moved if moved.is_same_skin else nearest),
        border_light_unevenness(known.rectify(Frame(nearest.undone(today))), known.rectified_reference),
        bands,
        is_blocky,
    )


def _detect_flip(known: BgrImage, today: BgrImage, motion: SkinMotion) -> str | None:
    """Return how today's image is flipped, or None."""
    if motion.correlation > HIGH_SIMILARITY and motion.distance_px < _MIN_FLIP_SHIFT_PX:
        return None
    ways = {way: measure_skin_motion(known, np.asarray(cv2.flip(today, code))) for way, code in FLIPS.items()}
    best = max(ways, key=lambda way: ways[way].correlation)
    surely = ways[best].correlation > max(_MIN_FLIP_SIMILARITY, motion.correlation + _MIN_FLIP_GAIN)
    return best if ways[best].is_same_skin and surely else None


def _measure_brightness_change(known: CalibratedReference, today: BgrImage, motion: SkinMotion) -> BrightnessChange:
    """Return the change of the skin's brightness with its motion undone, where both images show it."""
    grey = float(to_grey_float(known.depth_image).mean())
    noise = estimate_pixel_noise(flat_fielded_brightness_change(known.depth_image, today)) / grey
    seen = known.view_mask & (known.rectify.resample(motion.valid_mask(today.shape)) > 0)
    full = (np.maximum(motion.undone(today), known.depth_image).max(axis=2) >= OVEREXPOSED).astype(np.float32)
    seen &= known.rectify.resample(full) < _MAX_FULL
    return separate_brightness_change(
        known.rectified_reference, known.rectify(Frame(motion.undone(today))), seen, noise
    )


def _fit_gamma(known: CalibratedReference, today: BgrImage, motion: SkinMotion) -> GammaFit | None:
    """Return the gamma of today's image over the skin that is in view."""
    now = block_means(known.rectify(Frame(motion.undone(today))).grey, _CELL_PX)
    visible = known.view_mask & (known.rectify.resample(motion.valid_mask(today.shape)) > 0)
    in_view = block_means(visible.astype(np.float32), _CELL_PX) > 0.99
    fits = []
    for image in (known.lens_image, known.depth_image):
        then = np.maximum(block_means(known.rectify(Frame(image)).grey, _CELL_PX), np.float32(1))
        seen = in_view & (np.maximum(now, then) < OVEREXPOSED - 5)
        fits += [fit_gamma(now[seen] / then[seen], then[seen])] if seen.any() else []
    # The light of the two sessions of a calibration differs a little: of equally good fits, the one that changes least is right.
    known_fits = [fit for fit in fits if fit is not None]
    best = min((fit.spread for fit in known_fits), default=0.0)
    good = [fit for fit in known_fits if fit.spread <= 1.5 * best + 0.001]
    return min(good, key=lambda fit: abs(fit.gamma - 1), default=None)


def _measure_colour_change(known: BgrImage, today: BgrImage) -> tuple[float, float, float]:
    """Return the change of each channel's brightness, the median over the image, relative to the mean of the channels."""
    gains = np.median(today.astype(np.float32) / np.maximum(known, 1), axis=(0, 1))
    blue, green, red = (gains / gains.mean() - 1).tolist()
    return blue, green, red

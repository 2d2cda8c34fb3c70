"""Sharpness of an image of a skin, from the fine detail that it shares with two sharp images of the same skin.

Noise and rounding are not shared by two images, so the covariance of two images in a band of detail is that of the skin alone:

    sharpness in a band = cov(image, known) / cov(known, other known)

A blur of standard deviation σ leaves exp(-2π²σ²f²) of detail of frequency f: of the fine band 60 % at 1 px, 20 % at 2 px and less
than 15 % from 3 px on, while the coarse band tells that the skin is the same. Bands and blur are in pixels of an image of 640
pixels along its long side. Motion, noise and light leave the fine band; compression takes it away, and is told by its blocks.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.quantities import BgrImage
from ninedtact.shape.lens_and_rectification import to_grey_float

_LONG_SIDE_PX = 640
_MIN_GREY = 8.0
_MARGIN_PX = 24
_TILES = 6, 8
_FINE_PX, _MIDDLE_PX, _COARSE_PX = (1.0, 2.0), (4.0, 8.0), (8.0, 16.0)
"""Bands of detail: standard deviations of the two Gaussians whose difference they are."""
_FAINTEST_DETAIL = 3e-8
"""Variance of the log brightness in the fine band below which a skin has no fine detail: real ones have 15e-8 to 22e-8, rendered
ones less than 0.5e-8."""
_MIN_FINE = 0.3
"""Sharpness of the fine band below which an image is out of focus: at least 0.5 under motion, noise, gain and gamma."""
_MIN_COARSE = 0.5
"""Sharpness of the coarse band from which the skin of an image is comparable with the known one."""
_SHARP_FINE = 0.5
"""Sharpness of the fine band from which an image shows what a sharp image of its session would show."""
_MAX_BLOCKINESS = 1.5
"""Steps at the borders of blocks of 8 pixels, relative to those between: 2.2 or more in JPEG images of quality 90 and below."""
_MIN_FINE_SHARE = 0.2
"""Fine over middle detail below which no camera in focus took two images: real ones have 0.27 to 0.87, blurred ones up to 0.18."""
_MIN_NOISE_GREY = 0.25
"""Pixel noise below which an image was smoothed: real ones, and means of several, have 0.37 or more, blurred ones up to 0.22."""
_MAX_NOISE_RATIO = 0.6
"""Pixel noise of such an image relative to that of a sharp image of the same camera."""

_Log = Float32[Array, "rows cols"]


@dataclass(frozen=True)
class Sharpness:
    """Detail of an image relative to sharp images of the same skin; 1 is as sharp, 0 shows none of it."""

    fine: float
    coarse: float

    @property
    def is_lost(self) -> bool:
        """Whether the fine detail of the skin is missing, because the image is out of focus or shows another skin."""
        return self.fine < _MIN_FINE

    @property
    def is_sharp(self) -> bool:
        """Whether the image shows the fine detail of the skin as a sharp one does, at the same place."""
        return self.fine >= _SHARP_FINE

    @property
    def is_out_of_focus(self) -> bool:
        """Whether the coarse detail is that of the known skin and the fine one is missing."""
        return self.is_lost and self.coarse > _MIN_COARSE


def measure_sharpness(known: tuple[BgrImage, BgrImage], image: BgrImage) -> Sharpness | None:
    """Return the sharpness of an image of the skin of two sharp images, all of one size and without motion between them.

    The image may be one of the known images, or an edited copy of one. None where it cannot be told: the known images are one, or
    show no fine detail, or one of the images was compressed in blocks.
    """
    if np.array_equal(*known) or any(map(is_compressed, (*known, image))):
        return None
    first, second, today = (_log_brightness(one) for one in (*known, image))
    of_skin = _shared_detail(first, second, _FINE_PX)
    if of_skin < _FAINTEST_DETAIL:
        return None
    # The image may share the noise of the known image of which it is a copy, but not that of both.
    fine = min(_shared_detail(one, today, _FINE_PX) for one in (first, second)) / of_skin
    coarse = min(_shared_detail(one, today, _COARSE_PX) for one in (first, second))
    return Sharpness(fine, coarse / max(_shared_detail(first, second, _COARSE_PX), 1e-12))


def lacks_detail_of(known: tuple[BgrImage, BgrImage], sharp: BgrImage, image: BgrImage) -> bool:
    """Return whether an image, pressed or not, lacks fine detail of the skin; False where that cannot be told.

    known: two images of the skin. sharp: an image of the same session that shows this detail. The skin may have been shifted.
    """
    before, now = (measure_sharpness(known, one) for one in (sharp, image))
    if before is None or now is None or not before.is_sharp or not now.is_lost:
        return False
    unshifted = measure_sharpness(known, shift_image(image, find_detail_shift(known[0], image)))
    return unshifted is None or unshifted.is_lost


def find_detail_shift(known: BgrImage, image: BgrImage) -> tuple[int, int]:
    """Return by how many pixels to the right and down the fine detail of the skin is shifted: the peak of the correlation."""
    first, second = (_detail(_log_brightness(one), _FINE_PX) for one in (known, image))
    correlation = np.fft.irfft2(np.fft.rfft2(first).conj() * np.fft.rfft2(second), s=first.shape)
    peak = np.array(np.unravel_index(correlation.argmax(), first.shape))
    sizes = np.array(first.shape)
    down, right = ((peak + sizes // 2) % sizes - sizes // 2) * known.shape[1] / first.shape[1]
    return round(right), round(down)


def shift_image(image: BgrImage, shift_px: tuple[int, int]) -> BgrImage:
    """Return an image without a shift to the right and down; what was beyond one border appears at the other."""
    return np.roll(image, (-shift_px[1], -shift_px[0]), (0, 1))


def is_pair_smoothed(first: BgrImage, second: BgrImage) -> bool:
    """Return whether two images of a skin share no fine detail and one lacks the noise of a camera, so that it is blurred."""
    if is_compressed(first) or is_compressed(second):
        return False
    if min(_pixel_noise(first), _pixel_noise(second)) > _MIN_NOISE_GREY:
        return False
    logs = _log_brightness(first), _log_brightness(second)
    return _shared_detail(*logs, _FINE_PX) < _MIN_FINE_SHARE * _shared_detail(*logs, _MIDDLE_PX)


def is_smoother(image: BgrImage, sharp: BgrImage) -> bool:
    """Return whether an image lacks the noise of the camera that took a sharp image, so that it is blurred."""
    if is_compressed(image) or is_compressed(sharp):
        return False
    return _pixel_noise(image) < min(_MIN_NOISE_GREY, _MAX_NOISE_RATIO * _pixel_noise(sharp))


def _log_brightness(image: BgrImage) -> _Log:
    logarithm = np.log(np.maximum(to_grey_float(image), np.float32(_MIN_GREY)))
    factor = _LONG_SIDE_PX / max(image.shape)
    if factor == 1:
        return np.asarray(logarithm)
    return np.asarray(cv2.resize(logarithm, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA))


def _shared_detail(first: _Log, second: _Log, band_px: tuple[float, float]) -> float:
    """Return the covariance of two images in a band, the median over tiles, so that what lies on some does not matter."""
    return _covariance(_detail(first, band_px), _detail(second, band_px))


def _detail(image: _Log, band_px: tuple[float, float]) -> _Log:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), band_px[0]) - cv2.GaussianBlur(image, (0, 0), band_px[1]))


def _covariance(first: _Log, second: _Log) -> float:
    """Return the mean product of two fields of detail, the median over tiles."""
    product = (first * second)[_MARGIN_PX:-_MARGIN_PX, _MARGIN_PX:-_MARGIN_PX]
    down, across = _TILES
    tiles = [tile for row in np.array_split(product, down) for tile in np.array_split(row, across, axis=1)]
    return float(np.median([tile.mean() for tile in tiles]))


def _pixel_noise(image: BgrImage) -> float:
    """Return the standard deviation of a pixel from second differences, grey levels, without rounding to whole levels."""
    second = np.diff(to_grey_float(image), n=2, axis=1)
    down, across = _TILES
    tiles = [tile for row in np.array_split(second, down) for tile in np.array_split(row, across, axis=1)]
    return float(np.median([tile.std() for tile in tiles]) / np.sqrt(6))


def is_compressed(image: BgrImage) -> bool:
    """Return whether an image was compressed in blocks, as JPEG does."""
    return _blockiness(image) > _MAX_BLOCKINESS


def _blockiness(image: BgrImage) -> float:
    """Return the mean step between blocks of 8 pixels relative to the median of the steps within, the larger of both directions."""
    grey = to_grey_float(image)
    ratios = []
    for lines in (grey, grey.T):
        steps = np.abs(np.diff(lines, axis=1)).mean(axis=0)
        phases = [float(steps[phase::8].mean()) for phase in range(8)]
        ratios.append(phases[7] / max(float(np.median(phases)), 1e-3))
    return max(ratios)

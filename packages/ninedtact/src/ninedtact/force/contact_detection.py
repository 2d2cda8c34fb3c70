"""Contact detection: whether anything touches the skin, and where. Without contact the force is exactly zero.

Something touches where the image, compared with the reference image and smoothed over about a millimetre, is darker than its own
noise could make it anywhere. The noise is estimated from the image itself, as far as it is white, and from the grey levels: an
image without noise, as compression leaves it, is wrong by up to one of them over wide regions. In a stream, what images without
contact showed (`Reading.stream`) replaces that bound. So the rule needs no setting for a sensor that it has not seen, and a lamp
that is brighter or dimmer than it was is not a contact. Where the noise of a stream is new in every image, a fainter contact shows
by staying: three images one after another are darker in one place than the noise of that place (`find_faint_contact`). **To change
the contact threshold, change `ContactThreshold`.**

`detect_contact` returns whether anything touches, from a reading alone. `find_contact_region` returns where, on the cells of the
traction inversion.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.reading import Reading
from ninedtact.robust_noise import noise_by_second_differences, robust_std
from ninedtact.shape.surface import connected_parts_with

View = Float32[Array, "rows cols"]
ContactTest = Callable[[Reading], bool]


@dataclass(frozen=True)
class ContactThreshold:
    """How much darker than the rest of the image, after smoothing, counts as contact."""

    noise_stds: float = 9.0
    """Threshold in standard deviations of the smoothed noise. The largest value in 1,200 images without contact, of 120 simulated
    sensors, was 7.0, and 7.7 on the cells of the inversion. A tenth of contacts of 0.05 to 0.1 N is overlooked, and two in
    a hundred of stronger ones."""
    min_darkening: float = 1e-3
    """Relative darkening below which no contact is detected, because a reference image is no more accurate than that."""
    reference_noises: float = 3.0
    """Threshold in noises (`StreamMemory.noise`) of the reference images."""
    learnt_darkenings: float = 1.4
    """Threshold in darkenings of the stream (`StreamMemory.darkening`), once they are known."""
    least_and_most_noises: tuple[float, float] = (2.0, 6.0)
    """The least and the most that this may be, in noises: a contact that is too light to be detected darkens without noise."""
    learnt_after_s: float = 10.0
    """Time from which the noise of the stream is known and replaces the bound from the grey levels."""
    faint_stds: float = 3.75
    """Threshold of a faint contact in standard deviations of its cell (`CellNoise`), in three images one after another: 2.8 was the
    most in 1,500 images without contact in motion JPEG, and a contact of 0.1 N has 5 and more."""
    border_darkening: float = 6e-3
    """Darkness that is greatest at the border of the view is a contact from here on. Less of it may be light of the LEDs there: two
    images of an untouched real sensor, taken at other times, differ by 4.7e-3 in its corners."""


@dataclass(frozen=True)
class ContactRegionSettings:
    """Which cells belong to a contact that has been detected."""

    threshold: ContactThreshold = ContactThreshold()
    smoothing_cells: float = 1.5
    shallow_mm: float = 0.02
    shallow_fraction: float = 0.03
    """Fraction of the maximum indentation. Skin that is less deep than this fraction, or than `shallow_mm`, does not count as
    pressed in, because the contact beside it draws it down."""
    deep_mm: float = 0.05
    deep_fraction: float = 0.1
    """Fraction of the maximum indentation. Every connected part of a contact reaches this fraction, and `deep_mm`, somewhere."""
    thin_fraction: float = 0.03
    """Fraction of the maximum darkening. Every connected part of a contact reaches it where it is deep: on a base that yields, skin
    far from an object lies low, but its gel is no thinner. It is not smoothed, so that strokes and teeth are dark, and not relative
    to the median of the view, so that wide objects are."""
    level_fraction: float = 0.2
    """Fraction of the maximum indentation. Skin counts as pressed in from the median height of the view, but from no deeper level
    than this: light that is a little dimmer than the reference's lowers all of the skin alike, which is no contact."""
    bright_fraction: float = 0.6
    """Fraction of the maximum brightening. Brighter cells lie on gel that bulges beside an object, although skin over a base that
    yields is low there."""
    dark_fraction: float = 0.5
    """Fraction of the maximum darkening. Cells that are darker than this are in contact, whatever height the depth reader gives."""


SMOOTHING_CELLS = 2.0
_FAINT_SMOOTHING_CELLS = 1.0
FAINT_IMAGES = 3
"""Images in all of which a faint contact is dark."""
_MIN_NOISE = 2e-4
"""Smallest noise (standard deviation of the relative brightness) that is assumed for one cell."""
MAX_NOISE, MAX_NOISE_PER_PIXEL_NOISE = 5e-3, 25.0
"""Relative brightness noise of one cell that is not doubted, and its largest ratio to that of independent pixels (6 to 12 in images
of real sensors, whose cameras sharpen and compress). What exceeds both is structure, such as pins all over the view."""
NOISE_EVERY_ROWS = 48
NOISE_SMOOTHING_CELLS = 0.85
"""Standard deviation of the Gaussian that gives the surroundings of a cell; over 3 x 3 cells its weights are about 1 2 1."""
SMOOTHING_RESIDUE = 0.8
"""Standard deviation that white noise of one keeps when its mean over 3 x 3 cells, weighted 1 2 1, is subtracted."""
_TILES = 3, 4
"""Tiles in which the noise of a stream is measured."""
_MAX_SMOOTH_NOISE = 1.0
"""Largest noise of a tile after smoothing over that of one cell. It is at most 0.6 for JPEG of quality 40 and better; wide objects
have 4 to 25."""
_DIGITAL_GAIN, _GAIN_ROUNDING_LEVELS = 0.002, 1.0
"""Change of the light beyond which it may be a gain of whole grey levels in a camera or program, and the largest error that it
leaves: half a level in the median of the view and half a level elsewhere."""
INTERPOLATED = 1.5
"""Noise of a raw pixel over that of a rectified one, which bilinear interpolation reduces to two thirds on average."""
FAINT_PRESSURE = 0.05
"""Fraction of the maximum pressure below which pressure at the border of the view is no sign of contact beyond it."""
_RIM = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
"""Kernel that extends a region by one cell, because skin at the rim of a contact may stand higher than the undeformed plane."""


def detect_contact(reading: Reading, threshold: ContactThreshold = ContactThreshold()) -> bool:
    """Return whether the skin is darker somewhere than noise would make it."""
    darkening, limit = measure_darkening_and_limit(reading, threshold)
    return bool(darkening > limit) or find_faint_contact(reading, threshold) is not None


def find_faint_contact(reading: Reading, threshold: ContactThreshold = ContactThreshold()) -> View | None:
    """Return one on cells that stay darker, over this image and the last two, than the noise of the stream makes them there.

    None where there are none. Noise that is new in every image, as that of motion JPEG, does not stay.
    """
    noise, before = reading.stream.cell_noise, reading.stream.last_darkenings
    if (
        noise is None
        or not noise.is_known
        or not reading.stream.knows_light(reading.light.gain)
        or len(before) < FAINT_IMAGES - 1
    ):
        return None
    darkening = np.minimum.reduce([*before, measure_darkening_on_cells(reading)])
    faint = darkening > np.maximum(threshold.faint_stds * noise.std, np.float32(threshold.min_darkening))
    return faint.astype(np.float32) if faint.any() else None


def measure_darkening_on_cells(reading: Reading) -> View:
    """Return by how much every cell is darker than the median of the view, smoothed over half a millimetre."""
    signal = reading.brightness_on_cells
    return _smoothed_darkening(signal, np.ones_like(signal), _FAINT_SMOOTHING_CELLS)


def measure_darkening_and_limit(
    reading: Reading, threshold: ContactThreshold = ContactThreshold()
) -> tuple[float, float]:
    """Return the largest relative darkening, smoothed over about a millimetre, and the limit above which it is a contact."""
    signal = reading.brightness_on_cells
    noise = max(estimate_cell_noise(signal), _MIN_NOISE)
    noise = min(noise, cell_noise_upper_bound(reading.rectified.grey, reading.reference.grey, signal.size))
    in_view = np.ones_like(signal)
    darkening = _smoothed_darkening(signal, in_view, SMOOTHING_CELLS)
    limit = _noise_limit(noise, threshold.noise_stds, threshold.min_darkening, SMOOTHING_CELLS)
    limit = max(float(limit), correlated_noise_limit(reading, threshold))
    return float(_without_light_at_border(darkening, in_view, limit, threshold).max()), limit


def correlated_noise_limit(reading: Reading, threshold: ContactThreshold) -> float:
    """Return the darkening that noise of neighbouring pixels alike may make: of compression, of rounding, of unsteady light.

    The noise of a camera rounds grey levels up and down at random, so that their mean over a millimetre is right. The error that
    is left falls with the variance of the noise (Widrow and Kollár 2008, docs/references.md). Noise that is alike over two cells,
    as that of blocks of compression, is estimated from them.
    """
    stream = reading.stream
    level = max(float(reading.reference.grey[::NOISE_EVERY_ROWS].mean()), 1.0)
    has_gain = abs(reading.light.level - 1) > _DIGITAL_GAIN or reading.light.bands is not None
    rounding_of_gain = _GAIN_ROUNDING_LEVELS / level if has_gain else 0.0
    learnt = threshold.reference_noises * stream.noise
    if stream.darkening > 0:
        least, most = (noises * stream.noise for noises in threshold.least_and_most_noises)
        learnt = float(np.clip(threshold.learnt_darkenings * stream.darkening, least, max(most, rounding_of_gain)))
    if stream.learnt_s >= threshold.learnt_after_s and stream.knows_light(reading.light.gain):
        return learnt
    noise_levels = INTERPOLATED * _estimate_pixel_noise(reading.rectified.grey, reading.reference.grey) * level
    rounding = float(np.exp(-2 * (np.pi * noise_levels) ** 2)) / level
    rounding = max(rounding, rounding_of_gain)
    signal = reading.brightness_on_cells
    rows, cols = signal.shape
    coarse = np.asarray(cv2.resize(signal, (cols // 2, rows // 2), interpolation=cv2.INTER_AREA))
    noise = min(2 * estimate_cell_noise(coarse), MAX_NOISE)
    return max(learnt, rounding, float(_noise_limit(noise, threshold.noise_stds, 0.0, SMOOTHING_CELLS)))


def measure_smooth_noise(reading: Reading) -> float:
    """Return the noise of an image without contact after smoothing, as its relative brightness.

    It is the median over tiles of the largest brightening: a contact that is too light to be detected darkens, and in few tiles.
    """
    brightening, _ = _largest_changes_of_tiles(reading)
    return max(float(np.median(brightening)), 0.0)


def measure_even_noise(reading: Reading) -> float:
    """Return the noise after smoothing of an image that may be pressed, as its relative brightness.

    Noise brightens and darkens every tile; bulges beside a contact only brighten, and a contact only darkens. Wide objects with
    their bulges do both in every tile, but without the differences between neighbouring cells that noise has.
    """
    even = max(float(np.median(np.minimum(*_largest_changes_of_tiles(reading)))), 0.0)
    return min(even, _MAX_SMOOTH_NOISE * estimate_cell_noise(reading.brightness_on_cells))


def _largest_changes_of_tiles(reading: Reading) -> tuple[Float[Array, "down across"], Float[Array, "down across"]]:
    """Return the largest brightening and the largest darkening of every tile."""
    signal = reading.brightness_on_cells
    darkening = _smoothed_darkening(signal, np.ones_like(signal), SMOOTHING_CELLS)
    rows, cols = darkening.shape
    down, across = _TILES
    tiles = darkening[: rows // down * down, : cols // across * across]
    tiles = tiles.reshape(down, rows // down, across, cols // across)
    return -tiles.min(axis=(1, 3)), tiles.max(axis=(1, 3))


def find_contact_region(
    change: View,
    z_mm: View,
    in_view: View,
    noise: float,
    margin: int,
    settings: ContactRegionSettings,
    least_limit: float = 0.0,
    faint: View | None = None,
) -> View | None:
    """Return one where pressure may act and zero elsewhere, or None where nothing touches.

    The region consists of the connected parts of indented skin that are deep enough to be more than noise, the cells that are
    much darker than the noise, and the rim of both. change: the observed signal on the cells, negative where darker, with this
    noise. margin: number of cells around the image. least_limit: darkening that is no contact whatever this noise
    (`correlated_noise_limit`). faint: cells of the detection on which a contact is fainter than that (`find_faint_contact`).
    """
    darkening = _smoothed_darkening(change, in_view, settings.smoothing_cells)
    threshold = settings.threshold
    limit = _noise_limit(noise, threshold.noise_stds, threshold.min_darkening, settings.smoothing_cells)
    limit = max(limit, least_limit)
    darkening = _without_light_at_border(darkening, in_view, limit, threshold)
    if darkening.max() <= limit:
        if faint is None:
            return None
        darkening, limit = darkening * _around(faint, darkening.shape, margin), 0.0
    pressed, deep = _pressed_and_deep(change, z_mm, in_view, margin, settings)
    dark = darkening > max(limit, settings.dark_fraction * float(darkening.max()))
    return np.asarray(cv2.dilate((connected_parts_with(pressed, deep, neighbours=4) | dark).astype(np.float32), _RIM))


def _pressed_and_deep(
    change: View, z_mm: View, in_view: View, margin: int, settings: ContactRegionSettings
) -> tuple[Bool[Array, "rows cols"], Bool[Array, "rows cols"]]:
    """Return the cells on indented skin, and the cells that are deep enough to be more than noise."""
    max_depth_mm = max(-float(z_mm[margin:-margin, margin:-margin].min()), 0.0)
    is_thinner = change < settings.thin_fraction * float(change.min())
    deep = (z_mm < -max(settings.deep_mm, settings.deep_fraction * max_depth_mm)) & is_thinner
    level_mm = float(np.clip(np.median(z_mm[in_view > 0]), -settings.level_fraction * max_depth_mm, 0))
    pressed = z_mm < level_mm - max(settings.shallow_mm, settings.shallow_fraction * max_depth_mm)
    return pressed & (change <= settings.bright_fraction * max(float(change.max()), 0.0)), deep


def _without_light_at_border(darkening: View, in_view: View, limit: float, threshold: ContactThreshold) -> View:
    """Return the darkening, zero in those parts above the limit that are darkest at the border of the view and not dark enough."""
    if darkening.max() <= limit:
        return darkening
    border = (in_view > 0) & (cv2.erode(np.pad(in_view, 2), np.ones((5, 5), np.uint8))[2:-2, 2:-2] == 0)
    count, parts = cv2.connectedComponents((darkening > limit).astype(np.uint8))
    for number in range(1, count):
        part = np.where(parts == number, darkening, 0)
        if part.max() < threshold.border_darkening and border.flat[part.argmax()]:
            darkening = np.where(part > 0, np.float32(0), darkening)
    return darkening


def _around(faint: View, shape: tuple[int, ...], margin: int) -> View:
    """Return one on the cells of the inversion on or beside those of a faint contact."""
    rows, cols = (side - 2 * margin for side in shape)
    seen = cv2.dilate(cv2.resize(faint, (cols, rows)), _RIM)
    return np.asarray(np.pad(seen > 0, margin), np.float32)


def pressure_reaches_unseen(pressure: View, in_view: View) -> bool:
    """Return whether appreciable pressure acts on cells that are not seen, or beside them."""
    unseen = cv2.dilate(1 - in_view, _RIM)
    return bool(((pressure > FAINT_PRESSURE * pressure.max()) & (unseen > 0)).any())


def estimate_cell_noise(field: Float[Array, "rows cols"]) -> float:
    """Return the noise (standard deviation) of one cell.

    It is the median deviation of a cell from its smoothed surroundings, which contacts hardly change: they are small, or smooth.
    """
    smooth = cv2.GaussianBlur(field, (3, 3), NOISE_SMOOTHING_CELLS)
    return float(robust_std(field - smooth)) / SMOOTHING_RESIDUE


def cell_noise_upper_bound(
    image: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"], cells: int
) -> float:
    """Return an upper bound on the noise of a cell, from the image's pixel noise, as relative brightness.

    cells: their number in the view. The noise of its pixels is estimated from second differences, to which structure over many
    pixels contributes little.
    """
    pixel_noise = _estimate_pixel_noise(image, reference)
    return max(MAX_NOISE, MAX_NOISE_PER_PIXEL_NOISE * pixel_noise * float(np.sqrt(cells / image.size)))


def _estimate_pixel_noise(image: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"]) -> float:
    """Return the standard deviation of a pixel's relative brightness."""
    rows = np.s_[::NOISE_EVERY_ROWS]
    brightness = image[rows] / np.maximum(reference[rows], np.float32(1))
    return noise_by_second_differences(brightness, axis=1)


def _smoothed_darkening(signal: View, in_view: View, smoothing_cells: float) -> View:
    """Return by how much every cell is darker than the median of the view, smoothed."""
    level = np.median(signal[in_view > 0])
    return np.asarray(cv2.GaussianBlur((level - signal) * in_view, (0, 0), smoothing_cells))


def _noise_limit(noise: float, noise_stds: float, minimum: float, smoothing_cells: float) -> float:
    """Return the largest smoothed darkening that is no contact."""
    return max(noise_stds * smoothed_noise(noise, smoothing_cells), minimum)


def smoothed_noise(noise: Any, smoothing_cells: float) -> Any:
    """Return the standard deviation that white noise keeps after smoothing, for one image or an array of images.

    smoothing_cells: standard deviation of the Gaussian.
    """
    return noise / (2 * np.sqrt(np.pi) * smoothing_cells)

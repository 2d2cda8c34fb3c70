"""Contact detection: whether anything touches the skin, and where. Without contact the force is exactly zero.

Something touches where the image, compared with the reference image and smoothed over about a millimetre, is darker than its own
noise could make it anywhere. The noise is estimated from the image itself, so that the rule needs no setting for a sensor that it
has not seen, and a lamp that is brighter or dimmer than it was is not a contact. **To change the contact threshold, change
`ContactThreshold`.**

`detect_contact` returns whether anything touches, from a reading alone. `find_contact_region` returns where, on the cells of the
traction inversion.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.reading import Reading

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
    dark_fraction: float = 0.5
    """Fraction of the maximum darkening. Cells that are darker than this are in contact, whatever height the depth reader gives."""


_CELL_MM = 0.53
_SMOOTHING_CELLS = 2.0
_MIN_NOISE = 2e-4
"""Smallest noise (standard deviation of the relative brightness) that is assumed for one cell."""
_MAX_NOISE, _MAX_NOISE_PER_PIXEL_NOISE = 5e-3, 25.0
"""Relative brightness noise of one cell that is not doubted, and its largest ratio to that of independent pixels (6 to 12 in images
of real sensors, whose cameras sharpen and compress). What exceeds both is structure, such as pins all over the view."""
_NOISE_EVERY_ROWS = 48
_SMOOTHING_RESIDUE = 0.8
"""Standard deviation that white noise of one keeps when its mean over 3 x 3 cells, weighted 1 2 1, is subtracted."""
_STD_PER_MEDIAN = 1.4826
"""Standard deviation of Gaussian noise over the median of its magnitude."""
_FAINT_PRESSURE = 0.05
"""Fraction of the maximum pressure below which pressure at the border of the view is no sign of contact beyond it."""
_RIM = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
"""Kernel that extends a region by one cell, because skin at the rim of a contact may stand higher than the undeformed plane."""


def detect_contact(reading: Reading, threshold: ContactThreshold = ContactThreshold()) -> bool:
    """Return whether the skin is darker somewhere than noise would make it."""
    darkening, limit = measure_darkening_and_limit(reading, threshold)
    return bool(darkening > limit)


def measure_darkening_and_limit(
    reading: Reading, threshold: ContactThreshold = ContactThreshold()
) -> tuple[float, float]:
    """Return the largest relative darkening, smoothed over about a millimetre, and the limit above which it is a contact."""
    image, reference = (
        _average_over_cells(rectified.grey, reading.rectified.mm_per_px)
        for rectified in (reading.rectified, reading.reference)
    )
    signal = image / np.maximum(reference, np.float32(1))
    noise = max(estimate_cell_noise(signal), _MIN_NOISE)
    noise = min(noise, cell_noise_upper_bound(reading.rectified.grey, reading.reference.grey, signal.size))
    darkening = _smoothed_darkening(signal, np.ones_like(signal), _SMOOTHING_CELLS)
    return float(darkening.max()), float(
        _noise_limit(noise, threshold.noise_stds, threshold.min_darkening, _SMOOTHING_CELLS)
    )


def find_contact_region(
    change: View, z_mm: View, in_view: View, noise: float, margin: int, settings: ContactRegionSettings
) -> View | None:
    """Return one where pressure may act and zero elsewhere, or None where nothing touches.

    The region consists of the connected parts of indented skin that are deep enough to be more than noise, the cells that are
    much darker than the noise, and the rim of both. change: the observed signal on the cells, negative where darker, with this
    noise. margin: number of cells around the image.
    """
    darkening = _smoothed_darkening(change, in_view, settings.smoothing_cells)
    threshold = settings.threshold
    limit = _noise_limit(noise, threshold.noise_stds, threshold.min_darkening, settings.smoothing_cells)
    if darkening.max() <= limit:
        return None
    max_depth_mm = max(-float(z_mm[margin:-margin, margin:-margin].min()), 0.0)
    pressed = z_mm < -max(settings.shallow_mm, settings.shallow_fraction * max_depth_mm)
    deep = z_mm < -max(settings.deep_mm, settings.deep_fraction * max_depth_mm)
    dark = darkening > max(limit, settings.dark_fraction * float(darkening.max()))
    return np.asarray(cv2.dilate((_connected_parts_with(pressed, deep) | dark).astype(np.float32), _RIM))


def pressure_reaches_unseen(pressure: View, in_view: View) -> bool:
    """Return whether appreciable pressure acts on cells that are not seen, or beside them."""
    unseen = cv2.dilate(1 - in_view, _RIM)
    return bool(((pressure > _FAINT_PRESSURE * pressure.max()) & (unseen > 0)).any())


def estimate_cell_noise(field: Float[Array, "rows cols"]) -> float:
    """Return the noise (standard deviation) of one cell.

    It is the median deviation of a cell from its smoothed surroundings, which contacts hardly change: they are small, or smooth.
    """
    smooth = cv2.GaussianBlur(field, (3, 3), 0.85)
    return float(np.median(np.abs(field - smooth))) * _STD_PER_MEDIAN / _SMOOTHING_RESIDUE


def cell_noise_upper_bound(
    image: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"], cells: int
) -> float:
    """Return an upper bound on the noise of a cell, from the image's pixel noise, as relative brightness.

    cells: their number in the view. The noise of its pixels is estimated from second differences, to which structure over many
    pixels contributes little.
    """
    rows = np.s_[::_NOISE_EVERY_ROWS]
    brightness = image[rows] / np.maximum(reference[rows], np.float32(1))
    pixel_noise = float(np.median(np.abs(np.diff(brightness, n=2, axis=1)))) * _STD_PER_MEDIAN / np.sqrt(6)
    return max(_MAX_NOISE, _MAX_NOISE_PER_PIXEL_NOISE * pixel_noise * float(np.sqrt(cells / image.size)))


def _smoothed_darkening(signal: View, in_view: View, smoothing_cells: float) -> View:
    """Return by how much every cell is darker than the median of the view, smoothed."""
    level = np.median(signal[in_view > 0])
    return np.asarray(cv2.GaussianBlur((level - signal) * in_view, (0, 0), smoothing_cells))


def _noise_limit(noise: float, noise_stds: float, minimum: float, smoothing_cells: float) -> float:
    """Return the largest smoothed darkening that is no contact; smoothing reduces white noise to 1/(2·√π·cells) of itself."""
    return max(noise_stds * noise / (2 * np.sqrt(np.pi) * smoothing_cells), minimum)


def _average_over_cells(field: View, mm_per_px: float) -> Float32[Array, "few_rows few_cols"]:
    """Return the means of a field over square cells of about half a millimetre."""
    rows, cols = (max(round(side * mm_per_px / _CELL_MM), 1) for side in field.shape)
    return np.asarray(cv2.resize(field, (cols, rows), interpolation=cv2.INTER_AREA))


def _connected_parts_with(
    region: Bool[Array, "rows cols"], marks: Bool[Array, "rows cols"]
) -> Bool[Array, "rows cols"]:
    """Return the connected parts of a region that hold a mark."""
    count, label = cv2.connectedComponents(region.astype(np.uint8), connectivity=4)
    is_marked = np.zeros(count, bool)
    is_marked[label[marks & region]] = True
    return is_marked[label]

"""Whether anything touches at all: without contact the force is zero, exactly.

Something touches where the image, held against untouched skin and smoothed over a millimetre, is darker than its own noise could
make it anywhere. The noise is the image's, so that the rule needs no setting for a sensor that it has not seen; a lamp
that is brighter or dimmer than it was is no touch. A reading without a reference is judged by its heights in the same way.
"""

from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.force.traction.observation import roughness
from ninedtact.reading import Reading

View = Float32[Array, "rows cols"]
Touching = Callable[[Reading], bool]
CELL_MM = 0.53
SMOOTHING_CELLS = 2.0
DEVIATIONS = 9.0
"""Of the smoothed noise; the worst of 1,200 untouched images of 120 twins came to 7.0. Of touches of 0.05 to 0.1 N it
overlooks a tenth, of stronger ones two in a hundred."""
LEAST = 1e-3
"""Relative darkening below which nothing counts: a reference is no better."""
LEAST_MM = 0.03
LEAST_NOISE, LEAST_NOISE_MM = 2e-4, 2e-3
"""Of one cell."""


def is_touched(reading: Reading) -> bool:
    """Some place of the skin is darker than noise would make it."""
    if reading.reference is None:
        heights = on_cells(reading.height.z_mm, reading.height.mm_per_px)
        return is_changed(heights, LEAST_NOISE_MM, LEAST_MM)
    image, reference = (
        on_cells(seen.grey, reading.rectified.mm_per_px) for seen in (reading.rectified, reading.reference)
    )
    return is_changed(image / np.maximum(reference, np.float32(1)), LEAST_NOISE, LEAST)


def is_changed(seen: View, least_noise: float, least: float) -> bool:
    """Somewhere, downwards from what most of it is."""
    noise = max(roughness(seen), least_noise)
    return bool(below_level(seen).max() > max(DEVIATIONS * smoothed_noise(noise), least))


def below_level(seen: View) -> View:
    """By how much every place is below the median, smoothed."""
    return np.asarray(cv2.GaussianBlur(np.median(seen) - seen, (0, 0), SMOOTHING_CELLS))


def smoothed_noise(noise: float) -> float:
    """What smoothing leaves of white noise."""
    return float(noise / (2 * np.sqrt(np.pi) * SMOOTHING_CELLS))


def on_cells(field: View, mm_per_px: float) -> Float32[Array, "few_rows few_cols"]:
    """Means over cells of half a millimetre."""
    rows, cols = (max(round(side * mm_per_px / CELL_MM), 1) for side in field.shape)
    return np.asarray(cv2.resize(field, (cols, rows), interpolation=cv2.INTER_AREA))

"""A smooth gradient of the light over the view, as LEDs that age or warm up unequally and daylight at the side make it.

It is a polynomial in log brightness over skin where the ratio of image to reference is flat: linear in both directions, and of
second order where nearly all skin is flat. Beside a press it is linear, because displaced skin looks like a term of second order.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

Cells = Float32[Array, "few_rows few_cols"]
Grey = Float32[Array, "rows cols"]

_PARTS, _MIN_DIFFERENCE = 3, 0.006
"""Parts of the view along each side, and the difference between their medians below which no gradient is looked for."""
_EVERY_CELL = 2
_MIN_FLAT_SHARE, _MAY_BE_UNTOUCHED_SHARE, _MIN_UNTOUCHED_SHARE = 0.4, 0.7, 0.9
"""Shares of flat skin from which the linear gradient is known, from which that of second order is tried, and from which it is known
once it is taken out."""
_UNTOUCHED_LIMITS, _PRESSED_LIMITS = (0.005, 0.7), (0.012, 0.35)
"""Amplitude from which a gradient is taken out, and the median deviation of flat skin that it leaves at most, over that without it;
where nearly all skin is flat, and beside a press. Wide and deep presses at the side of the view make gradients of their own:
of 250 in steady light, 12 one of 0.005 to 0.017, which left 0.39 and more."""
_ROUNDS = 6
_LINEAR, _SECOND_ORDER = 3, 6


@dataclass(frozen=True)
class LightGradient:
    """A change of brightness over the view, exp(a·x + b·y + c·x² + d·x·y + e·y²) with x and y from −1 to 1; the
    geometric mean is one."""

    coefficients: tuple[float, ...]
    """a and b beside a press, all five where the skin is untouched."""

    def factor(self, shape: tuple[int, ...]) -> Grey:
        """Return the brightness of every pixel relative to the mean."""
        basis = _polynomials(*shape)[1 : len(self.coefficients) + 1]
        logarithm = np.tensordot(np.array(self.coefficients, np.float32), basis, axes=1)
        return np.asarray(np.exp(logarithm), np.float32)

    @property
    def amplitude(self) -> float:
        """Half of the difference between the brightest and the dimmest part of the view, relative to the brightness."""
        few = self.factor((9, 12))
        return float(few.max() - few.min()) / 2


def find_light_gradient(
    ratio: Cells, seen: Bool[Array, "few_rows few_cols"], flat_per_cell: float
) -> LightGradient | None:
    """Return the gradient of the ratio of an image to its reference image; None where there is none, or where it is not known.

    ratio: over its median. seen: cells in view. flat_per_cell: slope of the smoothed ratio below which skin counts as flat.
    """
    few, few_seen = ratio[::_EVERY_CELL, ::_EVERY_CELL], seen[::_EVERY_CELL, ::_EVERY_CELL]
    if min(few.shape) < _PARTS:
        return None
    medians = _medians_of_parts(few)
    if medians.max() - medians.min() < _MIN_DIFFERENCE:
        return None
    flat = find_flat_skin(ratio, seen, flat_per_cell)
    share = float(flat.sum() / seen.sum())
    if share > _MAY_BE_UNTOUCHED_SHARE:
        found = _fit_gradient(few, few_seen, _SECOND_ORDER, *_UNTOUCHED_LIMITS)
        if found is not None:
            even = find_flat_skin(ratio / found.factor(ratio.shape), seen, flat_per_cell)
            if even.sum() > _MIN_UNTOUCHED_SHARE * seen.sum():
                return found
    slopes = np.diff(medians.mean(axis=0)[::2]), np.diff(medians.mean(axis=1)[::2])
    if share < _MIN_FLAT_SHARE or np.hypot(*slopes) < _MIN_DIFFERENCE:
        return None
    return _fit_gradient(few, flat[::_EVERY_CELL, ::_EVERY_CELL], _LINEAR, *_PRESSED_LIMITS)


def _medians_of_parts(ratio: Cells) -> Float[Array, "3 3"]:
    """Return the medians of the parts of the view."""
    rows = np.array_split(ratio, _PARTS)
    return np.array([[np.median(part) for part in np.array_split(row, _PARTS, axis=1)] for row in rows])


def _fit_gradient(
    ratio: Cells, skin: Bool[Array, "few_rows few_cols"], terms: int, least: float, most_left: float
) -> LightGradient | None:
    """Fit a gradient to the ratio on this skin, outliers given less weight; None where its amplitude is less than `least`, where
    this skin does not determine it, or where it leaves more than `most_left` of the deviation."""
    basis = _polynomials(*ratio.shape)[:terms, skin]
    if np.linalg.matrix_rank(basis @ basis.T) < terms:
        return None
    logarithm = np.log(np.maximum(ratio[skin], np.float32(1e-3)))
    weight = np.ones_like(logarithm)
    for _ in range(_ROUNDS):
        weighted = basis * weight
        coefficients = np.linalg.solve(weighted @ basis.T, weighted @ logarithm)
        deviation = np.abs(logarithm - coefficients @ basis)
        left = np.median(deviation)
        weight = 1 / (1 + (deviation / (2 * left + np.float32(1e-6))) ** 2)
    found = LightGradient(tuple(coefficients[1:].tolist()))
    is_explained = left < most_left * np.median(np.abs(logarithm - np.median(logarithm)))
    return found if is_explained and found.amplitude > least else None


def find_flat_skin(
    ratio: Cells, seen: Bool[Array, "few_rows few_cols"], flat_per_cell: float
) -> Bool[Array, "few_rows few_cols"]:
    """Return the cells in view at which the smoothed ratio is as steep as it mostly is: skin that no object presses or displaces
    much."""
    down, across = (slope - np.median(slope) for slope in np.gradient(cv2.GaussianBlur(ratio, (0, 0), 1.5)))
    return np.asarray(seen & (np.hypot(down, across) < flat_per_cell))


@lru_cache(maxsize=8)
def _polynomials(rows: int, cols: int) -> Float[Array, "6 rows cols"]:
    """Return 1, x, y, x², x·y and y² over a grid, the last three without their mean."""
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : cols * 1j].astype(np.float32)
    return np.stack([np.ones_like(x), x, y, x**2 - (x**2).mean(), x * y, y**2 - (y**2).mean()])

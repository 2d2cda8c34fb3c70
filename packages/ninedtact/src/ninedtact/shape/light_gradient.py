"""A smooth gradient of the light over the view, as LEDs that age or warm up unequally and daylight at the side make it.

It is a polynomial in log brightness. Gel that an object displaces is back at its height a few millimetres away, so the polynomial
is fitted to the skin beyond and continued across the contact: of second order, or linear where that is not determined. Beside deep
and wide presses it is not known.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

Cells = Float32[Array, "few_rows few_cols"]
Grey = Float32[Array, "rows cols"]
CellMask = Bool[Array, "few_rows few_cols"]

_PARTS, _MIN_DIFFERENCE = 3, 0.006
"""Parts of the view along each side, and the difference between their medians below which no gradient is looked for."""
_EVERY_CELL = 2
_SMOOTHING_CELLS = 1.5
_FLAT_PER_MM = 0.004
"""Slope of the smoothed ratio below which skin counts as flat."""
_REACH_MM = 5.0
"""Distance from skin that is not flat beyond which no skin is displaced. Flat bulges reach farther over thick gels: with 3 mm they
were taken for light, and shear on gels of 2.6 and 3.2 mm lost a fifth and two fifths of its skill."""
_LINEAR, _SECOND_ORDER = 3, 6
_PRESSED = {_SECOND_ORDER: (_REACH_MM, 0.15, 0.01), _LINEAR: (0.0, 0.4, 0.012)}
"""By the number of terms, beside a press: the reach, the share of undisplaced skin from which a gradient is known, and the
amplitude from which it is taken out. Displaced skin hardly looks linear, so that all flat skin serves."""
_UNTOUCHED_SHARE, _LEAST_AMPLITUDE_UNTOUCHED = 0.9, 0.005
"""Share of undisplaced skin from which nothing large touches, and the amplitude from which a gradient is taken out then."""
_MOST_LEFT_UNTOUCHED, _MOST_LEFT = 0.7, {_SECOND_ORDER: 0.5, _LINEAR: 0.35}
"""Spread of undisplaced skin that it leaves at most, over that without it; for the numbers of terms beside a press."""
_LEAST_SEEN = 0.25
"""Spread of undisplaced skin over the amplitude of the gradient fitted to it. It is at least 0.4 in uneven light; skin that shows
less of a gradient is displaced a little, and the gradient lies where nothing was fitted."""
_MOST, _SIMPLER = 0.8, 1.5
"""Share of skin whose spread is compared; and the spread that a simpler change of the light, linear or a gamma, may leave over that
of a gradient, to be taken in its place."""
_LEAST_EIGENVALUE = 1e-2
_ALIKE, _LEAST_ERROR = 10.0, 0.002
"""Standard error over that of independent cells, because what is left is alike over neighbouring cells; and what light that is no
polynomial, and gel that is displaced far away, add to it: 460 presses with gradients of ±2 and ±5 %."""
_SEARCHES, _ROUNDS = 3, 4


@dataclass(frozen=True)
class LightGradient:
    """A change of brightness over the view, exp(a·x + b·y + c·x² + d·x·y + e·y²) with x and y from −1 to 1; the
    geometric mean is one."""

    coefficients: tuple[float, ...]
    """a and b, or all five."""
    level: float = 1.0
    """Geometric mean over the view of the brightness of undisplaced skin, relative to what it was fitted to."""
    error: float = 0.0
    """Largest standard error over the view, relative to the brightness."""

    def factor(self, shape: tuple[int, ...]) -> Grey:
        """Return the brightness of every pixel relative to the mean."""
        return np.asarray(np.exp(self.logarithm(shape)), np.float32)

    def logarithm(self, shape: tuple[int, ...]) -> Grey:
        """Return its logarithm."""
        basis = _polynomials(*shape)[1 : len(self.coefficients) + 1]
        return np.tensordot(np.array(self.coefficients, np.float32), basis, axes=1)

    @property
    def amplitude(self) -> float:
        """Half of the difference between the brightest and the dimmest part of the view, relative to the brightness."""
        few = self.factor((9, 12))
        return float(few.max() - few.min()) / 2


def find_light_gradient(ratio: Cells, reference: Cells, seen: CellMask, cell_mm: float) -> LightGradient | None:
    """Return the gradient of the ratio of an image to its reference image; None where there is none, or where it is not known.

    ratio: over its median. reference: brightness of the reference image. seen: cells in view. cell_mm: side of a cell. None also
    where a gamma explains the change nearly as well: it follows the brightness, which falls towards the border of the view.
    """
    few = (slice(None, None, _EVERY_CELL),) * 2
    if min(ratio[few].shape) < _PARTS:
        return None
    medians = _medians_of_parts(ratio[few])
    if medians.max() - medians.min() < _MIN_DIFFERENCE:
        return None
    logarithm = np.log(np.maximum(cv2.GaussianBlur(ratio, (0, 0), _SMOOTHING_CELLS)[few], np.float32(1e-3)))
    found, skin = _find_known_gradient(logarithm, seen[few], _EVERY_CELL * cell_mm)
    if found is None:
        return None
    left = _SIMPLER * _spread(logarithm - found.logarithm(skin.shape), skin)
    if _spread_without_gamma(logarithm, np.log(np.maximum(reference[few], 1)), skin) < left:
        return None
    linear = _fit_gradient(logarithm, skin, _LINEAR)
    is_linear = linear is not None and _spread(logarithm - linear.logarithm(skin.shape), skin) < left
    return linear if is_linear else found


def _find_known_gradient(logarithm: Cells, seen: CellMask, cell_mm: float) -> tuple[LightGradient | None, CellMask]:
    """Return the gradient of the highest order that undisplaced skin determines, if it explains this skin, and the skin."""
    for terms, most_left in _MOST_LEFT.items():
        reach_mm, least_share, least = _PRESSED[terms]
        found, skin = _search_gradient(logarithm, seen, cell_mm, terms, reach_mm)
        share = skin.sum() / seen.sum()
        if share > _UNTOUCHED_SHARE:
            least, most_left = _LEAST_AMPLITUDE_UNTOUCHED, _MOST_LEFT_UNTOUCHED
        if found is None or share < least_share or found.amplitude < max(least, 1.5 * found.error):
            continue
        spread = _spread(logarithm, skin)
        is_seen = spread > _LEAST_SEEN * found.amplitude
        if is_seen and _spread(logarithm - found.logarithm(skin.shape), skin) < most_left * spread:
            return found, skin
    return None, seen


def _medians_of_parts(ratio: Cells) -> Float[Array, "3 3"]:
    """Return the medians of the parts of the view."""
    rows = np.array_split(ratio, _PARTS)
    return np.array([[np.median(part) for part in np.array_split(row, _PARTS, axis=1)] for row in rows])


def _spread(logarithm: Cells, skin: CellMask) -> float:
    """Return how far most of this skin is from its median, at most."""
    deviation = np.abs(logarithm[skin] - np.median(logarithm[skin]))
    return float(np.quantile(deviation, _MOST))


def _spread_without_gamma(logarithm: Cells, structure: Cells, skin: CellMask) -> float:
    """Return the spread of this skin without what is proportional to the logarithm of its brightness."""
    centred = structure - structure[skin].mean()
    slope = np.vdot(centred[skin], logarithm[skin]) / max(float(np.vdot(centred[skin], centred[skin])), 1e-9)
    return _spread(logarithm - np.float32(slope) * centred, skin)


def _search_gradient(
    logarithm: Cells, seen: CellMask, cell_mm: float, terms: int, reach_mm: float
) -> tuple[LightGradient | None, CellMask]:
    """Return the gradient of undisplaced skin, and this skin, each found with the other in turn."""
    found, flat_per_cell = None, _FLAT_PER_MM * cell_mm
    slopes = _slopes(logarithm)
    limit = 2 * max(flat_per_cell, float(np.median(slopes)))
    for _ in range(_SEARCHES):
        skin = _undisplaced_skin(slopes < limit, seen, cell_mm, reach_mm)
        found = _fit_gradient(logarithm, skin, terms)
        if found is None or found.amplitude < _LEAST_AMPLITUDE_UNTOUCHED:
            break
        slopes, limit = _slopes(logarithm - found.logarithm(skin.shape)), flat_per_cell
    return found, skin


def _undisplaced_skin(flat: CellMask, seen: CellMask, cell_mm: float, reach_mm: float) -> CellMask:
    """Return the cells in view that are far from all that are not flat."""
    reach = 2 * round(reach_mm / cell_mm) + 1
    near = cv2.dilate((~flat).view(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    return np.asarray(seen & (near == 0))


def _fit_gradient(logarithm: Cells, skin: CellMask, terms: int) -> LightGradient | None:
    """Fit a gradient to this skin, outliers given less weight; None where this skin does not determine it."""
    everywhere, values = _polynomials(*logarithm.shape)[:terms], logarithm[skin]
    basis = everywhere[:, skin]
    if np.linalg.eigvalsh(basis @ basis.T)[0] < _LEAST_EIGENVALUE:
        return None
    weighted = basis
    for _ in range(_ROUNDS):
        coefficients = np.linalg.solve(weighted @ basis.T, weighted @ values)
        deviation = np.abs(values - coefficients @ basis)
        left = np.median(deviation)
        weighted = basis / (1 + (deviation / (2 * left + np.float32(1e-6))) ** 2)
    root = np.linalg.cholesky(np.linalg.inv((weighted @ basis.T).astype(float)))
    leverage = np.square(root.T @ everywhere.reshape(terms, -1)).sum(axis=0).max()
    return LightGradient(
        tuple(coefficients[1:].tolist()),
        float(np.exp(coefficients[0])),
        float(np.hypot(_LEAST_ERROR, _ALIKE * left * np.sqrt(leverage))),
    )


def find_flat_skin(ratio: Cells, seen: CellMask, cell_mm: float) -> CellMask:
    """Return the cells in view at which the smoothed ratio is as steep as it mostly is: skin that no object presses or displaces
    much."""
    return np.asarray(seen & (_slopes(cv2.GaussianBlur(ratio, (0, 0), _SMOOTHING_CELLS)) < _FLAT_PER_MM * cell_mm))


def _slopes(field: Cells) -> Cells:
    """Return how much steeper a field is than it mostly is, per cell."""
    down, across = (slope - np.median(slope) for slope in np.gradient(field))
    return np.asarray(np.hypot(down, across))


@lru_cache(maxsize=8)
def _polynomials(rows: int, cols: int) -> Float32[Array, "6 rows cols"]:
    """Return 1, x, y, x², x·y and y² over a grid, the last three without their mean."""
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : cols * 1j].astype(np.float32)
    return np.stack([np.ones_like(x), x, y, x**2 - (x**2).mean(), x * y, y**2 - (y**2).mean()])

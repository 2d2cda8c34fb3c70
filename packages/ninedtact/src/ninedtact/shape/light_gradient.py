"""A smooth gradient of the light over the view, as LEDs that age or warm up unequally and daylight at the side make it.

It is a polynomial in log brightness. Gel that an object displaces is back at its height a few millimetres away, so the polynomial
is fitted to the skin beyond and continued across the contact. It is of second order, or linear where that is not determined. Beside
deep and wide presses it is not known. A *share* is relative to the cells in view; a *spread* is how far most skin is from its
median (`_spread`).
"""

from dataclasses import dataclass, replace
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
"""Of every so many cells along each side one is used, which saves time."""
_SMOOTHING_CELLS = 1.5
_FLAT_PER_MM = 0.004
"""Slope of the smoothed ratio below which skin counts as flat."""
_REACH_MM = 5.0
"""Distance from skin that is not flat beyond which no skin is displaced. Flat bulges reach farther over thick gels: with 3 mm they
were taken for light, and shear on gels of 2.6 and 3.2 mm lost a fifth and two fifths of its skill."""
_UNTOUCHED_SHARE = 0.9
"""Share of undisplaced skin from which no large object touches."""
_MIN_AMPLITUDE_UNTOUCHED, _MAX_REMAINDER_UNTOUCHED = 0.005, 0.7
"""`min_amplitude` and `max_remainder` (`_Order`) where no large object touches."""
_MIN_SPREAD_PER_AMPLITUDE = 0.25
"""Smallest spread of undisplaced skin over the amplitude of the gradient fitted to it. In uneven light it is at least 0.4. Skin
that shows less of a gradient is displaced a little, and the gradient lies where nothing was fitted."""
_MIN_AMPLITUDE_PER_ERROR = 1.5
"""Smallest amplitude of a gradient over its error."""
_COMPARED_SHARE = 0.8
"""Share of skin that is within the spread of its median."""
_SIMPLER_REMAINDER = 1.5
"""Largest spread that a simpler change of the light, linear or a gamma, leaves over that of a gradient, to be preferred to it."""
_MIN_EIGENVALUE = 1e-2
"""Smallest eigenvalue of the normal matrix of polynomials from which skin determines a gradient."""
_CORRELATION, _MIN_ERROR = 10.0, 0.002
"""Standard error over that of independent cells, because residuals of neighbouring cells are correlated; and the error added for
light that is no polynomial and gel that is displaced far away. Found on 460 presses with gradients of ±2 and ±5 %."""
_SEARCHES, _ROUNDS = 3, 4
"""Largest number of alternations between undisplaced skin and its gradient, and number of reweighted fits of each gradient."""


@dataclass(frozen=True)
class _Order:
    """A polynomial, and the conditions under which it is taken out beside a press."""

    terms: int
    """Number of terms of the polynomial, the constant included."""
    reach_mm: float
    """Distance from skin that is not flat up to which no skin is used."""
    min_share: float
    """Smallest share of undisplaced skin."""
    min_amplitude: float
    max_remainder: float
    """Largest spread of undisplaced skin after the gradient is taken out, over that before."""


_LINEAR = _Order(3, 0.0, 0.4, 0.012, 0.35)
"""Displaced skin hardly looks linear, so that all flat skin is used."""
_SECOND_ORDER = _Order(6, _REACH_MM, 0.15, 0.01, 0.5)


@dataclass(frozen=True)
class LightGradient:
    """A change of brightness over the view, exp(a·x + b·y + c·x² + d·x·y + e·y²) with x and y from −1 to 1; the
    geometric mean is one."""

    coefficients: tuple[float, ...]
    """a and b, or all five."""
    level: float = 1.0
    """Geometric mean over the view of the ratio that was fitted, if all skin were undisplaced."""
    error: float = 0.0
    """Largest standard error over the view, relative to the brightness."""

    def factor(self, shape: tuple[int, ...]) -> Grey:
        """Return the brightness of every pixel relative to the mean."""
        return np.asarray(np.exp(self.logarithm(shape)), np.float32)

    def logarithm(self, shape: tuple[int, ...]) -> Grey:
        """Return the logarithm of `factor`."""
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
    if min(ratio[few].shape) < _PARTS or not seen[few].any():
        return None
    medians = _medians_of_parts(ratio[few])
    if medians.max() - medians.min() < _MIN_DIFFERENCE:
        return None
    logarithm = np.log(np.maximum(cv2.GaussianBlur(ratio, (0, 0), _SMOOTHING_CELLS)[few], np.float32(1e-3)))
    found, skin = _find_known_gradient(logarithm, seen[few], _EVERY_CELL * cell_mm)
    if found is None:
        return None
    limit = _SIMPLER_REMAINDER * _spread(logarithm - found.logarithm(skin.shape), skin)
    if _spread_without_gamma(logarithm, np.log(np.maximum(reference[few], 1)), skin) < limit:
        return None
    linear = _fit_gradient(logarithm, skin, _LINEAR.terms)
    is_linear = linear is not None and _spread(logarithm - linear.logarithm(skin.shape), skin) < limit
    return linear if is_linear else found


def _find_known_gradient(logarithm: Cells, seen: CellMask, cell_mm: float) -> tuple[LightGradient | None, CellMask]:
    """Return the gradient of the highest order that undisplaced skin determines, and this skin; None if it explains no skin."""
    slopes = _slopes(logarithm)
    for order in (_SECOND_ORDER, _LINEAR):
        found, skin = _search_gradient(logarithm, slopes, seen, cell_mm, order)
        share = skin.sum() / seen.sum()
        if share > _UNTOUCHED_SHARE:
            order = replace(order, min_amplitude=_MIN_AMPLITUDE_UNTOUCHED, max_remainder=_MAX_REMAINDER_UNTOUCHED)
        if found is not None and share >= order.min_share and _explains(found, logarithm, skin, order):
            return found, skin
    return None, seen


def _explains(found: LightGradient, logarithm: Cells, skin: CellMask, order: _Order) -> bool:
    """Return whether a gradient is large enough to be known, and whether this skin shows it and is even without it."""
    if found.amplitude < max(order.min_amplitude, _MIN_AMPLITUDE_PER_ERROR * found.error):
        return False
    spread = _spread(logarithm, skin)
    remainder = _spread(logarithm - found.logarithm(skin.shape), skin)
    return spread > _MIN_SPREAD_PER_AMPLITUDE * found.amplitude and remainder < order.max_remainder * spread


def _medians_of_parts(ratio: Cells) -> Float[Array, "3 3"]:
    rows = np.array_split(ratio, _PARTS)
    return np.array([[np.median(part) for part in np.array_split(row, _PARTS, axis=1)] for row in rows])


def _spread(logarithm: Cells, skin: CellMask) -> float:
    """Return the distance from its median within which most of this skin is."""
    deviation = np.abs(logarithm[skin] - np.median(logarithm[skin]))
    return float(np.quantile(deviation, _COMPARED_SHARE))


def _spread_without_gamma(logarithm: Cells, structure: Cells, skin: CellMask) -> float:
    """Return the spread of this skin without what is proportional to the logarithm of its brightness."""
    centred = structure - structure[skin].mean()
    slope = np.vdot(centred[skin], logarithm[skin]) / max(float(np.vdot(centred[skin], centred[skin])), 1e-9)
    return _spread(logarithm - np.float32(slope) * centred, skin)


def _search_gradient(
    logarithm: Cells, slopes: Cells, seen: CellMask, cell_mm: float, order: _Order
) -> tuple[LightGradient | None, CellMask]:
    """Return the gradient of undisplaced skin, and this skin, found in alternation."""
    found, flat_per_cell = None, _FLAT_PER_MM * cell_mm
    limit = 2 * max(flat_per_cell, float(np.median(slopes)))
    for _ in range(_SEARCHES):
        skin = _undisplaced_skin(slopes < limit, seen, cell_mm, order.reach_mm)
        found = _fit_gradient(logarithm, skin, order.terms)
        if found is None or found.amplitude < _MIN_AMPLITUDE_UNTOUCHED:
            break
        slopes, limit = _slopes(logarithm - found.logarithm(skin.shape)), flat_per_cell
    return found, skin


def _undisplaced_skin(flat: CellMask, seen: CellMask, cell_mm: float, reach_mm: float) -> CellMask:
    """Return the cells in view that are farther than this from all cells that are not flat."""
    reach = 2 * round(reach_mm / cell_mm) + 1
    near = cv2.dilate((~flat).view(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    return np.asarray(seen & (near == 0))


def _fit_gradient(logarithm: Cells, skin: CellMask, terms: int) -> LightGradient | None:
    """Return the gradient fitted to this skin, with less weight on outliers; None where this skin does not determine it."""
    everywhere, values = _polynomials(*logarithm.shape)[:terms], logarithm[skin]
    weighted = basis = everywhere[:, skin]
    normal = basis @ basis.T
    for _ in range(_ROUNDS):
        if _is_singular(normal):
            return None
        coefficients = np.linalg.solve(normal, weighted @ values)
        deviation = np.abs(values - coefficients @ basis)
        typical = np.median(deviation)
        weighted = basis / (1 + (deviation / (2 * typical + np.float32(1e-6))) ** 2)
        normal = weighted @ basis.T
    if _is_singular(normal):
        return None
    root = np.linalg.cholesky(np.linalg.inv(normal.astype(float)))
    leverage = np.square(root.T @ everywhere.reshape(terms, -1)).sum(axis=0).max()
    return LightGradient(
        tuple(coefficients[1:].tolist()),
        float(np.exp(coefficients[0])),
        float(np.hypot(_MIN_ERROR, _CORRELATION * typical * np.sqrt(leverage))),
    )


def _is_singular(normal: Float32[Array, "terms terms"]) -> bool:
    return bool(np.linalg.eigvalsh(normal)[0] < _MIN_EIGENVALUE)


def find_flat_skin(ratio: Cells, seen: CellMask, cell_mm: float) -> CellMask:
    """Return the cells in view where the slope of the smoothed ratio is about its median: skin that no object displaces much."""
    return np.asarray(seen & (_slopes(cv2.GaussianBlur(ratio, (0, 0), _SMOOTHING_CELLS)) < _FLAT_PER_MM * cell_mm))


def _slopes(field: Cells) -> Cells:
    """Return the magnitude of the difference of a field's slope from its median slope, per cell."""
    down, across = (slope - np.median(slope) for slope in np.gradient(field))
    return np.asarray(np.hypot(down, across))


@lru_cache(maxsize=8)
def _polynomials(rows: int, cols: int) -> Float32[Array, "6 rows cols"]:
    """Return 1, x, y, x², x·y and y² over a grid, the last three without their mean."""
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : cols * 1j].astype(np.float32)
    return np.stack([np.ones_like(x), x, y, x**2 - (x**2).mean(), x * y, y**2 - (y**2).mean()])

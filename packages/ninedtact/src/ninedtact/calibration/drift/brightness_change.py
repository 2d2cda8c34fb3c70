"""The change of brightness between two rectified reference images of the skin, separated into light and local marks.

    brightness today / brightness then  =  gain · smooth field (light) · residue (marks on the skin, or a contact)

All changes are fractions of the brightness (0.01 is 1 %), as logarithms where they are small.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray as Array

from ninedtact.calibration.press_brightness import MIN_REFERENCE_GREY
from ninedtact.quantities import Rectified, centred_axis_mm

Field = Float32[Array, "rows cols"]

_SMOOTHING_MM = 0.15
"""Standard deviation of the smoothing; smaller marks do not pass the filters after the depth curve either."""
_FIELD_DEGREE = 4
"""Polynomial degree of the light's field: the failure of one of eight LEDs bends it, a mark of millimetres does not."""
_FIELD_STRIDE = 6
_ITERATIONS = 8
_TUKEY_CONSTANT = 4.685
_MIN_MARK_CHANGE = 0.012
"""Two grey levels. The skin of real sensors without contact differs by at most half of it between two sessions (contours of the
camera's shading correction move with the light), and by 0.001 from image to image.
"""
_MARK_NOISE_STDS = 5.0
_MIN_MARK_AREA_MM2 = 0.1
MAX_UNEVENNESS = 0.05
"""Change of the light across the view above which it is reported; real sensors have up to 0.021 between two sessions."""
_MIN_CONTACT_DARKENING = 0.025
_BULGE_REACH_MM = 2.0
_MIN_BULGE_SHARE = 0.1
"""Brightening beside a dark place, as a fraction of its darkening, from which the place counts as a contact. Pressed gel piles up
around a contact and brightens (real presses 0.2 to 0.6); beside a stain nothing brightens.
"""


@dataclass(frozen=True)
class ChangedSkinRegion:
    """A region of the skin whose brightness has changed, with the weighted centre of the change."""

    x_mm: float
    y_mm: float
    area_mm2: float
    change: float
    """Largest relative change of brightness in the place; negative is darker."""


@dataclass(frozen=True)
class BrightnessChange:
    """Today's brightness divided by that of the calibration, separated into gain, field and residue."""

    gain: float
    """Factor of the whole image, the median."""
    field: Field
    """Smooth relative change in addition to the gain."""
    residue: Field
    """Remaining change, smoothed; zero where the skin is not in view."""
    seen: Bool[Array, "rows cols"]
    noise: float
    """Standard deviation of the residue due to camera noise."""
    mm_per_px: float

    @property
    def unevenness(self) -> float:
        """Largest change of the light relative to its median."""
        return float(np.abs(self.field[self.seen]).max())

    @property
    def level(self) -> float:
        """Change of brightness above which neither noise nor the camera explains it."""
        return max(_MIN_MARK_CHANGE, _MARK_NOISE_STDS * self.noise)

    @property
    def mark_level(self) -> float:
        """Change above which a place is marked; it also allows for the steep borders that uneven light leaves."""
        return max(self.level, self.unevenness if self.unevenness > MAX_UNEVENNESS else 0.0)

    @cached_property
    def marks(self) -> tuple[ChangedSkinRegion, ...]:
        """All changed places, largest first."""
        found = [mark for sign in (-1, 1) for mark in self.marks_of(sign)]
        return tuple(sorted(found, key=lambda mark: -mark.area_mm2))

    def marks_of(self, sign: int) -> list[ChangedSkinRegion]:
        """Return the places with a change of one sign."""
        count, labels, boxes, _ = cv2.connectedComponentsWithStats(
            (sign * self.residue > self.mark_level).astype(np.uint8)
        )
        large = boxes[:, cv2.CC_STAT_AREA] * self.mm_per_px**2 >= _MIN_MARK_AREA_MM2
        return [self.mark(labels == label) for label in range(1, count) if large[label]]

    def mark(self, where: Bool[Array, "rows cols"]) -> ChangedSkinRegion:
        """Return the figures of one changed place."""
        rows, cols = np.nonzero(where)
        y, x = (centred_axis_mm(size, self.mm_per_px) for size in where.shape)
        values = self.residue[where]
        weight = np.abs(values) / np.abs(values).sum()
        return ChangedSkinRegion(
            float(x[cols] @ weight),
            float(y[rows] @ weight),
            float(where.sum()) * self.mm_per_px**2,
            float(values[np.abs(values).argmax()]),
        )

    @property
    def changed_area_mm2(self) -> float:
        """Return the area of all marks together."""
        return sum((mark.area_mm2 for mark in self.marks), 0.0)

    @cached_property
    def contact(self) -> ChangedSkinRegion | None:
        """Return all dark places as one mark where they look pressed: clearly darker, with brighter gel beside them."""
        dark = self.residue < -self.level
        if self.residue.min() > -_MIN_CONTACT_DARKENING:
            return None
        side = 2 * round(_BULGE_REACH_MM / self.mm_per_px) + 1
        beside = cv2.dilate(dark.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))) > 0
        bulge = beside & (self.residue > self.level / 2)
        if self.residue[bulge].sum() < -_MIN_BULGE_SHARE * self.residue[dark].sum():
            return None
        return self.mark(dark)

    @property
    def new_contacts(self) -> list[ChangedSkinRegion]:
        """Return the dark places that are pressed now and were not before.

        Where a contact was released instead, the released gel around it is darker too, but less than its middle is brighter.
        """
        reach_px = round(_BULGE_REACH_MM / self.mm_per_px)
        y, x = (centred_axis_mm(size, self.mm_per_px) for size in self.residue.shape)

        def brightening_beside(mark: ChangedSkinRegion) -> float:
            radius_px = reach_px + round(np.sqrt(mark.area_mm2 / np.pi) / self.mm_per_px)
            row, col = int(np.abs(y - mark.y_mm).argmin()), int(np.abs(x - mark.x_mm).argmin())
            rows, cols = (slice(max(at - radius_px, 0), at + radius_px + 1) for at in (row, col))
            return float(self.residue[rows, cols].max())

        return [mark for mark in self.marks_of(-1) if -mark.change > brightening_beside(mark)]

    @property
    def changed_share(self) -> float:
        """Fraction of the view whose change is neither light nor noise."""
        return float((np.abs(self.residue[self.seen]) > self.level).mean())


def separate_brightness_change(
    then: Rectified, today: Rectified, seen: Bool[Array, "rows cols"], noise: float
) -> BrightnessChange:
    """Separate the change into its parts; noise: standard deviation of one pixel, as a fraction of the brightness."""
    ratio = np.log(np.maximum(today.grey, MIN_REFERENCE_GREY) / np.maximum(then.grey, MIN_REFERENCE_GREY))
    sigma_px = _SMOOTHING_MM / then.mm_per_px
    smooth = np.asarray(cv2.GaussianBlur(ratio, (0, 0), sigma_px))
    field = _fit_polynomial_background(smooth, seen)
    middle = float(np.median(field[seen]))
    # A Gaussian filter reduces the standard deviation of white noise to the fraction 1/(2σ√π).
    left_of_noise = noise / (2 * sigma_px * np.sqrt(np.pi))
    return BrightnessChange(
        float(np.exp(middle)),
        np.expm1(field - middle),
        np.where(seen, np.expm1(smooth - field), np.float32(0)),
        seen,
        left_of_noise,
        then.mm_per_px,
    )


def _fit_polynomial_background(change: Field, seen: Bool[Array, "rows cols"]) -> Field:
    """Return a polynomial through the change of most of the skin; contacts and marks are excluded by Tukey's weights."""
    coarse = np.s_[::_FIELD_STRIDE, ::_FIELD_STRIDE]
    values, terms = change[coarse][seen[coarse]], _legendre_basis(change.shape)[coarse][seen[coarse]]
    weight = np.ones_like(values)
    for _ in range(_ITERATIONS):
        weighted = terms * weight[:, None]
        solution = np.linalg.solve(weighted.T @ weighted, weighted.T @ (values * weight))
        missed = values - terms @ solution
        scaled = missed / (_TUKEY_CONSTANT * max(float(np.median(np.abs(missed))) / 0.6745, 1e-6))
        weight = np.maximum(1 - scaled**2, 0)
    return (_legendre_basis(change.shape) @ solution).astype(np.float32)


@cache
def _legendre_basis(shape: tuple[int, int]) -> Float32[Array, "rows cols terms"]:
    """Return all products of Legendre polynomials of row and column up to the total degree."""
    y, x = (np.polynomial.legendre.legvander(np.linspace(-1, 1, size), _FIELD_DEGREE) for size in shape)
    degrees = range(_FIELD_DEGREE + 1)
    products = [y[:, None, i] * x[None, :, j] for i in degrees for j in degrees if i + j <= _FIELD_DEGREE]
    return np.stack(products, axis=-1).astype(np.float32)

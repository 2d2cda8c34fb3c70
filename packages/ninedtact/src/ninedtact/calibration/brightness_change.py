"""The change of brightness between two images of the skin, in a calibration and since one.

Of a press: the relative change in grey levels as under uniform light, the noise of a pixel, and the checks that refuse unusable
images. Of two rectified reference images: the change separated into light and local marks.

    brightness today / brightness then  =  gain · smooth field (light) · residue (marks on the skin, or a contact)

All changes of the second kind are fractions of the brightness (0.01 is 1 %), as logarithms where they are small.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray as Array

from ninedtact.errors import CalibrationError
from ninedtact.quantities import BgrImage, Rectified, centred_axis_mm
from ninedtact.robust_noise import noise_by_second_differences, robust_std
from ninedtact.shape.calibrated_shape import MIN_LIT_GREY_LEVEL
from ninedtact.shape.lens_and_rectification import to_grey_float
from ninedtact.shape.skin_identity import measure_skin_motion

MIN_REFERENCE_GREY = 8.0
"""Grey level of the reference image below which a relative change is mostly noise."""
OVEREXPOSED = 250
"""Grey level from which a pixel counts as overexposed."""
_MAX_OVEREXPOSED_SHARE = 0.2
_DIM_GREY = 100.0
"""Mean grey level below which the steps between grey levels look like structure of the skin; real sensors have 140 to 170."""


def flat_fielded_brightness_change(reference: BgrImage, press: BgrImage) -> Float32[Array, "rows cols"]:
    """Return (press − reference) / reference, times the mean grey level of the reference, as under uniform light."""
    before, after = to_grey_float(reference), to_grey_float(press)
    return (after - before) / np.maximum(before, MIN_REFERENCE_GREY) * before.mean()


def relative_brightness(after: Rectified, before: Rectified) -> Float32[Array, "rows cols"]:
    """Return the brightness of a rectified image relative to its reference image, whose black pixels count as one grey level."""
    return after.grey / np.maximum(before.grey, 1)


def estimate_pixel_noise(change: Float32[Array, "rows cols"]) -> float:
    """Return the standard deviation of one pixel's noise, from second differences, to which smooth image content does not
    contribute.
    """
    return max(noise_by_second_differences(change, axis=1), 0.1)


def estimate_camera_noise(change: Float32[Array, "rows cols"]) -> float:
    """Return the standard deviation of one pixel of one image, from the difference of two, which contains the noise of both."""
    return estimate_pixel_noise(change) / 2**0.5


def overexposed_share(image: BgrImage) -> float:
    """Return the share of pixels of which at least one channel is overexposed: it cannot brighten, though the grey level may."""
    return float((image.max(axis=2) >= OVEREXPOSED).mean())


def dim_warning(image: BgrImage) -> str | None:
    """Return that an image is too dim for the fine structure of its skin to be seen, or None."""
    grey = float(to_grey_float(image).mean())
    if grey >= _DIM_GREY:
        return None
    return f"dim: the mean grey level is {grey:.0f} of 255 (140 to 170 is good); raise the exposure or the light"


@dataclass(frozen=True)
class ExposureFault:
    """Why the exposure of an image makes it unusable."""

    kind: Literal["dark", "overexposed"]
    expected: str
    """What is expected of an image, in words."""
    sentence: str
    """What was found, and what to do."""


def find_exposure_fault(image: BgrImage) -> ExposureFault | None:
    """Return why an image is too dark or too bright to be measured, or None."""
    grey = to_grey_float(image)
    if grey.mean() < MIN_LIT_GREY_LEVEL:
        return ExposureFault(
            "dark",
            "a lit image",
            f"a mean grey level of {grey.mean():.0f} of 255; switch the sensor's light on and raise the exposure",
        )
    share = overexposed_share(image)
    if share > _MAX_OVEREXPOSED_SHARE:
        return ExposureFault(
            "overexposed",
            f"levels below {OVEREXPOSED} in every channel",
            f"{share:.0%} of the image overexposed{_fullest_channel_in_words(image)}; lower exposure or gain",
        )
    return None


def _fullest_channel_in_words(image: BgrImage) -> str:
    """Return which channel is full where the others are not, or an empty text."""
    full = (image >= OVEREXPOSED).mean(axis=(0, 1))
    name = ("blue", "green", "red")[int(full.argmax())]
    return f" in {name} alone" if np.median(full) < full.max() / 2 else ""


def require_usable_exposure(name: str, image: BgrImage) -> None:
    """Raise `CalibrationError` for an image that is black or overexposed."""
    fault = find_exposure_fault(image)
    if fault is not None:
        raise CalibrationError(f"expected {fault.expected} for the {name}, got {fault.sentence}")


def require_same_image_size(name: str, reference: BgrImage, press: BgrImage) -> None:
    """Refuse a pair of images of different sizes."""
    if reference.shape != press.shape:
        (rows, cols), (got_rows, got_cols) = reference.shape[:2], press.shape[:2]
        raise CalibrationError(
            expected=f"the {name} and its reference to be of one size",
            got=f"{got_cols}x{got_rows} and {cols}x{rows}",
            remedy="take both with the same camera settings",
        )


def smooth_gaussian(image: Float32[Array, "rows cols"], sigma_px: float) -> Float32[Array, "rows cols"]:
    """Smooth an image by a Gaussian of this standard deviation; the border is repeated."""
    from scipy.ndimage import gaussian_filter  # slow to import

    return np.asarray(gaussian_filter(image, sigma_px, mode="nearest"))


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
_FEIGNED_BY_UNEVENNESS = 0.35
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
        # The steep borders of uneven light darken the residue, too.
        feigned = _FEIGNED_BY_UNEVENNESS * self.unevenness if self.unevenness > MAX_UNEVENNESS else 0.0
        if self.residue.min() > -max(_MIN_CONTACT_DARKENING, feigned):
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
        scaled = missed / (_TUKEY_CONSTANT * max(float(robust_std(missed)), 1e-6))
        weight = np.maximum(1 - scaled**2, 0)
    return (_legendre_basis(change.shape) @ solution).astype(np.float32)


@cache
def _legendre_basis(shape: tuple[int, int]) -> Float32[Array, "rows cols terms"]:
    """Return all products of Legendre polynomials of row and column up to the total degree."""
    y, x = (np.polynomial.legendre.legvander(np.linspace(-1, 1, size), _FIELD_DEGREE) for size in shape)
    degrees = range(_FIELD_DEGREE + 1)
    products = [y[:, None, i] * x[None, :, j] for i in degrees for j in degrees if i + j <= _FIELD_DEGREE]
    return np.stack(products, axis=-1).astype(np.float32)


def different_skin_warnings(
    board_reference: BgrImage, ball_reference: BgrImage, first: str = "board", then: str = "ball"
) -> tuple[str, ...]:
    """Return a warning where the images before the board and before the ball show two skins, or one skin at two places.

    first, then: what was pressed after each of the two images.
    """
    if board_reference.shape != ball_reference.shape:
        return ()
    skin = measure_skin_motion(board_reference, ball_reference)
    dim = next(filter(None, map(dim_warning, (board_reference, ball_reference))), None)
    if dim is not None:
        return (dim,) if skin.is_displaced or (skin.observable and not skin.is_same_skin) else ()
    if skin.observable and not skin.is_same_skin:
        return (
            f"the image before the {then} does not show the skin of the image before the {first} (correlation "
            f"{skin.correlation:.2f}): {first} and {then} were pressed on two sensors, or the gel was changed or the camera "
            "rotated in between; take all images of one sensor, and calibrate again",
        )
    if not skin.is_displaced:
        return ()
    return (
        f"the camera or the gel moved by {skin.distance_px:.1f} px and {abs(skin.turn_deg):.1f}° between the presses of {first} "
        f"and {then}: positions are off by that; fix both in their housing, and calibrate again",
    )

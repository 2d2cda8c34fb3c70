"""Rectified image → signed height of the skin, by a calibrated depth curve.

Thinner gel is darker and thicker gel is brighter. The brightness signal is either the *difference* in grey levels (the paper's own,
docs/references.md) or the *ratio* to the reference image, which is uniform over an image even where the light is not. The signal is
quantised finely and converted to height by one look-up table.

Where the calibration provides them, two corrections precede the look-up. `GlobalDimmingModel` estimates, from the image itself,
the light that the whole image loses when a part of the skin is dark, and adds it back. `Deblurring` sharpens the brightness field
by the known point spread of scattered light, by Wiener deconvolution (Wiener 1949, docs/references.md) on a grid that is no finer.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import cv2
import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt16
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.errors import InputError

_DFT_SIDE_FACTOR = 8
"""Sides of transformed fields are multiples of it, for which the transform is fastest."""
_MIN_POINTS_PER_SPREAD = 2.5
"""Smallest number of points of the coarser grid in one standard deviation of the point spread."""
_MAX_COARSENESS = 3


@dataclass(frozen=True)
class Deblurring:
    """Wiener deconvolution of the brightness by its Gaussian point spread."""

    point_spread_mm: Annotated[float, Meta(ge=0.01, le=5)]
    """Standard deviation of the point spread."""
    floor: Annotated[float, Meta(ge=1e-4, le=1)] = 0.03
    """Power of noise relative to signal; detail that scattering has attenuated below this level is not restored."""

    def coarseness(self, mm_per_px: float) -> int:
        """Return the pixels along one side of a point of the coarser grid; it resolves the point spread, and nothing is finer."""
        return int(np.clip(self.point_spread_mm / mm_per_px / _MIN_POINTS_PER_SPREAD, 1, _MAX_COARSENESS))

    def on_coarser_grid(
        self, field: Float32[Array, "rows cols"], mm_per_px: float
    ) -> Float32[Array, "few_rows few_cols"]:
        """Return the field as it was before scattering, on the coarser grid. Its last row and column may reach beyond the field;
        beyond its border the field is taken as mirrored.
        """
        coarseness = self.coarseness(mm_per_px)
        few = _block_means(field, coarseness)
        return deconvolve_gaussian_blur(few, self.point_spread_mm / mm_per_px / coarseness, self.floor)


def _block_means(field: Float32[Array, "rows cols"], side: int) -> Float32[Array, "few_rows few_cols"]:
    """Return the means of square blocks; rows and columns that are missing in the last ones repeat the border."""
    rows, cols = field.shape
    whole = cv2.copyMakeBorder(field, 0, -rows % side, 0, -cols % side, cv2.BORDER_REPLICATE)
    # With whole blocks, OpenCV computes these means ten times faster than with parts of pixels.
    return np.asarray(cv2.resize(whole, (whole.shape[1] // side, whole.shape[0] // side), interpolation=cv2.INTER_AREA))


def upsample(
    field: Shaped[Array, "few_rows few_cols"], shape: tuple[int, ...], fineness: int
) -> Shaped[Array, "rows cols"]:
    """Return a field on a grid of this shape that is finer by a whole factor, by cubic interpolation."""
    rows, cols = field.shape
    fine = cv2.resize(field, (cols * fineness, rows * fineness), interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(fine[: shape[0], : shape[1]])


def deconvolve_gaussian_blur(
    field: Float32[Array, "rows cols"], sigma_px: float, floor: float
) -> Float32[Array, "rows cols"]:
    """Return the field deblurred on its own grid."""
    rows, cols = field.shape
    gain = wiener_deconvolution_filter(rows, cols, round(sigma_px, 6), floor)
    down, right = gain.shape[0] - rows, gain.shape[1] - cols
    padded = cv2.copyMakeBorder(field, down // 2, down - down // 2, right // 2, right - right // 2, cv2.BORDER_REFLECT)
    transform = cv2.dft(padded, dst=padded)
    transform *= gain
    sharp = cv2.dft(transform, dst=transform, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)
    return np.ascontiguousarray(sharp[down // 2 : down // 2 + rows, right // 2 : right // 2 + cols])


@lru_cache(maxsize=8)
def wiener_deconvolution_filter(rows: int, cols: int, sigma_px: float, floor: float) -> Float32[Array, "tall wide"]:
    """Return the factor of the padded field's transform, G/(G² + floor), normalised to one for the mean.

    It is arranged as `cv2.dft` packs the transform of a real field, whose size is even here. Real and imaginary parts of one
    frequency are neighbours in a row, and in the first and last columns, which hold the frequencies 0 and 1/2, in the column.
    """
    reach = int(np.ceil(3 * sigma_px))
    tall, wide = (
        _DFT_SIDE_FACTOR * cv2.getOptimalDFTSize(-(-(side + reach) // _DFT_SIDE_FACTOR)) for side in (rows, cols)
    )
    ky = np.repeat(np.abs(np.fft.fftfreq(tall))[:, None], wide, axis=1)
    ky[:, [0, -1]] = ((np.arange(tall) + 1) // 2 / tall)[:, None]
    kx = (np.arange(wide) + 1) // 2 / wide
    spread = np.exp(-2 * (np.pi * sigma_px) ** 2 * (kx**2 + ky**2))
    return np.asarray(spread * (1 + floor) / (spread**2 + floor), np.float32)


TYPICAL_GLOBAL_DIMMING = 0.7
"""Relative light lost everywhere per mean darkening of the view, from eight real sensors of five laboratories."""
TYPICAL_POINT_SPREAD_MM = 0.55
"""Standard deviation of the point spread of the same eight sensors."""
_SAMPLING_STRIDE_PX = 5
"""Every how many rows and columns the mean darkening is sampled; darkening is smooth enough for that."""
_MIN_DARKENING = 0.02
"""Relative darkening above which a pixel counts as dark; three standard deviations of a pixel's noise with some drift are less."""
_DIMMING_ITERATIONS = 4
"""Number of times that the loss is subtracted and the darkening averaged again; each reduces the error to a fifth or less."""


@dataclass(frozen=True)
class GlobalDimmingModel:
    """The model of the relative loss of light c of a whole image, in which a part of the skin is dark."""

    global_dimming: Annotated[float, Meta(ge=0, le=10)] = 0.0
    """c per mean darkening of the view; zero where the calibration does not determine it."""

    def __call__(self, grey: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"]) -> float:
        """Return c of this image, zero or below; it is exactly zero where nothing is noticeably dark."""
        if self.global_dimming == 0:
            return 0.0
        brightness, loss = _sample_relative_brightness(grey, reference), 0.0
        for _ in range(_DIMMING_ITERATIONS):
            loss = -self.global_dimming * _mean_noticed_darkening(brightness, loss)
        return loss


def mean_view_darkening(
    grey: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"], loss: float
) -> float:
    """Return the mean darkening of the view relative to the reference image, after the loss is subtracted."""
    return _mean_noticed_darkening(_sample_relative_brightness(grey, reference), loss)


def _sample_relative_brightness(
    grey: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"]
) -> Float32[Array, "few_rows few_cols"]:
    """Return the brightness relative to the reference image at every few rows and columns."""
    few = np.s_[::_SAMPLING_STRIDE_PX, ::_SAMPLING_STRIDE_PX]
    return np.asarray(grey[few] / np.maximum(reference[few], 1))


def _mean_noticed_darkening(brightness: Float32[Array, "few_rows few_cols"], loss: float) -> float:
    """Return the mean darkening after the loss is subtracted, of the pixels that are noticeably dark."""
    darkening = cv2.addWeighted(brightness, -1 / (1 + loss), brightness, 0, 1)
    return float(cv2.mean(cv2.threshold(darkening, _MIN_DARKENING, 0, cv2.THRESH_TOZERO, dst=darkening)[1])[0])


BrightnessSignal = Literal["difference", "ratio"]
DepthMethod = Literal["physics", "ratio", "table"]
"""How a depth curve was calibrated (`calibration.ball.ball_fit`)."""

TABLE_STEPS: dict[BrightnessSignal, float] = {"difference": 128.0, "ratio": 32768.0}
"""Table steps per grey level, and per unit of the ratio: far finer than the noise of a pixel."""
TABLE_SIZE = 65536
"""Number of entries of the table, the range of a 16-bit index."""
OPENCV_TAKES_16_BITS = int(cv2.__version__.split(".")[0]) >= 5
"""Whether OpenCV's look-up accepts 16-bit indices; it is then twice as fast as NumPy's."""
BALANCE: dict[BrightnessSignal, float] = {"difference": 2.0, "ratio": 2 / 160}
"""Brightening up to which noise may cancel darkening: three standard deviations of a pixel."""
ZERO_INDEX = TABLE_SIZE // 2
"""Table index of unchanged brightness."""
_CLIPPED_STDS = 2.0
"""Errors of the end of a curve by which skin must be deeper, so that the press from which the curve was made is not."""
DIMMEST_REFERENCE = 1.0
"""Grey level below which a ratio is meaningless; darker pixels of the reference image are raised to it."""


_Signal = Annotated[float, Meta(ge=0, le=255)]
_KnotMm = Annotated[float, Meta(ge=0, le=15)]
"""Height or error at a knot; no gel is thicker (`design.Gel`)."""


@dataclass(frozen=True)
class CurveContinuation:
    """Knots beyond the deepest calibrated indentation, where the curve follows the brightness model alone; by default none."""

    darkening: tuple[_Signal, ...] = ()
    indentation_mm: tuple[_KnotMm, ...] = ()
    error_mm: tuple[_KnotMm, ...] = ()
    """Standard deviation at each knot, which grows with the distance from the calibrated range."""


@dataclass(frozen=True)
class DepthCurve:
    """Darkening → indentation and, where it is calibrated, brightening → bulge; both are monotone and zero at zero.

    On a base that yields these are the thinning and the thickening of the gel, to which its deflection is added (`BaseDeflection`).
    """

    signal: BrightnessSignal
    darkening: tuple[_Signal, ...]
    """Ascending from 0; in grey levels for `difference`, as a fraction of the reference brightness for `ratio`."""
    indentation_mm: tuple[_KnotMm, ...]
    error_mm: tuple[_KnotMm, ...]
    """Standard deviation at each knot: scatter of the pixels about the curve, and cross-validation between halves of the disc."""
    brightening: tuple[_Signal, ...] = (0.0,)
    bulge_mm: tuple[_KnotMm, ...] = (0.0,)
    beyond: CurveContinuation = CurveContinuation()
    """The continuation of the curve; heights there count as extrapolated. Beyond all knots the end value is kept."""

    def __post_init__(self) -> None:
        _require_valid_curve("darkening", *self.pressed[:2])
        _require_valid_curve("brightening", self.brightening, self.bulge_mm)
        if len(self.pressed[2]) != len(self.pressed[0]):
            raise InputError(f"expected {len(self.pressed[0])} errors, one for each knot, got {len(self.pressed[2])}")

    @cached_property
    def pressed(self) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """Darkening, indentation (mm) and its error (mm) at all knots, those beyond the calibrated range included."""
        beyond = self.beyond
        return (
            self.darkening + beyond.darkening,
            self.indentation_mm + beyond.indentation_mm,
            self.error_mm + beyond.error_mm,
        )

    @property
    def max_indentation_mm(self) -> float:
        """Indentation at the end of the calibrated range."""
        return self.indentation_mm[-1]

    def height_mm(self, signal: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the signed height for a signed signal (negative darker); beyond all knots the end value is kept."""
        darkening, indentation_mm, _ = self.pressed
        return np.interp(signal, self.brightening, self.bulge_mm) - np.interp(-signal, darkening, indentation_mm)

    @cached_property
    def table(self) -> Float32[Array, " size"]:
        """Height in mm for every quantised signal."""
        signal = (np.arange(TABLE_SIZE) - ZERO_INDEX) / TABLE_STEPS[self.signal]
        return (self.height_mm(signal) + self.balance_mm(signal)).astype(np.float32)

    def look_up_mm(self, index: UInt16[Array, "rows cols"]) -> Float32[Array, "rows cols"]:
        """Return the height of every pixel, given its table index."""
        return np.asarray(cv2.LUT(index, self.table) if OPENCV_TAKES_16_BITS else np.take(self.table, index))

    @property
    def knows_bulges(self) -> bool:
        """Whether the curve also covers brightening, that is, bulges."""
        return len(self.brightening) > 1

    def balance_mm(self, signal: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the height for brightening by continuing the first segment of the curve a little, where no bulges are calibrated.

        Otherwise only the dark half of the noise would count, and skin without contact would appear indented. After the filters,
        heights above zero are set to zero.
        """
        if self.knows_bulges or len(self.darkening) < 2:
            return np.zeros_like(signal)
        slope = self.indentation_mm[1] / self.darkening[1]
        return np.clip(signal, 0, BALANCE[self.signal]) * slope

    @property
    def darkest_index(self) -> int:
        """Table index of the end of the calibrated range."""
        return int(np.floor(ZERO_INDEX - self.darkening[-1] * TABLE_STEPS[self.signal]))

    @cached_property
    def clipped_index(self) -> int:
        """Table index below which skin is deeper than the end of all knots by more than twice the error there, if the curve went on
        as steeply as it is on average.
        """
        darkening, indentation_mm, error_mm = (knots[-1] for knots in self.pressed)
        margin = _CLIPPED_STDS * darkening * error_mm / indentation_mm if indentation_mm > 0 else 0.0
        return int(np.floor(ZERO_INDEX - (darkening + margin) * TABLE_STEPS[self.signal]))


def _require_valid_curve(name: str, signal: tuple[float, ...], length_mm: tuple[float, ...]) -> None:
    """Refuse a curve that is not finite, starts away from zero, or falls."""
    values = np.array([signal, length_mm]) if len(signal) == len(length_mm) and signal else np.array([[np.nan]])
    if (
        not np.isfinite(values).all()
        or values[:, 0].any()
        or (np.diff(values[0]) <= 0).any()
        or (np.diff(values[1]) < 0).any()
    ):
        raise InputError(
            expected=f"a {name} curve of finite numbers that starts at (0, 0) and rises",
            got=f"{len(signal)} and {len(length_mm)} numbers that do not",
            remedy="calibrate again",
        )


@dataclass(frozen=True)
class Smoothing:
    """The two Gaussian filters after the look-up (the paper's), standard deviations in rectified pixels."""

    first_px: Annotated[float, Meta(ge=0, le=50)] = 1.5
    second_px: Annotated[float, Meta(ge=0, le=50)] = 1.5

    @property
    def combined_px(self) -> float:
        """Standard deviation of the one Gaussian that equals the two in sequence, whose variances add."""
        return float(np.hypot(self.first_px, self.second_px))

    def on_grid(self, fineness: float) -> "Smoothing":
        """Return the same filters on another grid; fineness: its points per rectified pixel."""
        return self if fineness == 1 else Smoothing(self.first_px * fineness, self.second_px * fineness)

    def __call__(self, field: Float32[Array, "rows cols"]) -> Float32[Array, "rows cols"]:
        """Return the smoothed field; a standard deviation of zero leaves it unchanged."""
        if self.combined_px == 0:
            return field
        side = 2 * round(3 * self.combined_px) + 1
        return np.asarray(cv2.GaussianBlur(field, (side, side), self.combined_px, borderType=cv2.BORDER_REPLICATE))


FINE_SMOOTHING = Smoothing(2.5, 2.5)
"""Smoothing after deblurring, which raises the noise; 0.18 mm, still far narrower than the point spread that was removed."""

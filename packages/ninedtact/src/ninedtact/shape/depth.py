"""Rectified image → signed height of the skin, by a calibrated depth curve.

Thinner gel is darker and thicker gel is brighter. The brightness signal is either the *difference* in grey levels (the paper's own,
docs/references.md) or the *ratio* to the reference image, which is uniform over an image even where the light is not. The signal is
quantised finely and converted to height by one look-up table.

Where the calibration provides them, two corrections precede the look-up. `GlobalDimmingModel` estimates, from the image itself,
the light that the whole image loses when a part of the skin is dark, and adds it back. `Deblurring` sharpens the brightness field
by the known point spread of scattered light.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt16
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.shape.deblurring import block_means

TYPICAL_GLOBAL_DIMMING = 0.7
"""Relative light lost everywhere per mean darkening of the view, from eight real sensors of five laboratories."""
TYPICAL_POINT_SPREAD_MM = 0.55
"""Standard deviation of the point spread of the same eight sensors."""
SAMPLING_SIDE_PX = 4
"""Side of the blocks of which the darkening is averaged; darkening is smooth enough for that, and the noise of a mean is small."""
MIN_DARKENING = 0.012
"""Relative darkening above which a block counts as dark; noise with some drift is less."""
DIMMING_ITERATIONS = 4
"""Number of times that the loss is subtracted and the darkening averaged again; each reduces the error to a fifth or less."""


@dataclass(frozen=True)
class GlobalDimmingModel:
    """The model of the relative loss of light c of a whole image, in which a part of the skin is dark."""

    global_dimming: Annotated[float, Meta(ge=0, le=10)] = 0.0
    """c per mean darkening of the view; zero where the calibration does not determine it."""

    def __call__(self, grey: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"]) -> float:
        """Return c of this image, zero or below; it is exactly zero where nothing is noticeably dark."""
        return self.loss_of(_sample_relative_brightness(grey, reference)) if self.global_dimming else 0.0

    def loss_of(self, brightness: Float32[Array, "few_rows few_cols"]) -> float:
        """Return c, given the mean brightness of blocks of pixels relative to the reference image."""
        loss = 0.0
        for _ in range(DIMMING_ITERATIONS if self.global_dimming else 0):
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
    """Return the mean brightness of blocks relative to that of the reference image."""
    return block_means(grey, SAMPLING_SIDE_PX) / np.maximum(block_means(reference, SAMPLING_SIDE_PX), 1)


def _mean_noticed_darkening(brightness: Float32[Array, "few_rows few_cols"], loss: float) -> float:
    """Return the mean darkening after the loss is subtracted, of the blocks that are noticeably dark."""
    darkening = cv2.addWeighted(brightness, -1 / (1 + loss), brightness, 0, 1)
    return float(cv2.mean(cv2.threshold(darkening, MIN_DARKENING, 0, cv2.THRESH_TOZERO, dst=darkening)[1])[0])


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


FINE_SMOOTHING = Smoothing(1.0, 1.0)
"""Smoothing after deblurring, which raises the noise; 0.07 mm, far narrower than the point spread that was removed."""

"""The light that the whole image loses when a part of the skin is dark, told from the image itself.

Sharpens a brightness field that light has scattered, by the known point-spread (Wiener 1949, docs/references.md).

Rectified image → signed height of the skin, by a calibrated depth curve.

Thinner gel is darker, thicker gel is brighter. Two signals say how much: the *difference* in grey levels (the paper's
own, docs/references.md) and the *ratio* to the untouched image, which is the one that is uniform over an image whose
light is not. Either is quantised finely and looked up in one table. Where the calibration knows it, the light that
the whole image loses to what is dark is given back first, and the light that scatters is put back where it came from.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.quantities import HeightMap, HeightSource, Rectified

TYPICAL_GLOBAL_DIMMING = 0.7
"""Light lost everywhere per mean darkening of the view: eight real sensors of five labs."""
TYPICAL_POINT_SPREAD_MM = 0.55
"""Standard deviation of the point-spread of the same sensors."""
LOSS_EVERY_PX = 5
"""Rows and columns looked at: darkness is smooth."""
NOTICED = 0.02
"""Darkening that counts, relative: three standard deviations of a pixel's noise and a little drift stay below it."""
ROUNDS = 4
"""Of taking the loss off before darkness is counted; each gains a factor of five or more."""


@dataclass(frozen=True)
class LightLoss:
    """c, relative, for an image of which some is dark."""

    global_dimming: float = 0.0
    """c per mean darkening of the view; zero where the calibration knows of none."""

    def __call__(self, grey: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"]) -> float:
        """c of this image, zero or below; exactly zero where nothing is noticeably dark."""
        if self.global_dimming == 0:
            return 0.0
        loss = 0.0
        for _ in range(ROUNDS):
            loss = -self.global_dimming * mean_darkening(grey, reference, loss)
        return loss


def mean_darkening(grey: Float32[Array, "rows cols"], reference: Float32[Array, "rows cols"], loss: float) -> float:
    """Of the view, relative to untouched skin, the loss taken off."""
    few = np.s_[::LOSS_EVERY_PX, ::LOSS_EVERY_PX]
    darkening = 1 - grey[few] / (np.maximum(reference[few], 1) * np.float32(1 + loss))
    return float(np.where(darkening > NOTICED, darkening, 0).mean())


LEAST_POINTS = 3.0
"""Of the coarser grid in one standard deviation of the point-spread."""
COARSEST = 3


@dataclass(frozen=True)
class Deblurring:
    """A Gaussian point-spread to undo, as far as noise allows."""

    point_spread_mm: float
    """Standard deviation of the point-spread."""
    floor: float = 0.03
    """Power of noise relative to signal: what is scattered more than this hides it stays scattered."""

    def __call__(self, field: Float32[Array, "rows cols"], mm_per_px: float) -> Float32[Array, "rows cols"]:
        """The field as it was before scattering; beyond its border it is taken as mirrored.

        Computed on a coarser grid, of which a point-spread still spans three points or more: what is finer was blurred away.
        """
        coarser = int(np.clip(self.point_spread_mm / mm_per_px / LEAST_POINTS, 1, COARSEST))
        rows, cols = (side // coarser for side in field.shape)
        few = cv2.resize(field, (cols, rows), interpolation=cv2.INTER_AREA)
        sharp = sharpened(few, self.point_spread_mm / mm_per_px * cols / field.shape[1], self.floor)
        return np.asarray(cv2.resize(sharp, field.shape[::-1], interpolation=cv2.INTER_CUBIC))


def sharpened(field: Float32[Array, "rows cols"], sigma_px: float, floor: float) -> Float32[Array, "rows cols"]:
    """The same on the field's own grid."""
    from scipy.fft import irfft2, rfft2

    rows, cols = field.shape
    tall, wide, gain = sharpening(rows, cols, round(sigma_px, 6), floor)
    down, right = tall - rows, wide - cols
    padded = cv2.copyMakeBorder(field, down // 2, down - down // 2, right // 2, right - right // 2, cv2.BORDER_REFLECT)
    sharp = irfft2(rfft2(padded) * gain, s=(tall, wide))
    return np.ascontiguousarray(sharp[down // 2 : down // 2 + rows, right // 2 : right // 2 + cols], np.float32)


@lru_cache(maxsize=8)
def sharpening(rows: int, cols: int, sigma_px: float, floor: float) -> tuple[int, int, Float32[Array, "tall half"]]:
    """Size of the padded field, and what its transform is multiplied by: G/(G² + floor), one for the mean."""
    from scipy.fft import next_fast_len

    reach = int(np.ceil(3 * sigma_px))
    tall, wide = next_fast_len(rows + reach, real=True), next_fast_len(cols + reach, real=True)
    ky, kx = np.fft.fftfreq(tall)[:, None], np.fft.rfftfreq(wide)[None]
    spread = np.exp(-2 * (np.pi * sigma_px) ** 2 * (kx**2 + ky**2))
    return tall, wide, (spread * (1 + floor) / (spread**2 + floor)).astype(np.float32)


BrightnessSignal = Literal["difference", "ratio"]

TABLE_STEPS: dict[BrightnessSignal, float] = {"difference": 128.0, "ratio": 32768.0}
"""Table steps per grey level, and per unit of the ratio: far finer than the noise of a pixel."""
TABLE_SIZE = 65536
"""As far as an index of 16 bits reaches."""
OPENCV_TAKES_16_BITS = int(cv2.__version__.split(".")[0]) >= 5
"""Whether its look-up does, which is twice as fast as NumPy's."""
BALANCE: dict[BrightnessSignal, float] = {"difference": 2.0, "ratio": 2 / 160}
"""Brightening up to which noise may cancel darkening: three standard deviations of a pixel."""
ZERO_INDEX = TABLE_SIZE // 2
"""Table index of the untouched skin."""
DIMMEST_REFERENCE = 1.0
"""Grey level below which a ratio means nothing; the reference is not taken darker than this."""


class DepthCurveImpossible(InputError):
    """A depth curve that is not one."""


@dataclass(frozen=True)
class DepthCurve:
    """Darkening → indentation and, where one is known, brightening → bulge; both monotone and zero at zero."""

    signal: BrightnessSignal
    darkening: tuple[float, ...]
    """Ascending from 0; grey levels for `difference`, a fraction of the untouched brightness for `ratio`."""
    indentation_mm: tuple[float, ...]
    error_mm: tuple[float, ...]
    """At each knot: scatter of the pixels about the curve, and what one half of the ball says about the other."""
    brightening: tuple[float, ...] = (0.0,)
    bulge_mm: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        require_curve("darkening", self.darkening, self.indentation_mm)
        require_curve("brightening", self.brightening, self.bulge_mm)
        if len(self.error_mm) != len(self.darkening):
            raise DepthCurveImpossible(
                f"expected {len(self.darkening)} errors, one for each knot, got {len(self.error_mm)}"
            )

    @property
    def max_indentation_mm(self) -> float:
        """Indentation at the end of the calibrated range."""
        return self.indentation_mm[-1]

    def height_mm(self, signal: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Signed height for a signed signal (negative darker); beyond the range the end value is kept."""
        pressed = np.interp(-signal, self.darkening, self.indentation_mm)
        return np.interp(signal, self.brightening, self.bulge_mm) - pressed

    @cached_property
    def table(self) -> Float32[Array, " size"]:
        """Height in mm for every quantised signal."""
        signal = (np.arange(TABLE_SIZE) - ZERO_INDEX) / TABLE_STEPS[self.signal]
        return (self.height_mm(signal) + self.balance_mm(signal)).astype(np.float32)

    @property
    def knows_bulges(self) -> bool:
        """Whether brighter pixels have a curve too."""
        return len(self.brightening) > 1

    def balance_mm(self, signal: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Continues the first stretch of the curve a little into the bright where no bulge is known.

        Else only the dark half of the noise would count, and untouched skin would read as pressed in. It is for the
        filters alone: after them what is above zero is zero.
        """
        if self.knows_bulges or len(self.darkening) < 2:
            return np.zeros_like(signal)
        slope = self.indentation_mm[1] / self.darkening[1]
        return np.clip(signal, 0, BALANCE[self.signal]) * slope

    @property
    def darkest_index(self) -> int:
        """Table index of the end of the calibrated range."""
        return int(np.floor(ZERO_INDEX - self.darkening[-1] * TABLE_STEPS[self.signal]))


def require_curve(name: str, signal: tuple[float, ...], length_mm: tuple[float, ...]) -> None:
    """Refuse a curve that is not finite, starts away from zero, or falls."""
    values = np.array([signal, length_mm]) if len(signal) == len(length_mm) and signal else np.array([[np.nan]])
    if (
        not np.isfinite(values).all()
        or values[:, 0].any()
        or (np.diff(values[0]) <= 0).any()
        or (np.diff(values[1]) < 0).any()
    ):
        raise DepthCurveImpossible(
            f"expected a {name} curve of finite numbers that starts at (0, 0) and rises, got {len(signal)} and "
            f"{len(length_mm)} numbers that do not; calibrate again"
        )


@dataclass(frozen=True)
class Smoothing:
    """The two Gaussian filters after the look-up (the paper's), standard deviations in rectified pixels."""

    first_px: float = 1.5
    second_px: float = 1.5

    @property
    def combined_px(self) -> float:
        """One Gaussian that equals the two in a row: their variances add."""
        return float(np.hypot(self.first_px, self.second_px))

    def __call__(self, field: Float32[Array, "rows cols"]) -> Float32[Array, "rows cols"]:
        """Smooth a field; zero standard deviations leave it as it is."""
        if self.combined_px == 0:
            return field
        side = 2 * round(3 * self.combined_px) + 1
        return np.asarray(cv2.GaussianBlur(field, (side, side), self.combined_px, borderType=cv2.BORDER_REPLICATE))


FINE_SMOOTHING = Smoothing(2.5, 2.5)
"""After deblurring, which has raised the noise; 0.18 mm, still far narrower than what was undone."""


@dataclass(frozen=True)
class DepthReader:
    """A depth curve bound to the untouched image of this session."""

    curve: DepthCurve
    reference: Rectified
    lens_source: UInt8[Array, "rows cols"]
    smoothing: Smoothing = Smoothing()
    noise_mm: float = 0.0
    camera_distance_mm: float = np.inf
    loss: LightLoss = LightLoss()
    deblurring: Deblurring | None = None
    """Done where it is given: `fine` reading. Without it, reading is `fast`."""

    def __call__(self, rectified: Rectified) -> HeightMap:
        """Signed height of the skin, with what each pixel rests on."""
        index = self.index(rectified.grey)
        z_mm = self.smoothing(look_up_heights(self.curve.table, index))
        if not self.curve.knows_bulges:
            cv2.threshold(z_mm, 0, 0, cv2.THRESH_TRUNC, dst=z_mm)
        if not self.all_in_view:
            z_mm[self.lens_source == HeightSource.OUT_OF_VIEW] = 0
        return HeightMap(
            z_mm,
            self.height_source(index),
            rectified.mm_per_px,
            self.noise_mm,
            self.camera_distance_mm,
            rectified.stamp_ns,
        )

    def index(self, grey: Float32[Array, "rows cols"]) -> UInt16[Array, "rows cols"]:
        """Place in the curve's table of every pixel, lost and scattered light put back where the calibration knows how."""
        lost = self.loss(grey, self.reference.grey)
        if self.deblurring is None:
            return self.quantised(grey if lost == 0 else grey * np.float32(1 / (1 + lost)))
        ratio = np.asarray(cv2.multiply(grey, self.per_reference, scale=1 / (1 + lost)))
        change = self.deblurring(ratio - 1, self.reference.mm_per_px)
        return np.asarray(cv2.addWeighted(change, TABLE_STEPS["ratio"], change, 0, ZERO_INDEX, dtype=cv2.CV_16U))

    @cached_property
    def per_reference(self) -> Float32[Array, "rows cols"]:
        """One over the untouched image, nowhere too dim to divide by."""
        return 1 / np.maximum(self.reference.grey, np.float32(DIMMEST_REFERENCE))

    def error_mm(self, indentation_mm: float) -> float:
        """Standard deviation of one pixel's indentation: scatter of the calibration and noise of the camera."""
        scatter = np.interp(indentation_mm, self.curve.indentation_mm, self.curve.error_mm)
        return float(np.hypot(scatter, self.noise_mm))

    def quantised(self, grey: Float32[Array, "rows cols"]) -> UInt16[Array, "rows cols"]:
        """The signed signal as an index into the curve's table, rounded, and kept inside it by saturation."""
        steps = TABLE_STEPS[self.curve.signal]
        if self.curve.signal == "difference":
            return np.asarray(cv2.addWeighted(grey, steps, self.index_offset, 1, 0, dtype=cv2.CV_16U))
        return np.asarray(cv2.multiply(grey, self.index_gain, dtype=cv2.CV_16U))

    @cached_property
    def index_offset(self) -> Float32[Array, "rows cols"]:
        """Difference: index = grey · steps + offset."""
        return ZERO_INDEX - np.float32(TABLE_STEPS["difference"]) * self.reference.grey

    @cached_property
    def index_gain(self) -> Float32[Array, "rows cols"]:
        """Ratio: index = grey · gain, because the untouched skin has the ratio one and the steps per unit are `ZERO_INDEX`."""
        return np.float32(TABLE_STEPS["ratio"]) * self.per_reference

    def height_source(self, index: UInt16[Array, "rows cols"]) -> UInt8[Array, "rows cols"]:
        """Where a pixel is darker than anything calibrated, its height is an extrapolation."""
        beyond = (index < self.curve.darkest_index).view(np.uint8)
        return np.minimum(self.lens_source, np.uint8(HeightSource.MEASURED) - beyond)

    @cached_property
    def all_in_view(self) -> bool:
        """Whether the camera sees every pixel of the grid."""
        return bool((self.lens_source != HeightSource.OUT_OF_VIEW).all())


def look_up_heights(table: Float32[Array, " size"], index: UInt16[Array, "rows cols"]) -> Float32[Array, "rows cols"]:
    """The table's entry for every pixel."""
    return np.asarray(cv2.LUT(index, table) if OPENCV_TAKES_16_BITS else np.take(table, index))

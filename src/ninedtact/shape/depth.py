"""Rectified image → signed height of the skin, by a calibrated depth curve.

Thinner gel is darker, thicker gel is brighter. Two signals say how much: the *difference* in grey levels (the paper's
own, docs/references.md) and the *ratio* to the untouched image, which is the one that is uniform over an image whose
light is not. Either is quantised finely and looked up in one table. Where the calibration knows it, the light that
the whole image loses to what is dark is given back first, and the light that scatters is put back where it came from.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.quantities import Coverage, HeightMap, Rectified
from ninedtact.shape.deblur import Deblurring
from ninedtact.shape.loss import Loss

Signal = Literal["difference", "ratio"]

STEPS: dict[Signal, float] = {"difference": 128.0, "ratio": 32768.0}
"""Table steps per grey level, and per unit of the ratio: far finer than the noise of a pixel."""
TABLE_SIZE = 65536
"""As far as an index of 16 bits reaches."""
OPENCV_TAKES_16_BITS = int(cv2.__version__.split(".")[0]) >= 5
"""Whether its look-up does, which is twice as fast as NumPy's."""
BALANCE: dict[Signal, float] = {"difference": 2.0, "ratio": 2 / 160}
"""Brightening up to which noise may cancel darkening: three standard deviations of a pixel."""
ZERO = TABLE_SIZE // 2
"""Table index of the untouched skin."""
DIMMEST_REFERENCE = 1.0
"""Grey level below which a ratio means nothing; the reference is not taken darker than this."""


class CurveImpossible(NinedtactError):
    """A depth curve that is not one."""


@dataclass(frozen=True)
class DepthCurve:
    """Darkening → indentation and, where one is known, brightening → bulge; both monotone and zero at zero."""

    signal: Signal
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
            raise CurveImpossible(f"expected {len(self.darkening)} errors, one for each knot, got {len(self.error_mm)}")

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
        signal = (np.arange(TABLE_SIZE) - ZERO) / STEPS[self.signal]
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
        return int(np.floor(ZERO - self.darkening[-1] * STEPS[self.signal]))


def require_curve(name: str, signal: tuple[float, ...], length_mm: tuple[float, ...]) -> None:
    """Refuse a curve that is not finite, starts away from zero, or falls."""
    values = np.array([signal, length_mm]) if len(signal) == len(length_mm) and signal else np.array([[np.nan]])
    if (
        not np.isfinite(values).all()
        or values[:, 0].any()
        or (np.diff(values[0]) <= 0).any()
        or (np.diff(values[1]) < 0).any()
    ):
        raise CurveImpossible(
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
    lens_coverage: UInt8[Array, "rows cols"]
    smoothing: Smoothing = Smoothing()
    noise_mm: float = 0.0
    camera_distance_mm: float = np.inf
    loss: Loss = Loss()
    deblurring: Deblurring | None = None
    """Done where it is given: `fine` reading. Without it, reading is `fast`."""

    def __call__(self, rectified: Rectified) -> HeightMap:
        """Signed height of the skin, with what each pixel rests on."""
        index = self.index(rectified.grey)
        z_mm = self.smoothing(looked_up(self.curve.table, index))
        if not self.curve.knows_bulges:
            cv2.threshold(z_mm, 0, 0, cv2.THRESH_TRUNC, dst=z_mm)
        if not self.all_in_view:
            z_mm[self.lens_coverage == Coverage.OUT_OF_VIEW] = 0
        return HeightMap(
            z_mm, self.coverage(index), rectified.mm_per_px, self.noise_mm, self.camera_distance_mm, rectified.stamp_ns
        )

    def index(self, grey: Float32[Array, "rows cols"]) -> UInt16[Array, "rows cols"]:
        """Place in the curve's table of every pixel, lost and scattered light put back where the calibration knows how."""
        lost = self.loss(grey, self.reference.grey)
        if self.deblurring is None:
            return self.quantised(grey if lost == 0 else grey * np.float32(1 / (1 + lost)))
        ratio = np.asarray(cv2.multiply(grey, self.per_reference, scale=1 / (1 + lost)))
        change = self.deblurring(ratio - 1, self.reference.mm_per_px)
        return np.asarray(cv2.addWeighted(change, STEPS["ratio"], change, 0, ZERO, dtype=cv2.CV_16U))

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
        steps = STEPS[self.curve.signal]
        if self.curve.signal == "difference":
            return np.asarray(cv2.addWeighted(grey, steps, self.index_offset, 1, 0, dtype=cv2.CV_16U))
        return np.asarray(cv2.multiply(grey, self.index_gain, dtype=cv2.CV_16U))

    @cached_property
    def index_offset(self) -> Float32[Array, "rows cols"]:
        """Difference: index = grey · steps + offset."""
        return ZERO - np.float32(STEPS["difference"]) * self.reference.grey

    @cached_property
    def index_gain(self) -> Float32[Array, "rows cols"]:
        """Ratio: index = grey · gain, because the untouched skin has the ratio one and the steps per unit are `ZERO`."""
        return np.float32(STEPS["ratio"]) * self.per_reference

    def coverage(self, index: UInt16[Array, "rows cols"]) -> UInt8[Array, "rows cols"]:
        """Where a pixel is darker than anything calibrated, its height is an extrapolation."""
        beyond = (index < self.curve.darkest_index).view(np.uint8)
        return np.minimum(self.lens_coverage, np.uint8(Coverage.MEASURED) - beyond)

    @cached_property
    def all_in_view(self) -> bool:
        """Whether the camera sees every pixel of the grid."""
        return bool((self.lens_coverage != Coverage.OUT_OF_VIEW).all())


def looked_up(table: Float32[Array, " size"], index: UInt16[Array, "rows cols"]) -> Float32[Array, "rows cols"]:
    """The table's entry for every pixel."""
    return np.asarray(cv2.LUT(index, table) if OPENCV_TAKES_16_BITS else np.take(table, index))

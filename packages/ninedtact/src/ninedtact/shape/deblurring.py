"""Removal of the point spread of scattered light from a brightness field, by Wiener deconvolution (Wiener 1949,
docs/references.md), on a grid that is no finer than the point spread.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
from jaxtyping import Float32, Shaped
from msgspec import Meta
from numpy import ndarray as Array

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

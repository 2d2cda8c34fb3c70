"""Sharpens a brightness field that light has scattered, by the known point-spread (Wiener 1949, docs/references.md)."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

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

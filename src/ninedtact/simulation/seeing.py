"""Lines of sight over a skin that is not flat, on the periodic grid of its patch.

A line of sight through P on the untouched plane meets skin of height u at P(1 + u/D), D being the distance it is looked at
from; deep skin is seen displaced outwards. What the plane shows is then blurred by scattering. Between its points a smooth field
is known exactly, by its waves: it is made finer with them, and only then looked up linearly.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.mechanics.periodic_grid import PeriodicGrid

STEPS = 3
"""Of the fixed point that finds where a line of sight meets the skin; each gains a factor of slope · place/D, under 0.4."""
FINER = 3
"""How many times finer a field is made before it is looked up."""

Field = Float32[Array, "rows cols"]
Fine = Float32[Array, "fine_rows fine_cols"]


@dataclass(frozen=True)
class Sight:
    """Points of the untouched plane, in mm, looked through from 1/nearness below."""

    x_mm: Float32[Array, "a b"]
    y_mm: Float32[Array, "a b"]
    inverse_distance_per_mm: float

    def away(self, patch: PeriodicGrid, centre_mm: tuple[float, float], height: Field) -> Float32[Array, "a b"]:
        """How many times farther from the middle than on the plane each line meets the skin."""
        away = np.ones_like(self.x_mm)
        for _ in range(STEPS if self.inverse_distance_per_mm else 0):
            at = grid(patch, centre_mm, self.x_mm * away, self.y_mm * away)
            away = 1 + np.float32(self.inverse_distance_per_mm) * sampled(height, *at)
        return away

    def height_mm(
        self, patch: PeriodicGrid, centre_mm: tuple[float, float], height: Field, *, fine: bool = False
    ) -> Float32[Array, "a b"]:
        """Height of the skin that these points show. `centre_mm`: where the patch's middle lies on the sensor."""
        away = self.away(patch, centre_mm, height)
        at = grid(patch, centre_mm, self.x_mm * away, self.y_mm * away, FINER if fine else 1)
        return sampled(refined(patch, height)[0] if fine else height, *at)


def grid(
    patch: PeriodicGrid, centre_mm: tuple[float, float], x_mm: Array, y_mm: Array, finer: int = 1
) -> tuple[Array, Array]:
    """Columns and rows of a patch, or of one made finer, at places of the sensor."""
    per_mm = np.float32(finer / patch.pitch_mm)
    cols = (x_mm - np.float32(centre_mm[0])) * per_mm + np.float32((patch.cols - 1) / 2 * finer)
    rows = (y_mm - np.float32(centre_mm[1])) * per_mm + np.float32((patch.rows - 1) / 2 * finer)
    return cols, rows


def sampled(field: Float32[Array, "rows cols"], cols: Array, rows: Array) -> Array:
    """A periodic field between its points, linearly."""
    return np.asarray(cv2.remap(field, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))


def refined(patch: PeriodicGrid, *fields: Field) -> Float32[Array, "n fine_rows fine_cols"]:
    """Fields of a patch on a grid `FINER` times finer, by their waves."""
    return scattered(patch, 0.0, *fields)


def scattered(patch: PeriodicGrid, sigma_mm: float, *fields: Field) -> Float32[Array, "n fine_rows fine_cols"]:
    """The same through a Gaussian point-spread; exact and periodic."""
    from scipy.fft import irfft2, rfft2

    wave = rfft2(np.stack(fields)) * np.float32(FINER**2)
    if sigma_mm:
        kx, ky = patch.waves
        wave = wave * np.exp(-(sigma_mm**2) / 2 * (kx**2 + ky**2)).astype(np.float32)
    return np.asarray(irfft2(with_room(wave, patch), s=(patch.rows * FINER, patch.cols * FINER)), np.float32)


def with_room(wave: Array, patch: PeriodicGrid) -> Array:
    """A transform with zeros where the finer grid has waves that the patch has not."""
    upper = (patch.rows + 1) // 2
    room = np.zeros((*wave.shape[:-2], patch.rows * FINER, patch.cols * FINER // 2 + 1), wave.dtype)
    room[..., :upper, : wave.shape[-1]] = wave[..., :upper, :]
    room[..., upper - patch.rows :, : wave.shape[-1]] = wave[..., upper:, :]
    return room

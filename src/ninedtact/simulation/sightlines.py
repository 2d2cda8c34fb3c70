"""Lines of sight over a skin that is not flat, on its periodic grid.

A line of sight through P on the undeformed plane meets skin of height u at P(1 + u/D), D being the distance it is seen from;
deep skin appears displaced outwards. What the plane shows is then blurred by scattering. Between its points a smooth field is
known exactly, by its waves: fields are refined with them, and only then interpolated linearly.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from array_api_compat import device
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.mechanics.periodic_grid import PeriodicGrid

FIXED_POINT_STEPS = 3
"""Of the iteration that finds where a line of sight meets the skin; each gains a factor of slope · position/D, under 0.4."""
REFINEMENT = 3
"""How many times finer a field is made before it is interpolated."""

Field = Float32[Array, "rows cols"]
FineFields = Float32[Array, "n fine_rows fine_cols"]


@dataclass(frozen=True)
class SightlineGrid:
    """Lines of sight through points of the undeformed plane, in mm, seen from a distance D below; the inverse distance is 1/D."""

    x_mm: Float32[Array, "a b"]
    y_mm: Float32[Array, "a b"]
    inverse_distance_per_mm: float

    def height_mm(
        self, grid: PeriodicGrid, centre_mm: tuple[float, float], height: Field, *, fine: bool = False
    ) -> Float32[Array, "a b"]:
        """Return the height of the skin on every line of sight.

        centre_mm: where the middle of the grid lies on the sensor. fine: refine the height before interpolation.
        """
        stretch = self._stretch(grid, centre_mm, height)
        at = grid_coordinates(grid, centre_mm, self.x_mm * stretch, self.y_mm * stretch, REFINEMENT if fine else 1)
        return sample_periodic(refine_fields(grid, height)[0] if fine else height, *at)

    def _stretch(self, grid: PeriodicGrid, centre_mm: tuple[float, float], height: Field) -> Float32[Array, "a b"]:
        """Return 1 + u/D: how many times farther from the middle than on the plane each line meets the skin."""
        stretch = np.ones_like(self.x_mm)
        for _ in range(FIXED_POINT_STEPS if self.inverse_distance_per_mm else 0):
            at = grid_coordinates(grid, centre_mm, self.x_mm * stretch, self.y_mm * stretch)
            stretch = 1 + np.float32(self.inverse_distance_per_mm) * sample_periodic(height, *at)
        return stretch


def grid_coordinates(
    grid: PeriodicGrid, centre_mm: tuple[float, float], x_mm: Array, y_mm: Array, finer: int = 1
) -> tuple[Array, Array]:
    """Return columns and rows of a grid, or of one `finer` times as fine, at positions on the sensor."""
    per_mm = np.float32(finer / grid.pitch_mm)
    cols = (x_mm - np.float32(centre_mm[0])) * per_mm + np.float32((grid.cols - 1) / 2 * finer)
    rows = (y_mm - np.float32(centre_mm[1])) * per_mm + np.float32((grid.rows - 1) / 2 * finer)
    return cols, rows


def sample_periodic(field: Float32[Array, "rows cols"], cols: Array, rows: Array) -> Array:
    """Return a periodic field at these columns and rows by linear interpolation."""
    return np.asarray(cv2.remap(field, cols, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))


def refine_fields(grid: PeriodicGrid, *fields: Field) -> FineFields:
    """Return fields on a grid `REFINEMENT` times as fine, interpolated by their waves."""
    return blur_and_refine_fields(grid, 0.0, *fields)


def blur_and_refine_fields(grid: PeriodicGrid, sigma_mm: float, *fields: Field) -> FineFields:
    """Return fields through a Gaussian point spread on a grid `REFINEMENT` times as fine; exact and periodic."""
    from scipy.fft import irfft2, rfft2

    wave = rfft2(np.stack(fields)) * np.float32(REFINEMENT**2)
    if sigma_mm:
        kx, ky = grid.wave_vectors
        wave = wave * np.exp(-(sigma_mm**2) / 2 * (kx**2 + ky**2)).astype(np.float32)
    fine = pad_spectrum(wave, grid)
    return np.asarray(irfft2(fine, s=(grid.rows * REFINEMENT, grid.cols * REFINEMENT)), np.float32)


def pad_spectrum(wave: Any, grid: PeriodicGrid) -> Any:
    """Return a transform with zeros where the finer grid has waves that the grid has not, in the library of the transform."""
    upper, half = (grid.rows + 1) // 2, wave.shape[-1]
    shape = (*wave.shape[:-2], grid.rows * REFINEMENT, grid.cols * REFINEMENT // 2 + 1)
    padded = array_namespace_of(wave).zeros(shape, dtype=wave.dtype, device=device(wave))
    padded[..., :upper, :half] = wave[..., :upper, :]
    padded[..., upper - grid.rows :, :half] = wave[..., upper:, :]
    return padded

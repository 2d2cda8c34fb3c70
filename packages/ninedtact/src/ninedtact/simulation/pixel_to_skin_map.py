"""The pixel map and the lines of sight: which point of the skin each pixel of the raw image sees.

`PixelToSkinMap` holds the position on the undeformed skin that each raw pixel sees, which is the inverse of the rectification;
`WideAngleLens` computes it from a lens model.

`SightlineGrid` follows the lines of sight to skin that is not flat. A line of sight through P on the undeformed plane meets
skin of height u at P(1 + u/D), where D is the viewing distance; deep skin therefore appears displaced outwards. The image on
the plane is then blurred by scattering.

Between its points the skin is linear everywhere, in images as in the heights that they are compared with. A Fourier series would
be 3 µm nearer to a ball of 4 mm radius, but overshoots at the rim of a flat object by up to a tenth of its depth. Only the blurred
image is band-limited, so it is refined by its Fourier series.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from array_api_compat import device
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of
from ninedtact.mechanics.skin import PeriodicGrid

STEP_PX = 8
"""Spacing of the pixels at which positions are computed. Lenses are smooth: cubic interpolation between them errs by less than 1
µm."""


@dataclass(frozen=True)
class PixelToSkinMap:
    """The position (x, y) in mm on the undeformed skin that each raw pixel sees."""

    plane_mm: Float32[Array, "raw_rows raw_cols 2"]

    @property
    def raw_shape(self) -> tuple[int, int]:
        """The (rows, cols) of the raw image."""
        rows, cols = self.plane_mm.shape[:2]
        return rows, cols

    @cached_property
    def reach_mm(self) -> tuple[float, float]:
        """The largest |x| and the largest |y| in view."""
        x, y = np.abs(self.plane_mm).reshape(-1, 2).max(axis=0)
        return float(x), float(y)


@dataclass(frozen=True)
class WideAngleLens:
    """An inverse model of a wide-angle lens, from raw pixels to mm on the skin: a polynomial in the radius, and a tilt.

    Lengths in the image are in units of half its longer side. Defaults are the mean of three real sensors, which the model
    follows to 0.05 mm.
    """

    mm_per_unit: float = 16.2
    """Scale at the optical axis."""
    radial: tuple[float, float] = (-0.41, 0.207)
    """Coefficients of the second and the fourth power of the radius."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Point at which the optical axis meets the image."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """Perspective: relative change of scale per unit along x and y."""
    turn_rad: float = 0.0
    """Rotation about the optical axis."""
    offset_mm: tuple[float, float] = (0.0, 0.0)
    """Position of the skin's centre."""

    def pixel_map(self, raw_shape: tuple[int, int] = (480, 640)) -> PixelToSkinMap:
        """Return the position that every pixel of an image of this (rows, cols) sees."""
        x, y = _normalised_pixel_coordinates(raw_shape)
        x, y = x - self.centre[0], y - self.centre[1]
        square = x**2 + y**2
        grown = self.mm_per_unit * (1 + self.radial[0] * square + self.radial[1] * square**2)
        grown = grown / (1 + self.tilt[0] * x + self.tilt[1] * y)
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        plane = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) * grown[..., None] + self.offset_mm
        return PixelToSkinMap(plane.astype(np.float32))


def _normalised_pixel_coordinates(
    raw_shape: tuple[int, int],
) -> tuple[Float[Array, "rows cols"], Float[Array, "rows cols"]]:
    """Return x and y of every pixel from the image centre, in units of half the longer side."""
    rows, cols = raw_shape
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    unit = max(rows, cols) / 2
    return (x - (cols - 1) / 2) / unit, (y - (rows - 1) / 2) / unit


def coarse_pixel_grid(raw_shape: tuple[int, int]) -> Float[Array, "n 2"]:
    """Return the coarse grid of pixels (x, y), row by row, from whose positions `interpolate_pixel_map` finds all others."""
    y, x = np.meshgrid(*(np.arange(0, side + STEP_PX, STEP_PX) for side in raw_shape), indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()]).astype(float)


def interpolate_pixel_map(plane_mm: Float[Array, "n 2"], raw_shape: tuple[int, int]) -> PixelToSkinMap:
    """Return the pixel map of a raw image of (rows, cols) from the positions of its `coarse_pixel_grid`."""
    from scipy.ndimage import map_coordinates  # slow to import

    rows, cols = (len(range(0, side + STEP_PX, STEP_PX)) for side in raw_shape)
    coarse = plane_mm.reshape(rows, cols, 2)
    pixel = np.mgrid[0 : raw_shape[0], 0 : raw_shape[1]] / STEP_PX
    axes = [map_coordinates(coarse[..., axis], pixel, order=3, mode="nearest") for axis in range(2)]
    return PixelToSkinMap(np.stack(axes, axis=-1).astype(np.float32))


FIXED_POINT_STEPS = 3
"""Iterations that find where a line of sight meets the skin; each reduces the error by a factor of slope · position/D, under
0.4."""
REFINEMENT = 3
"""Factor by which a field is refined before it is interpolated."""

Field = Float32[Array, "rows cols"]
FineFields = Float32[Array, "n fine_rows fine_cols"]


@dataclass(frozen=True)
class SightlineGrid:
    """Lines of sight through a grid of points of the undeformed plane, in mm, on which the skin is found.

    The eye is at a distance D below; the inverse distance is 1/D.
    """

    x_mm: Float32[Array, "a b"]
    y_mm: Float32[Array, "a b"]
    inverse_distance_per_mm: float

    def sample(
        self, grid: PeriodicGrid, centre_mm: tuple[float, float], height: Field, field: Field
    ) -> Float32[Array, "a b"]:
        """Return a field of the skin, such as its height, where every line of sight meets it.

        centre_mm: where the middle of the grid lies on the sensor.
        """
        stretch = self._stretch(grid, centre_mm, height)
        return sample_periodic(
            field, *grid_indices_at_positions(grid, centre_mm, self.x_mm * stretch, self.y_mm * stretch)
        )

    def _stretch(self, grid: PeriodicGrid, centre_mm: tuple[float, float], height: Field) -> Float32[Array, "a b"]:
        """Return 1 + u/D: the factor by which each line meets the skin farther from the middle than it meets the plane."""
        stretch = np.ones_like(self.x_mm)
        for _ in range(FIXED_POINT_STEPS if self.inverse_distance_per_mm else 0):
            at = grid_indices_at_positions(grid, centre_mm, self.x_mm * stretch, self.y_mm * stretch)
            stretch = 1 + np.float32(self.inverse_distance_per_mm) * sample_periodic(height, *at)
        return stretch


def grid_indices_at_positions(
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


def blur_and_refine_fields(grid: PeriodicGrid, sigma_mm: float, *fields: Field) -> FineFields:
    """Return fields through a Gaussian point spread on a grid `REFINEMENT` times as fine; exact and periodic."""
    from scipy.fft import irfft2, rfft2

    wave = rfft2(np.stack(fields)) * np.float32(REFINEMENT**2)
    if sigma_mm:
        kx, ky = grid.wave_vectors
        wave = wave * np.exp(-(sigma_mm**2) / 2 * (kx**2 + ky**2)).astype(np.float32)
    fine = zero_pad_spectrum(wave, grid)
    return np.asarray(irfft2(fine, s=(grid.rows * REFINEMENT, grid.cols * REFINEMENT)), np.float32)


def zero_pad_spectrum(wave: Any, grid: PeriodicGrid) -> Any:
    """Return a transform with zeros for the waves that only the finer grid has, in the library of the transform."""
    upper, half = (grid.rows + 1) // 2, wave.shape[-1]
    shape = (*wave.shape[:-2], grid.rows * REFINEMENT, grid.cols * REFINEMENT // 2 + 1)
    padded = array_namespace_of(wave).zeros(shape, dtype=wave.dtype, device=device(wave))
    padded[..., :upper, :half] = wave[..., :upper, :]
    padded[..., upper - grid.rows :, :half] = wave[..., upper:, :]
    # The highest wave of an even side stands for both signs of its frequency, which the finer grid tells apart.
    if grid.rows % 2 == 0:
        padded[..., -upper, :half] /= 2
        padded[..., upper, :half] = padded[..., -upper, :half]
    if grid.cols % 2 == 0:
        padded[..., half - 1] /= 2
    return padded

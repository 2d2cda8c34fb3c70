"""The point of the undeformed skin that each pixel of the raw image sees: the inverse of the rectification."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from scipy.ndimage import map_coordinates

STEP_PX = 8
"""Spacing of the pixels at which positions are computed. Lenses are smooth: a cubic in between errs by less than 1 µm."""


@dataclass(frozen=True)
class PixelMap:
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

    def pixel_map(self, raw_shape: tuple[int, int] = (480, 640)) -> PixelMap:
        """Return the position that every pixel of an image of this (rows, cols) sees."""
        x, y = _normalised_pixel_coordinates(raw_shape)
        x, y = x - self.centre[0], y - self.centre[1]
        square = x**2 + y**2
        grown = self.mm_per_unit * (1 + self.radial[0] * square + self.radial[1] * square**2)
        grown = grown / (1 + self.tilt[0] * x + self.tilt[1] * y)
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        plane = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) * grown[..., None] + self.offset_mm
        return PixelMap(plane.astype(np.float32))


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


def interpolate_pixel_map(plane_mm: Float[Array, "n 2"], raw_shape: tuple[int, int]) -> PixelMap:
    """Return the pixel map of a raw image of (rows, cols) from the positions of its `coarse_pixel_grid`."""
    rows, cols = (len(range(0, side + STEP_PX, STEP_PX)) for side in raw_shape)
    coarse = plane_mm.reshape(rows, cols, 2)
    pixel = np.mgrid[0 : raw_shape[0], 0 : raw_shape[1]] / STEP_PX
    axes = [map_coordinates(coarse[..., axis], pixel, order=3, mode="nearest") for axis in range(2)]
    return PixelMap(np.stack(axes, axis=-1).astype(np.float32))

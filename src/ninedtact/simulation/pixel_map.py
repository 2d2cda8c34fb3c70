"""Where on the skin's plane each pixel of the raw image looks: the rectification read backwards."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from scipy.ndimage import map_coordinates

STEP_PX = 8
"""Between pixels whose place is computed; lenses are smooth, a cubic between them errs by less than a micrometre."""


@dataclass(frozen=True)
class PixelMap:
    """The place (x, y) in mm that each raw pixel sees on the untouched skin."""

    plane_mm: Float32[Array, "raw_rows raw_cols 2"]

    @property
    def raw_shape(self) -> tuple[int, int]:
        """(rows, cols) of the raw image."""
        rows, cols = self.plane_mm.shape[:2]
        return rows, cols

    @cached_property
    def reach_mm(self) -> tuple[float, float]:
        """Largest |x| and |y| in view."""
        x, y = np.abs(self.plane_mm).reshape(-1, 2).max(axis=0)
        return float(x), float(y)


@dataclass(frozen=True)
class WideAngleLens:
    """A wide-angle lens read backwards, from raw pixels to mm on the skin: polynomial in the radius, after a tilt.

    Lengths in the image are in units of half its long side. Defaults are the mean of three real sensors, which it follows
    to 0.05 mm.
    """

    mm_per_unit: float = 16.2
    """Scale at the optical axis."""
    radial: tuple[float, float] = (-0.41, 0.207)
    """Growth with the second and fourth power of the radius."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Where the optical axis meets the image."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """Perspective: relative change of scale per unit along x and y."""
    turn_rad: float = 0.0
    """About the optical axis."""
    offset_mm: tuple[float, float] = (0.0, 0.0)
    """Of the skin's centre."""

    def view(self, raw_shape: tuple[int, int] = (480, 640)) -> PixelMap:
        """Where every pixel of an image of this size looks."""
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
    """x and y of every pixel from the middle, in units of half the long side."""
    rows, cols = raw_shape
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    unit = max(rows, cols) / 2
    return (x - (cols - 1) / 2) / unit, (y - (rows - 1) / 2) / unit


def coarse_pixel_grid(raw_shape: tuple[int, int]) -> Float[Array, "n 2"]:
    """Pixels (x, y) at which it is enough to know where they look; rows of them, `interpolate_pixel_map` puts the rest between."""
    y, x = np.meshgrid(*(np.arange(0, side + STEP_PX, STEP_PX) for side in raw_shape), indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()]).astype(float)


def interpolate_pixel_map(plane_mm: Float[Array, "n 2"], raw_shape: tuple[int, int]) -> PixelMap:
    """The view of every pixel, from that of the coarse ones."""
    rows, cols = (len(range(0, side + STEP_PX, STEP_PX)) for side in raw_shape)
    coarse = plane_mm.reshape(rows, cols, 2)
    pixel = np.mgrid[0 : raw_shape[0], 0 : raw_shape[1]] / STEP_PX
    axes = [map_coordinates(coarse[..., axis], pixel, order=3, mode="nearest") for axis in range(2)]
    return PixelMap(np.stack(axes, axis=-1).astype(np.float32))

"""The grid that tractions are inverted on: square cells of about half a millimetre over the image and some skin around it.

Fields of the view have the shape (rows, cols). Fields of the skin are larger and periodic: their first rows and columns are the
view, the next ones are skin below (right of) it, and the last ones, wrapped around, are skin above (left of) it.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.mechanics.periodic_grid import PeriodicGrid
from ninedtact.quantities import centred_axis_mm

MARGIN_CELLS = 1
"""Cells beyond each side of the image where pressure may also act: near the border, pressed-in skin appears displaced outwards, out
of the image."""

_LARGEST_PITCH_MM = 0.7
"""Largest pitch of the cells. Features of contacts are hardly narrower, and finer cells would resolve no more, because light
scatters over about this distance."""
_SURROUNDINGS_MM = 3.3
"""Width of the skin beyond the view that is modelled, because it scatters light into the view and separates the contact from its
periodic images."""


@dataclass(frozen=True)
class CellGrid:
    """A view of (rows, cols) square cells: the image, and `MARGIN_CELLS` cells around it."""

    rows: int
    cols: int
    pitch_mm: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the view."""
        return self.rows, self.cols

    @property
    def image_shape(self) -> tuple[int, int]:
        """Rows and columns of the part that is on the image."""
        return self.rows - 2 * MARGIN_CELLS, self.cols - 2 * MARGIN_CELLS

    @property
    def on_image(self) -> Float32[Array, "rows cols"]:
        """One on the cells of the image, zero on the margin."""
        return np.pad(np.ones(self.image_shape, np.float32), MARGIN_CELLS)

    @cached_property
    def patch(self) -> PeriodicGrid:
        """The periodic skin, larger than the view."""
        from scipy.fft import next_fast_len

        around = 2 * int(np.ceil(_SURROUNDINGS_MM / self.pitch_mm))
        rows, cols = (next_fast_len(side + around, real=True) for side in self.shape)
        return PeriodicGrid(rows, cols, self.pitch_mm)

    @cached_property
    def axes_mm(self) -> tuple[Float32[Array, " cols"], Float32[Array, " rows"]]:
        """Coordinates x of the columns and y of the rows of the view."""
        return centred_axis_mm(self.cols, self.pitch_mm), centred_axis_mm(self.rows, self.pitch_mm)

    @cached_property
    def coordinates_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """Coordinates x and y of every cell of the view."""
        x, y = np.meshgrid(*self.axes_mm)
        return x, y

    def offsets(self, axis: int) -> Float[Array, " skin"]:
        """Return the index along one axis of the skin, counted from the view's first cell; negative for skin that is wrapped
        around."""
        view, skin = self.shape[axis], self.patch.shape[axis]
        index = np.arange(skin)
        return np.where(index < view + (skin - view) // 2, index, index - skin).astype(float)

    def average(self, field: Float32[Array, "a b"]) -> Float32[Array, "rows cols"]:
        """Return the means of an image's field over the cells; on the margin the border of the image is repeated."""
        down, across = (_averaging_weights(*sides) for sides in zip(field.shape, self.image_shape, strict=True))
        return down @ field @ across.T


def cell_grid_over_image(shape: tuple[int, int], mm_per_px: float) -> CellGrid:
    """Return the cells over an image of this shape (rows, cols), none longer than about 0.7 mm."""
    rows, cols = (max(8, int(np.ceil(side * mm_per_px / _LARGEST_PITCH_MM))) for side in shape)
    pitch_mm = float(np.sqrt(shape[0] * shape[1] / (rows * cols)) * mm_per_px)
    return CellGrid(rows + 2 * MARGIN_CELLS, cols + 2 * MARGIN_CELLS, pitch_mm)


@lru_cache(maxsize=16)
def _averaging_weights(pixels: int, cells: int) -> Float32[Array, "view pixels"]:
    """Return the weight of each pixel in the mean of each cell, along one axis."""
    ends = np.arange(cells + 1) * (pixels / cells)
    until = np.clip(ends[:, None] - np.arange(pixels), 0, 1)
    inside = np.diff(until, axis=0) * (cells / pixels)
    return np.pad(inside, ((MARGIN_CELLS, MARGIN_CELLS), (0, 0)), mode="edge").astype(np.float32)

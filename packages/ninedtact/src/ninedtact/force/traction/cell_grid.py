"""The grid that tractions are inverted on: square cells of about half a millimetre over the image and some skin around it.

The cells follow the gel: a thin gel transmits finer structure of a contact than a thick one. The observed signal is compared with
the predicted one on the same cells.

Fields of the view have the shape (rows, cols). Fields of the skin are larger and periodic: their first rows and columns are the
view, the next ones are skin below (right of) it, and the last ones, wrapped around, are skin above (left of) it.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.mechanics.skin import PeriodicGrid
from ninedtact.quantities import centred_axis_mm

MARGIN_CELLS = 1
"""Cells beyond each side of the image where pressure may also act: near the border, pressed-in skin appears displaced outwards, out
of the image."""

_PITCH_PER_THICKNESS = 0.35
"""Pitch of the cells over the gel's thickness."""
_PITCH_LIMITS_MM = 0.5, 0.7
"""Smallest and largest pitch of the cells: the time of an inversion grows with their number."""
_MIN_CELLS = 8
"""Smallest number of cells along the shorter side of an image."""
_SURROUNDINGS_MM = 3.3
"""Width of the skin beyond the view that is modelled, because it scatters light into the view and separates the contact from its
periodic images."""


@dataclass(frozen=True)
class CellGrid:
    """A view of (rows, cols) square cells about the middle of an image, which covers the image and `MARGIN_CELLS` cells around it.

    The cells fit the image exactly along one axis at least; along the other one the outermost may lie up to half outside it.
    """

    rows: int
    cols: int
    pitch_mm: float
    """Side of a cell."""
    mm_per_px: float
    """Pixel pitch of the image."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the view."""
        return self.rows, self.cols

    @property
    def image_shape(self) -> tuple[int, int]:
        """Rows and columns of the part that is on the image."""
        return self.rows - 2 * MARGIN_CELLS, self.cols - 2 * MARGIN_CELLS

    @cached_property
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
        """Return the means of an image's field over the part of each cell that is on the image; the outermost ones are repeated on
        the margin."""
        px_per_cell = self.pitch_mm / self.mm_per_px
        sides = zip(field.shape, self.image_shape, strict=True)
        down, across = (_averaging_weights(pixels, cells, px_per_cell) for pixels, cells in sides)
        return down @ field @ across.T


def cell_grid_over_image(shape: tuple[int, int], mm_per_px: float, thickness_mm: float) -> CellGrid:
    """Return the cells over an image of this shape (rows, cols), as fine as a gel of this thickness needs."""
    largest_mm = float(np.clip(_PITCH_PER_THICKNESS * thickness_mm, *_PITCH_LIMITS_MM))
    sides_mm = [side * mm_per_px for side in shape]
    largest_mm = min(largest_mm, min(sides_mm) / _MIN_CELLS)
    pitch_mm = max(side_mm / _count_to_cover(side_mm, largest_mm) for side_mm in sides_mm)
    rows, cols = (_count_to_cover(side_mm, pitch_mm) for side_mm in sides_mm)
    return CellGrid(rows + 2 * MARGIN_CELLS, cols + 2 * MARGIN_CELLS, pitch_mm, mm_per_px)


def _count_to_cover(side_mm: float, pitch_mm: float) -> int:
    """Return the number of cells that cover a side; a side that they fit exactly needs no more of them because of rounding."""
    return int(np.ceil(side_mm / pitch_mm - 1e-9))


@lru_cache(maxsize=16)
def _averaging_weights(pixels: int, cells: int, px_per_cell: float) -> Float32[Array, "view pixels"]:
    """Return the weight of each pixel in the mean of each cell, along one axis; the cells lie about the middle of the pixels."""
    ends = pixels / 2 + (np.arange(cells + 1) - cells / 2) * px_per_cell
    inside = np.diff(np.clip(ends[:, None] - np.arange(pixels), 0, 1), axis=0)
    weights = inside / inside.sum(axis=1, keepdims=True)
    return np.pad(weights, ((MARGIN_CELLS, MARGIN_CELLS), (0, 0)), mode="edge").astype(np.float32)

"""The grid that tractions are read on: about half a millimetre, over the image that is seen and some skin around it.

Fields of the view are (rows, cols). Fields of the skin are larger and periodic: the view is their first rows and columns,
what follows is skin below (right of) the view, then, wrapped around, skin above (left of) it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.mechanics.periodic_grid import PeriodicGrid
from ninedtact.quantities import centred_axis_mm

COARSEST_MM = 0.7
"""Contacts have parts that are hardly wider; light scatters as far, so finer cells would not see more."""
AROUND_MM = 3.3
"""Skin beyond the view that scatters light into it, and that keeps periodic images of the contact away."""
BEYOND = 1
"""Cells on every side beyond the image where pressure may be, too: near its border, skin that is pressed in is seen displaced
outwards, out of the image."""


@dataclass(frozen=True)
class Cells:
    """A view of (rows, cols) square cells: the image, and `BEYOND` cells around it."""

    rows: int
    cols: int
    pitch_mm: float

    @property
    def shape(self) -> tuple[int, int]:
        """Of the view."""
        return self.rows, self.cols

    @property
    def image_shape(self) -> tuple[int, int]:
        """Of the part that is on the image."""
        return self.rows - 2 * BEYOND, self.cols - 2 * BEYOND

    @cached_property
    def patch(self) -> PeriodicGrid:
        """The periodic skin."""
        from scipy.fft import next_fast_len

        around = 2 * int(np.ceil(AROUND_MM / self.pitch_mm))
        rows, cols = (next_fast_len(side + around, real=True) for side in self.shape)
        return PeriodicGrid(rows, cols, self.pitch_mm)

    @cached_property
    def axes_mm(self) -> tuple[Float32[Array, " cols"], Float32[Array, " rows"]]:
        """x of the columns and y of the rows of the view."""
        return centred_axis_mm(self.cols, self.pitch_mm), centred_axis_mm(self.rows, self.pitch_mm)

    @cached_property
    def places_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of every cell of the view."""
        x, y = np.meshgrid(*self.axes_mm)
        return x, y

    def offsets(self, axis: int) -> Float[Array, " skin"]:
        """Index along one axis of the skin, below zero for what is wrapped around."""
        view, skin = self.shape[axis], self.patch.shape[axis]
        index = np.arange(skin)
        return np.where(index < view + (skin - view) // 2, index, index - skin).astype(float)


def cells_over(shape: tuple[int, int], mm_per_px: float) -> Cells:
    """Cells over an image of this shape, none longer than about `COARSEST_MM`."""
    rows, cols = (max(8, int(np.ceil(side * mm_per_px / COARSEST_MM))) for side in shape)
    return Cells(rows + 2 * BEYOND, cols + 2 * BEYOND, float(np.sqrt(shape[0] * shape[1] / (rows * cols)) * mm_per_px))

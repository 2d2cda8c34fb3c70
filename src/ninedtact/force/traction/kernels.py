"""What one cell's traction does to every other cell, as windows into one array: made once for a sensor."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Int
from numpy import ndarray as Array
from numpy.lib.stride_tricks import sliding_window_view

from ninedtact.force.traction.forward import Forward
from ninedtact.force.traction.prior import Prior, stiffness

Cells1 = Int[Array, " n"]

REACH = 3.0
"""Standard deviations of scattering from which light still comes into the view."""


@dataclass(frozen=True)
class Kernels:
    """Of the view's cells, on the skin that shines into the view: the view, and some around it."""

    forward: Forward
    prior: Prior

    @cached_property
    def around(self) -> tuple[int, int]:
        """Cells of that skin above (left of) the view."""
        cells = self.forward.cells
        wanted = int(np.ceil(REACH * self.forward.point_spread_mm / cells.pitch_mm))
        down, across = (
            min(wanted, (skin - view) // 2) for skin, view in zip(cells.patch.shape, cells.shape, strict=True)
        )
        return down, across

    @cached_property
    def cell_of(self) -> tuple[Int[Array, " rows"], Int[Array, " cols"]]:
        """Rows and columns of the periodic skin, in the order of space."""
        cells = self.forward.cells
        down, across = (
            np.arange(-beyond, view + beyond) % skin
            for beyond, view, skin in zip(self.around, cells.shape, cells.patch.shape, strict=True)
        )
        return down, across

    @property
    def skin_shape(self) -> tuple[int, int]:
        """Of that skin."""
        return len(self.cell_of[0]), len(self.cell_of[1])

    def of(self, row: Cells1, col: Cells1) -> list[Float32[Array, "n skin_rows skin_cols"]]:
        """Height of that skin by unit pressure, shear along x and along y on each of these cells."""
        at = self.window(row, col)
        return [windows[at] for windows in self.heights]

    def stiffness_of(self, row: Cells1, col: Cells1) -> Float32[Array, "n rows cols"]:
        """Precision of pressure between each of these cells and all of the view, for an indentation of 1 mm."""
        return self.stiffness[self.window(row, col)]

    def window(self, row: Cells1, col: Cells1) -> tuple[Cells1, Cells1]:
        """Which window is theirs: the first is the last cell's."""
        rows, cols = self.forward.cells.shape
        return rows - 1 - row, cols - 1 - col

    @cached_property
    def heights(self) -> list[Float32[Array, "rows cols skin_rows skin_cols"]]:
        """Pressure's, shear's along x and along y, as windows."""
        return [self.windows(symbol, self.around) for symbol in self.forward.symbols]

    @cached_property
    def stiffness(self) -> Float32[Array, "rows cols rows cols"]:
        """The prior's, as windows."""
        return self.windows(stiffness(self.forward.wave, self.prior, self.forward.cells.pitch_mm), (0, 0))

    def windows(self, symbol: Array, around: tuple[int, int]) -> Array:
        """A symbol in space; every window is what one cell does."""
        skin, view = self.forward.cells.patch.shape, self.forward.cells.shape
        kernel = np.fft.irfft2(symbol, s=skin).astype(np.float32)
        down, across = (np.arange(1 - side - beyond, side + beyond) for side, beyond in zip(view, around, strict=True))
        shape = view[0] + 2 * around[0], view[1] + 2 * around[1]
        return sliding_window_view(kernel[np.ix_(down % skin[0], across % skin[1])], shape)

    @cached_property
    def spreads(self) -> tuple[Float32[Array, "rows skin_rows"], Float32[Array, "skin_cols cols"]]:
        """Scattering from that skin into the view."""
        (down, across), (rows, cols) = self.forward.spreads, self.cell_of
        return np.ascontiguousarray(down[:, rows]), np.ascontiguousarray(across[cols])

    def on_skin(self, field: Float32[Array, "a b"]) -> Float32[Array, "skin_rows skin_cols"]:
        """A field of the periodic skin there, in the order of space."""
        return field[np.ix_(*self.cell_of)]

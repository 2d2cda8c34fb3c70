"""The same problem on blocks of 2 x 2 cells, small enough to be solved outright.

It makes the search on the cells quick (as a preconditioner), and its curvature is the answer's covariance.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Int
from numpy import ndarray as Array
from numpy.lib.stride_tricks import sliding_window_view

from ninedtact.force.traction.cells import PER_BLOCK
from ninedtact.force.traction.forward import Forward, View
from ninedtact.force.traction.prior import Prior, ShearModes, stiffness

CELLS_OF_BLOCK = PER_BLOCK**2
TRIANGLE = np.array([1.0, 2.0, 1.0]) / 2
"""Two cells of a block against two of another: how often each offset occurs, over two."""


@dataclass(frozen=True)
class Blocks:
    """Kernels between blocks, made once for a sensor."""

    forward: Forward
    modes: ShearModes
    prior: Prior

    @property
    def shape(self) -> tuple[int, int]:
        """Blocks of the view."""
        rows, cols = self.forward.cells.shape
        return rows // PER_BLOCK, cols // PER_BLOCK

    @cached_property
    def around(self) -> tuple[int, int]:
        """Blocks of skin above (left of) the view."""
        skin, view = self.forward.cells.patch.shape, self.forward.cells.shape
        return (skin[0] - view[0]) // (2 * PER_BLOCK), (skin[1] - view[1]) // (2 * PER_BLOCK)

    @cached_property
    def skin_shape(self) -> tuple[int, int]:
        """Blocks of the view and around it."""
        return self.shape[0] + 2 * self.around[0], self.shape[1] + 2 * self.around[1]

    @cached_property
    def cell_of(self) -> tuple[Int[Array, " rows"], Int[Array, " cols"]]:
        """Rows and columns of the periodic skin, in the order of space, two for each block."""
        return tuple(  # type: ignore[return-value]
            np.arange(-PER_BLOCK * beyond, side + PER_BLOCK * beyond) % skin
            for beyond, side, skin in zip(
                self.around, self.forward.cells.shape, self.forward.cells.patch.shape, strict=True
            )
        )

    @cached_property
    def kernels(self) -> list[Float32[Array, "rows cols skin_rows skin_cols"]]:
        """Height of all skin by unit pressure, shear along x and along y on the block (−row, −column), as windows."""
        return [self.windows(symbol, self.around, self.skin_shape) for symbol in self.forward.symbols]

    @cached_property
    def stiffness(self) -> Float32[Array, "rows cols rows cols"]:
        """Precision of pressure between blocks, for an indentation of 1 mm."""
        wave = stiffness(self.forward.wave, self.prior, self.forward.cells.pitch_mm)
        return np.float32(PER_BLOCK**2) * self.windows(wave, (0, 0), self.shape)

    def windows(self, symbol: Array, around: tuple[int, int], shape: tuple[int, int]) -> Array:
        """A symbol as a kernel between blocks: mean over the cells of one, sum over those of the other."""
        skin = self.forward.cells.patch.shape
        kernel = np.fft.irfft2(symbol, s=skin)
        offsets = [
            PER_BLOCK * np.arange(1 - side - beyond, side + beyond)
            for side, beyond in zip(self.shape, around, strict=True)
        ]
        total = np.zeros((len(offsets[0]), len(offsets[1])))
        for row, down in zip((-1, 0, 1), TRIANGLE, strict=True):
            for col, across in zip((-1, 0, 1), TRIANGLE, strict=True):
                total += down * across * kernel[np.ix_((offsets[0] + row) % skin[0], (offsets[1] + col) % skin[1])]
        return sliding_window_view(total.astype(np.float32), shape)

    @cached_property
    def spreads(self) -> tuple[Float32[Array, "rows skin_rows"], Float32[Array, "skin_cols cols"]]:
        """Scattering between blocks."""
        down, across = self.forward.spreads
        rows, cols = self.cell_of
        return halved(down[:, rows]), halved(across[cols])

    def of_skin(self, skin: Float32[Array, "skin_rows skin_cols"]) -> Float32[Array, "rows cols"]:
        """Means over the blocks in the order of space."""
        rows, cols = self.cell_of
        return mean_of_blocks(skin[np.ix_(rows, cols)])


def halved(spread: Float32[Array, "a b"]) -> Float32[Array, "c d"]:
    """A scattering matrix between blocks: mean over what is seen, sum over what shines."""
    return mean_of_blocks(spread) * np.float32(PER_BLOCK)


def mean_of_blocks(field: Float32[Array, "*n rows cols"]) -> Float32[Array, "*n half_rows half_cols"]:
    """Means over 2 x 2 cells."""
    *batch, rows, cols = field.shape
    parts = field.reshape(*batch, rows // PER_BLOCK, PER_BLOCK, cols // PER_BLOCK, PER_BLOCK)
    return np.asarray(parts.mean(axis=(-3, -1)))


def on_cells(blocks: Float32[Array, "half_rows half_cols"]) -> View:
    """Every block's value on its cells."""
    return np.repeat(np.repeat(blocks, PER_BLOCK, axis=0), PER_BLOCK, axis=1)

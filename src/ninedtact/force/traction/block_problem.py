"""The coarse problem of one touch, linearised and factored."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray as Array

from ninedtact.force.traction.blocks import Blocks, mean_of_blocks
from ninedtact.force.traction.forward import View
from ninedtact.force.traction.weigh import Weigh

LEAST_CARRIED = 0.01
"""Of the strongest mode's square; weaker ones are left to their prior."""


@dataclass(frozen=True)
class BlockProblem:
    """The blocks under one touch, linearised."""

    row: Int[Array, " n"]
    col: Int[Array, " n"]
    columns: Float32[Array, "unknowns seen"]
    """What each unknown does to what is seen, over its standard deviation: pressures, then shear along x, along y."""
    kept: Int[Array, " modes"]
    """Modes that matter here."""
    carried: Float32[Array, "n modes"]
    """Shear of each mode."""
    factor: Float[Array, "unknowns unknowns"]
    """Cholesky's, lower, of the curvature."""

    def solved(self, right: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Curvature⁻¹ times this."""
        from scipy.linalg import cho_solve

        return np.asarray(cho_solve((self.factor, True), right, check_finite=False))


def block_problem(
    blocks: Blocks, touched: View, carries: View, slope: Array, weigh: Weigh, depth_mm: float
) -> BlockProblem:
    """Linearise: `touched` is one where pressure may be, `carries` the smoothed pressure, `slope` that of the law of light."""
    row, col = np.nonzero(mean_of_blocks(touched) > 0)
    rows, cols = blocks.shape
    carried = blocks.modes.on_blocks[row * cols + col] * mean_of_blocks(carries)[row, col][:, None]
    kept = np.flatnonzero((carried**2).sum(axis=0) > LEAST_CARRIED * max(float((carried**2).sum(axis=0).max()), 1e-12))
    carried = carried[:, kept]
    pressed, *sheared = (kernel[rows - 1 - row, cols - 1 - col] for kernel in blocks.kernels)
    heights = [pressed, *(np.tensordot(carried.T, each, 1) for each in sheared)]
    columns = np.concatenate([seen(blocks, height, slope, weigh) for height in heights])
    curvature = weigh.gram_on_blocks(columns)
    between = blocks.stiffness[rows - 1 - row, cols - 1 - col][:, row, col]
    curvature[: len(row), : len(row)] += between / depth_mm**2
    diagonal = np.arange(len(row), len(curvature))
    curvature[diagonal, diagonal] += 1
    return BlockProblem(row, col, columns, kept, carried, factored(curvature))


def seen(blocks: Blocks, height: Float32[Array, "n skin_rows skin_cols"], slope: Array, weigh: Weigh) -> Array:
    """Heights of all skin as changes of what is seen, over their standard deviations; flat."""
    down, across = blocks.spreads
    change = down @ (height * slope) @ across
    return (change * weigh.on_blocks).reshape(len(height), -1)


def factored(curvature: Float32[Array, "n n"]) -> Float[Array, "n n"]:
    """Cholesky's lower factor."""
    from scipy.linalg import cholesky

    return np.asarray(cholesky(curvature, lower=True, overwrite_a=True, check_finite=False))

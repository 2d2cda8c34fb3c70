"""One round: the law of light as a straight line about a guess, so that what is left is a quadratic, cell by cell."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int
from numpy import ndarray as Array

from ninedtact.force.traction.forward import Skin, Tractions, View
from ninedtact.force.traction.kernels import Kernels
from ninedtact.force.traction.pivoting import Lowest, Quadratic
from ninedtact.force.traction.prior import ShearModes
from ninedtact.force.traction.weigh import Weigh

LEAST_CARRIED = 0.01
"""Of the strongest mode's square; weaker modes of shear are left out."""
AT_ONCE = 64
"""Cells whose fields are computed together."""


@dataclass(frozen=True)
class Linearised:
    """Where pressure may be, what carries shear, and the straight line of the law at every place.

    Unknowns: pressure on each touched cell, then weights of the modes of shear along x, then along y.
    """

    kernels: Kernels
    modes: ShearModes
    touched: View
    carries: View
    """Smoothed pressure: shear is in proportion to it."""
    slope: Skin
    weigh: Weigh
    depth_mm: float

    @cached_property
    def place(self) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
        """Row and column of the touched cells."""
        row, col = np.nonzero(self.touched)
        return row, col

    @cached_property
    def carried(self) -> Float32[Array, "n modes"]:
        """Shear on each touched cell by each mode that matters here."""
        row, col = self.place
        carried = self.modes.on_cells[row * self.touched.shape[1] + col] * self.carries[row, col][:, None]
        size = (carried**2).sum(axis=0)
        return np.ascontiguousarray(carried[:, size > LEAST_CARRIED * max(float(size.max()), 1e-12)])

    @cached_property
    def columns(self) -> Float32[Array, "unknowns seen"]:
        """What each unknown does to what is seen, over its standard deviation."""
        count, modes = self.carried.shape
        columns = np.empty((count + 2 * modes, self.touched.size), np.float32)
        sheared = np.zeros((2, modes, self.kernels.skin_shape[0] * self.kernels.skin_shape[1]), np.float32)
        for some in self.parts:
            pressed, *shear = self.kernels.of(self.place[0][some], self.place[1][some])
            columns[some] = self.seen(pressed)
            for total, each in zip(sheared, shear, strict=True):
                total += self.carried[some].T @ each.reshape(len(each), -1)
        columns[count:] = self.seen(sheared.reshape(2 * modes, *self.kernels.skin_shape))
        return columns

    @property
    def parts(self) -> list[slice]:
        """Touched cells, so few at a time that their fields stay in the processor's cache."""
        count = len(self.place[0])
        return [slice(first, min(first + AT_ONCE, count)) for first in range(0, count, AT_ONCE)]

    def seen(self, heights: Float32[Array, "n skin_rows skin_cols"]) -> Float32[Array, "n seen"]:
        """What heights of the skin change, over its standard deviation."""
        down, across = self.kernels.spreads
        heights *= self.slope_there
        seen = down @ (heights @ across)
        seen *= self.weigh.per_error
        return seen.reshape(len(seen), -1)

    @cached_property
    def slope_there(self) -> Float32[Array, "skin_rows skin_cols"]:
        """The law's slope on the skin that shines into the view."""
        return self.kernels.on_skin(self.slope)

    @cached_property
    def curvature(self) -> Float64[Array, "unknowns unknowns"]:
        """H: of the misfit, and of what is known of presses."""
        count, curvature = len(self.place[0]), self.weigh.gram(self.columns).astype(float)
        for some in self.parts:
            between = self.kernels.stiffness_of(self.place[0][some], self.place[1][some])
            curvature[some, :count] += between[:, self.place[0], self.place[1]] / self.depth_mm**2
        weights = np.arange(count, len(curvature))
        curvature[weights, weights] += 1
        return curvature

    def downhill(self, seen: View) -> Float64[Array, " unknowns"]:
        """How each unknown would explain this field."""
        return (self.columns @ self.weigh.whitened(seen).ravel()).astype(float)

    def quadratic(self, target: View) -> Quadratic:
        """The problem whose answer explains this change, as a straight line would."""
        return Quadratic(self.curvature, self.downhill(target), len(self.place[0]))

    def free(self, pressure: View) -> Bool[Array, " unknowns"]:
        """Where there was pressure before; and all shear."""
        return np.concatenate([pressure[self.place] > 0, np.ones(2 * self.carried.shape[1], bool)])

    def tractions(self, at: Float[Array, " unknowns"]) -> Tractions:
        """Pressure and shear."""
        row, col = self.place
        found = np.zeros((3, *self.touched.shape), np.float32)
        found[0, row, col] = at[: len(row)]
        found[1:, row, col] = at[len(row) :].reshape(2, -1) @ self.carried.T
        return found

    def off(self, lowest: Lowest, rest: View) -> float:
        """How far the answer would yet go if this were left to explain: no sum of the unknowns by more of its own standard
        deviations (Cauchy and Schwarz)."""
        return float(np.linalg.norm(lowest.sizes(self.downhill(rest)[None])))

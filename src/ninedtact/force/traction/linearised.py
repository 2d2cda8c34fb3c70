"""One round: the law of light as a straight line about a guess, so that what is left is a quadratic."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.force.traction.block_problem import BlockProblem
from ninedtact.force.traction.blocks import CELLS_OF_BLOCK, mean_of_blocks, on_cells
from ninedtact.force.traction.descent import Quadratic, Unknown
from ninedtact.force.traction.forward import Forward, Skin, View
from ninedtact.force.traction.prior import ShearModes
from ninedtact.force.traction.weigh import Weigh
from ninedtact.mechanics.transform import spectrum

SHARP_PER_MM = 2.0
"""Wave number from which blocks are too coarse, and a wave is divided by its own curvature."""


@dataclass(frozen=True)
class Linearised:
    """Where pressure may be, what carries shear, and the straight line of the law at every place."""

    forward: Forward
    modes: ShearModes
    stiffness: Array
    """Of the prior of pressure, here."""
    touched: View
    carries: View
    slope: Skin
    weigh: Weigh
    blocks: BlockProblem

    def quadratic(self, target: View) -> Quadratic:
        """The problem whose answer explains this change, as a straight line would."""
        return Quadratic(self.curvature, self.gradient(self.weigh(target)), self.preconditioned, self.touched)

    def tractions(self, at: Unknown) -> Float32[Array, "3 rows cols"]:
        """Pressure and shear."""
        return np.concatenate([at.pressure[None], self.modes.ratio(at.weights) * self.carries])

    def curvature(self, at: Unknown) -> Unknown:
        """H times this."""
        wave = spectrum(self.tractions(at), self.forward.cells.patch.shape)
        seen = self.forward.scattered(self.forward.raised(wave) * self.slope)
        steep = self.gradient(self.weigh(seen), wave[0] * self.stiffness)
        return Unknown(steep.pressure, steep.weights + at.weights)

    def gradient(self, seen: View, of_pressure: Array | float = 0.0) -> Unknown:
        """What each unknown would do to this field; and one more wave of pressure's."""
        back = self.forward.pulled_back(self.forward.gathered(seen) * self.slope)
        back[0] += of_pressure
        pressure, *shear = self.forward.of_view(back)
        return Unknown(pressure * self.touched, self.modes.weighed(np.stack(shear) * self.carries))

    def preconditioned(self, slope: Unknown) -> Unknown:
        """Blocks are solved outright, and what is finer wave by wave."""
        blocks, row, col = self.blocks, self.blocks.row, self.blocks.col
        pressed = mean_of_blocks(slope.pressure)[row, col] * CELLS_OF_BLOCK
        kept = slope.weights[:, blocks.kept]
        solved = blocks.solved(np.concatenate([pressed, kept.ravel()])).astype(np.float32)
        coarse = np.zeros((slope.pressure.shape[0] // 2, slope.pressure.shape[1] // 2), np.float32)
        coarse[row, col] = solved[: len(row)]
        weights = slope.weights.copy()
        weights[:, blocks.kept] = solved[len(row) :].reshape(kept.shape)
        return Unknown(on_cells(coarse) + self.fine(slope.pressure), weights)

    def fine(self, pressure: View) -> View:
        """Sharp waves over their own curvature, scaled by how well each place is seen."""
        wave = spectrum(pressure / self.local, self.forward.cells.patch.shape) * self.sharp
        return self.forward.of_view(wave) / self.local

    @cached_property
    def local(self) -> View:
        """Slope over error, place by place."""
        rows, cols = self.touched.shape
        steep = np.abs(self.slope[:rows, :cols]) * self.weigh.per_error
        mean = float(steep[self.touched > 0].mean()) if self.touched.any() else 1.0
        return np.maximum(steep, np.float32(max(0.2 * mean, 1e-9)))

    @cached_property
    def sharp(self) -> Array:
        """One over the curvature of a wave, none for long ones."""
        forward, strength = self.forward, float((self.local[self.touched > 0] ** 2).mean())
        light = np.exp(-((forward.wave * forward.scattering_mm) ** 2))
        curvature = np.abs(forward.symbols[0]) ** 2 * light + self.stiffness / strength
        ratio = (forward.wave / SHARP_PER_MM) ** 4
        return (ratio / (1 + ratio) / curvature).astype(np.float32)

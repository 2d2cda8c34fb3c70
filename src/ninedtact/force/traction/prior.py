"""What is known of tractions before the image is looked at: statistics of presses (docs/force_physics.md has the figures).

In units of the shear modulus. Pressure: correlated as exp(−r/ℓ), ℓ = 1.9 mm, and in proportion to how deep the touch is.
Shear: pressure times a smooth ratio, of which one part is the same all over the contact (the hand's pull: 0.12 on each axis)
and one changes over some two millimetres (the gel that wants to spread, and friction that keeps it: 0.15).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.force.traction.cells import Cells

View = Float32[Array, "rows cols"]


@dataclass(frozen=True)
class Prior:
    """Statistics of presses that were simulated with other objects on other sensors."""

    pressure_per_mm: float = 7.0
    """Standard deviation of the pressure over the root mean square of the indentation, 1/mm; half as much again as was found,
    since pressure has edges and a Gaussian has not."""
    correlation_mm: float = 1.9
    pull: float = 0.12
    """Standard deviation of shear over pressure, the part that is common to the contact."""
    spread: float = 0.15
    """Of the part that changes over the contact."""
    spread_mm: float = 2.0
    smooth_mm: float = 0.4
    """By which pressure is smoothed before it carries shear."""


@dataclass(frozen=True)
class ShearModes:
    """Smooth ratios of shear to pressure on one axis: one constant, and Gaussian bumps on a lattice."""

    cells: Cells
    prior: Prior

    @cached_property
    def factors(self) -> tuple[Float32[Array, "rows n"], Float32[Array, "cols m"]]:
        """Bumps along y and along x; their products have the variance that the prior says."""
        down, across = (bumps(side, self.cells.pitch_mm, self.prior.spread_mm) for side in self.cells.shape)
        power = np.sqrt((down**2).sum(1).mean() * (across**2).sum(1).mean())
        return (down * self.prior.spread / power).astype(np.float32), across.astype(np.float32)

    @cached_property
    def on_cells(self) -> Float32[Array, "cells modes"]:
        """Every mode on every cell of the view, row after row."""
        down, across = self.factors
        lattice = np.einsum("ia,jb->ijab", down, across).reshape(len(down) * len(across), -1)
        common = np.full((len(lattice), 1), self.prior.pull, np.float32)
        return np.concatenate([common, lattice], axis=1)


def bumps(cells: int, pitch_mm: float, step_mm: float) -> Float[Array, "cells n"]:
    """Gaussians one step apart along one axis."""
    count = int(np.ceil(cells * pitch_mm / step_mm)) + 1
    middle = (np.arange(count) - (count - 1) / 2) * step_mm
    place = (np.arange(cells) - (cells - 1) / 2) * pitch_mm
    return np.exp(-((place[:, None] - middle) ** 2) / (2 * (0.8 * step_mm) ** 2))


def stiffness(wave: Float[Array, "rows half"], prior: Prior, pitch_mm: float) -> Float32[Array, "rows half"]:
    """One over the power of pressure at every wave, for an indentation of 1 mm: exp(−r/ℓ) in two dimensions."""
    length = prior.correlation_mm
    power = 2 * np.pi * (prior.pressure_per_mm * length / pitch_mm) ** 2
    return ((1 + (wave * length) ** 2) ** 1.5 / power).astype(np.float32)

"""How certain the wrench is: what the image leaves open, and what is uncertain of the sensor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.force.traction.explained import Explained
from ninedtact.force.traction.linearised import Linearised

THICKNESS_POWER = 1.0
"""By which power of the assumed thickness forces fall, shear more and load less: the table of docs/force_physics.md."""


@dataclass(frozen=True)
class Certainty:
    """Standard deviations that no single image tells, relative."""

    modulus: float = 0.05
    """Of the gel's shear modulus, as a known weight gives it."""
    thickness: float = 0.02
    """Of the gel's thickness, as the ball press gives it."""
    model: float = 0.08
    """Of what the cells and the linear gel leave out, found on twins."""
    alike: float = 2.0
    """How many times more the image leaves open than if its cells erred independently: what is wrong in the calibration is
    wrong in the same way all around a contact. Found on twins."""

    @property
    def relative(self) -> float:
        """Together."""
        return float(np.hypot(np.hypot(self.modulus, self.model), THICKNESS_POWER * self.thickness))

    def error(self, found: Explained, six: Float64[Array, "6"], modulus_mpa: float) -> Float64[Array, "6"]:
        """Standard deviation of each part of the wrench."""
        left_open = self.alike * np.sqrt(np.diag(covariance(found))) * modulus_mpa
        return np.hypot(left_open, self.relative * np.abs(six))


def covariance(found: Explained) -> Float64[Array, "6 6"]:
    """Of the six sums over the shear modulus, given the image: S H⁻¹ Sᵀ."""
    sizes = found.lowest.sizes(sums(found.round))
    return np.asarray(sizes @ sizes.T)


def sums(line: Linearised) -> Float64[Array, "6 unknowns"]:
    """Force and torque of one of each unknown, N and N·m per MPa."""
    cells = line.kernels.forward.cells
    x, y = (place[line.place].astype(float) for place in cells.places_mm)
    none, one = np.zeros((1, line.carried.shape[1])), np.ones_like(x)
    pressed = np.stack([0 * x, 0 * x, -one, -y / 1e3, x / 1e3, 0 * x])
    common, turned_x, turned_y = (row[None] @ line.carried for row in (one, -y / 1e3, x / 1e3))
    along_x = np.concatenate([common, none, none, none, none, turned_x])
    along_y = np.concatenate([none, common, none, none, none, turned_y])
    return np.concatenate([pressed, along_x, along_y], axis=1) * cells.patch.cell_mm2

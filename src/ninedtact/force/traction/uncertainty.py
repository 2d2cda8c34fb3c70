"""The uncertainty of the wrench: what the image leaves open, and what is uncertain about the sensor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.force.traction.inversion import InversionResult
from ninedtact.force.traction.linearisation import LinearisedProblem

_THICKNESS_EXPONENT = 1.0
"""Power of the assumed thickness with which forces fall, shear more and load less: the table of docs/force_physics.md."""


@dataclass(frozen=True)
class UncertaintyModel:
    """Relative standard deviations that cannot be estimated from a single image."""

    modulus: float = 0.05
    """Of the gel's shear modulus, when it is calibrated with a known load."""
    thickness: float = 0.02
    """Of the gel's thickness, as fitted to the ball press."""
    model: float = 0.08
    """Of what the cells and the linear gel leave out, found on twins."""
    correlation: float = 2.0
    """How many times more the image leaves open than if its cells erred independently: errors of the calibration are the same all
    around a contact. Found on twins."""

    @property
    def relative_std(self) -> float:
        """The combined relative standard deviation of modulus, model and thickness."""
        return float(np.hypot(np.hypot(self.modulus, self.model), _THICKNESS_EXPONENT * self.thickness))

    def wrench_std(self, result: InversionResult, six: Float64[Array, "6"], modulus_mpa: float) -> Float64[Array, "6"]:
        """Return the standard deviation of each of the six components of the wrench, N and N·m."""
        open_std = self.correlation * np.sqrt(np.diag(_wrench_covariance(result))) * modulus_mpa
        return np.hypot(open_std, self.relative_std * np.abs(six))


def _wrench_covariance(result: InversionResult) -> Float64[Array, "6 6"]:
    """Return the covariance S H⁻¹ Sᵀ of the wrench over the shear modulus, given the image."""
    whitened = result.solution.whiten_rows(_wrench_operator(result.problem))
    return np.asarray(whitened @ whitened.T)


def _wrench_operator(problem: LinearisedProblem) -> Float64[Array, "6 unknowns"]:
    """Return S: force and torque of one of each unknown, N and N·m per MPa."""
    cells, carried = problem.kernels.forward.cells, problem.carried_shear
    x, y = (coordinate[problem.contact_cells].astype(float) for coordinate in cells.coordinates_mm)
    none, one = np.zeros((1, carried.shape[1])), np.ones_like(x)
    pressed = np.stack([0 * x, 0 * x, -one, -y / 1e3, x / 1e3, 0 * x])
    common, turned_x, turned_y = (row[None] @ carried for row in (one, -y / 1e3, x / 1e3))
    along_x = np.concatenate([common, none, none, none, none, turned_x])
    along_y = np.concatenate([none, common, none, none, none, turned_y])
    return np.concatenate([pressed, along_x, along_y], axis=1) * cells.patch.cell_area_mm2

"""What is fitted: names, bounds, and how far to step when asking what a parameter does."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array


@dataclass(frozen=True)
class Parameter:
    """One number to be found."""

    name: str
    least: float
    most: float
    step: float
    """For the difference quotient: small against what matters, large against the solver's tolerance."""
    scale: float = 1.0


SEARCHED = (
    Parameter("x_mm", -12, 12, 0.02),
    Parameter("y_mm", -9, 9, 0.02),
    Parameter("depth_mm", 0.1, 3.0, 0.02),
    Parameter("drag_x_mm", -4, 4, 0.03),
    Parameter("drag_y_mm", -4, 4, 0.03),
    Parameter("thickness_mm", 0.8, 6.0, 0.03),
    Parameter("scattering_mm", 0.05, 1.5, 0.02, 0.3),
    Parameter("saturation", 0.0, 5.0, 0.05, 0.5),
    Parameter("nearness_per_mm", 0.0, 0.08, 0.004, 0.05),
)
"""Those that the image depends on in no simple way. Given them, three more are a linear problem: the level 1 + c, and
(1 + c) times the slopes of dark and bright."""
NAMES = tuple(parameter.name for parameter in SEARCHED)

Vector = Float[Array, " parameters"]


def bounds() -> tuple[Vector, Vector]:
    """Lower and upper bounds of what is searched."""
    return np.array([p.least for p in SEARCHED], float), np.array([p.most for p in SEARCHED], float)


def scales() -> Vector:
    """Of how much of each parameter matters."""
    return np.array([p.scale for p in SEARCHED])


def stepped(vector: Vector, index: int) -> tuple[Vector, float]:
    """The vector with one parameter moved, inside its bounds, and by how much."""
    parameter = SEARCHED[index]
    step = parameter.step if vector[index] + parameter.step < parameter.most else -parameter.step
    moved = vector.copy()
    moved[index] += step
    return moved, step

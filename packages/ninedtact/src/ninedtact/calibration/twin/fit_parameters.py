"""The parameters of the fit to a ball press, and how each is searched."""

from dataclasses import dataclass

import numpy as np

from ninedtact.simulation.calibration_press_models import ParameterVector


@dataclass(frozen=True)
class _FitParameter:
    """One parameter of the fit."""

    name: str
    lower_bound: float
    upper_bound: float
    difference_step: float
    """Step of the difference quotient: small against the relevant scale, large against the solver's tolerance."""
    scale: float = 1.0
    moves_contact: bool = False
    """Whether the contact must be solved again when the parameter changes."""


NEARLY_RIGID = 1e-3
"""Smallest modulus of the gel over that of its base in the search: on a rigid base no press is deeper than the gel is thick."""

FIT_PARAMETERS = (
    _FitParameter("x_mm", -12, 12, 0.02),
    _FitParameter("y_mm", -9, 9, 0.02),
    _FitParameter("depth_mm", 0.1, 3.0, 0.02, moves_contact=True),
    _FitParameter("drag_x_mm", -4, 4, 0.03, moves_contact=True),
    _FitParameter("drag_y_mm", -4, 4, 0.03, moves_contact=True),
    _FitParameter("thickness_mm", 0.8, 6.0, 0.03, moves_contact=True),
    _FitParameter("point_spread_mm", 0.05, 1.5, 0.02, 0.3),
    _FitParameter("saturation", 0.0, 5.0, 0.05, 0.5),
    _FitParameter("inverse_distance_per_mm", 0.0, 0.08, 0.004, 0.05),
    _FitParameter("gel_to_base_modulus_ratio", NEARLY_RIGID, 0.35, 0.02, 0.1, moves_contact=True),
)
"""How `BallPressParameters` are searched. Given them, three more are a linear problem: the level 1 + c, and (1 + c) times the
slopes of darkening and brightening.
"""
PARAMETER_NAMES = tuple(parameter.name for parameter in FIT_PARAMETERS)


def parameter_bounds() -> tuple[ParameterVector, ParameterVector]:
    """Return the lower and upper bounds of the searched parameters."""
    lower = np.array([parameter.lower_bound for parameter in FIT_PARAMETERS], float)
    upper = np.array([parameter.upper_bound for parameter in FIT_PARAMETERS], float)
    return lower, upper


def parameter_scales() -> ParameterVector:
    """Return the relevant scale of each parameter."""
    return np.array([p.scale for p in FIT_PARAMETERS])


def perturb_parameter(vector: ParameterVector, index: int) -> tuple[ParameterVector, float]:
    """Return the vector with one parameter moved inside its bounds, and the step."""
    parameter = FIT_PARAMETERS[index]
    step = parameter.difference_step
    if vector[index] + step >= parameter.upper_bound:
        step = -step
    perturbed = vector.copy()
    perturbed[index] += step
    return perturbed, step

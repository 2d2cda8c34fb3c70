"""The parameters of the fit to presses of balls, and how each is searched: those of the first press with gel and view, which all
presses share, then the pose of every further press."""

from dataclasses import dataclass, replace

import numpy as np

from ninedtact.simulation.calibration_press_models import BallPressParameters, ParameterVector


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

_POSE_PARAMETERS = (
    _FitParameter("x_mm", -12, 12, 0.02),
    _FitParameter("y_mm", -9, 9, 0.02),
    _FitParameter("depth_mm", 0.1, 3.0, 0.02, moves_contact=True),
    _FitParameter("drag_x_mm", -4, 4, 0.03, moves_contact=True),
    _FitParameter("drag_y_mm", -4, 4, 0.03, moves_contact=True),
)
FIT_PARAMETERS = (
    *_POSE_PARAMETERS,
    _FitParameter("thickness_mm", 0.8, 6.0, 0.03, moves_contact=True),
    _FitParameter("point_spread_mm", 0.05, 1.5, 0.02, 0.3),
    _FitParameter("saturation", 0.0, 10.0, 0.05, 0.5),
    _FitParameter("inverse_distance_per_mm", 0.0, 0.08, 0.004, 0.05),
    _FitParameter("gel_to_base_modulus_ratio", NEARLY_RIGID, 0.35, 0.02, 0.1, moves_contact=True),
)
"""How `BallPressParameters` are searched. Given them, three more are a linear problem: the level 1 + c, and (1 + c) times the
slopes of darkening and brightening.
"""
PARAMETER_NAMES = tuple(parameter.name for parameter in FIT_PARAMETERS)
BASE_INDEX = PARAMETER_NAMES.index("gel_to_base_modulus_ratio")
POSE_COUNT = len(_POSE_PARAMETERS)


def fit_parameters(press_count: int) -> tuple[_FitParameter, ...]:
    """Return the parameters of a joint fit to this many presses, in the order of its vector."""
    further = (
        replace(parameter, name=f"press_{number}_{parameter.name}")
        for number in range(2, press_count + 1)
        for parameter in _POSE_PARAMETERS
    )
    return (*FIT_PARAMETERS, *further)


def press_count_of(vector: ParameterVector) -> int:
    """Return the number of presses whose joint fit has this vector."""
    return 1 + (vector.size - len(FIT_PARAMETERS)) // POSE_COUNT


def split_by_press(vector: ParameterVector) -> list[BallPressParameters]:
    """Return the parameters of every press from the vector of a joint fit."""
    first, further = vector[: len(FIT_PARAMETERS)], vector[len(FIT_PARAMETERS) :].reshape(-1, POSE_COUNT)
    vectors = [first, *(np.concatenate([pose, first[POSE_COUNT:]]) for pose in further)]
    return [BallPressParameters.from_vector(one) for one in vectors]


def join_presses(presses: list[BallPressParameters]) -> ParameterVector:
    """Return the vector of a joint fit, with gel and view of the first press."""
    first, *further = (press.vector for press in presses)
    return np.concatenate([first, *(vector[:POSE_COUNT] for vector in further)])


def parameters_of_press(number: int) -> list[int]:
    """Return the indices in the vector of a joint fit on which one press depends, 0 for the first, in the order of its own."""
    shared = list(range(POSE_COUNT, len(FIT_PARAMETERS)))
    start = 0 if number == 0 else len(FIT_PARAMETERS) + (number - 1) * POSE_COUNT
    return [*range(start, start + POSE_COUNT), *shared]


def parameter_bounds(press_count: int = 1) -> tuple[ParameterVector, ParameterVector]:
    """Return the lower and upper bounds of the searched parameters."""
    parameters = fit_parameters(press_count)
    lower = np.array([parameter.lower_bound for parameter in parameters], float)
    upper = np.array([parameter.upper_bound for parameter in parameters], float)
    return lower, upper


def parameter_scales(press_count: int = 1) -> ParameterVector:
    """Return the relevant scale of each parameter."""
    return np.array([p.scale for p in fit_parameters(press_count)])


def perturb_parameter(vector: ParameterVector, index: int) -> tuple[ParameterVector, float]:
    """Return the vector with one parameter moved inside its bounds, and the step."""
    parameter = fit_parameters(press_count_of(vector))[index]
    step = parameter.difference_step
    if vector[index] + step >= parameter.upper_bound:
        step = -step
    perturbed = vector.copy()
    perturbed[index] += step
    return perturbed, step

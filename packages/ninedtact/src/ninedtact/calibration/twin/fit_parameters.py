"""The parameters of the fit to presses of balls, how each is searched, and how well a fit determines them: those of the first press
with gel and view, which all presses share, then the pose of every further press.

Residuals are model errors, smooth over millimetres, so that the number of independent observations is estimated from the residual
itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

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


def parameter_names(press_count: int) -> tuple[str, ...]:
    """Return the names of the parameters of a joint fit, in the order of its vector."""
    return tuple(parameter.name for parameter in fit_parameters(press_count))


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


@dataclass(frozen=True)
class FitUncertainty:
    """Standard deviations of the searched parameters, and correlations of those of the first press, gel and view."""

    effective_observations: float
    """Effective number of independent observations."""
    standard_deviations: dict[str, float]
    correlation: Float[Array, "parameters parameters"]

    def most_correlated_parameter(self, name: str) -> tuple[str, float]:
        """Return the parameter with which this one is most correlated, and their correlation."""
        index = PARAMETER_NAMES.index(name)
        row = self.correlation[index].copy()
        row[index] = 0
        other = int(np.abs(row).argmax())
        return PARAMETER_NAMES[other], float(row[other])


def parameter_covariance(
    jacobian: Float[Array, "rows parameters"], residual: Float[Array, "..."], effective_observations: float
) -> Float[Array, "parameters parameters"]:
    """Return the covariance of least-squares parameters, as of this number of independent observations (Gauss–Markov)."""
    degrees_of_freedom = max(effective_observations - jacobian.shape[1], 1.0)
    variance = np.sum(residual**2) / degrees_of_freedom
    return np.linalg.pinv(jacobian.T @ jacobian) * variance


def estimate_uncertainty(
    jacobian: Float[Array, "rows parameters"],
    residual: Float[Array, " n"],
    effective_observations: float,
    model_error: ParameterVector,
) -> FitUncertainty:
    """Return standard deviations and correlations. The Jacobian has the rows of the priors too, the residual has not.

    model_error: how far one standard deviation of what the model leaves open moves all parameters together.
    """
    covariance = parameter_covariance(jacobian, residual, effective_observations) + np.outer(model_error, model_error)
    standard_deviations = np.sqrt(np.maximum(np.diag(covariance), 0))
    divisors = np.where(standard_deviations > 0, standard_deviations, 1)
    names = parameter_names(press_count_of(standard_deviations))
    named = dict(zip(names, standard_deviations.tolist(), strict=True))
    own = slice(len(PARAMETER_NAMES))
    return FitUncertainty(effective_observations, named, (covariance / np.outer(divisors, divisors))[own, own])


def model_error_share(jacobian: Float[Array, "rows parameters"], rows: list[slice]) -> float:
    """Return the share of the model's error of one image that is left where presses are fitted together: 1 for one press.

    The error of the model moves what each image alone would say of the base, by as much for every image and independently. The
    joint fit moves by less, as far as gel and light that the presses share contradict it. jacobian: that of the joint fit, rows of
    priors last. rows: the rows of each press.
    """
    if len(rows) == 1:
        return 1.0
    alone = [jacobian[one][:, parameters_of_press(number)] for number, one in enumerate(rows)]
    *each, joint = (
        marginal_information_of_parameter(one.T @ one, BASE_INDEX) for one in (*alone, jacobian[: rows[-1].stop])
    )
    return share_left_of_model_error(each, joint)


def share_left_of_model_error(alone: Sequence[float], joint: float) -> float:
    """Return the share of the model's error that is left, from what each image alone and all together say of the base."""
    return float(min(np.sqrt(np.sum(np.square(alone))) / joint, 1.0))


def marginal_information_of_parameter(information: Float[Array, "n n"], index: int) -> float:
    """Return what images say of one parameter when all others are fitted: the inverse of its variance."""
    return float(1 / max(np.linalg.pinv(information, hermitian=True)[index, index], 1e-30))


def effective_observation_count(residual: Float[Array, "rows cols"]) -> float:
    """Return the effective number of independent observations: their number divided by the sum of their mutual correlations.

    residual: the residual of a fit as an image; not-a-number where nothing was observed.
    """
    is_observed = np.isfinite(residual)
    values = residual[is_observed]
    centred = np.where(is_observed, residual - values.mean(), 0.0)
    pair_counts = np.maximum(_autocorrelation_sums(is_observed.astype(float)), 1)
    correlation = _autocorrelation_sums(centred) / pair_counts / np.mean(values**2)
    lag_rows, lag_cols = np.indices(correlation.shape)
    lag = np.hypot(lag_rows - correlation.shape[0] // 2, lag_cols - correlation.shape[1] // 2).astype(int)
    radial_mean = np.bincount(lag.ravel(), correlation.ravel()) / np.bincount(lag.ravel())
    first_zero = int(np.argmax(radial_mean <= 0)) or len(radial_mean)
    correlation_sum = float(correlation[lag < first_zero].sum())
    return float(max(values.size / max(correlation_sum, 1.0), len(PARAMETER_NAMES) + 1.0))


def _autocorrelation_sums(field: Float[Array, "rows cols"]) -> Float[Array, "lags_y lags_x"]:
    """Return the autocorrelation sums at all lags, with lag zero in the middle."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    lags = [2 * side - 1 for side in field.shape]
    padded = [next_fast_len(count) for count in lags]
    sums = irfft2(np.abs(rfft2(field, padded)) ** 2, padded)
    middle = [count // 2 for count in lags]
    return np.asarray(np.roll(sums, middle, (0, 1))[: lags[0], : lags[1]])

"""The search for the parameters of presses of balls: what is compared, prior terms, a trust-region search from a distant start on a
coarse grid, and Gauss–Newton from a start near by.

`BallPressProblem` is one press, its observed image and the model that predicts it. `JointPressProblem` is one or more on the same
gel: thickness, base, slopes of the brightness and view are shared, and every press has a pose and a level of brightness of its own.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import least_squares, lsq_linear

from ninedtact.calibration.twin.fit_parameters import (
    fit_parameters,
    parameter_bounds,
    parameter_names,
    parameter_scales,
    perturb_parameter,
    press_count_of,
    split_by_press,
)
from ninedtact.calibration.twin.observed_presses import ObservedRoundPress
from ninedtact.mechanics.pose import InvalidPose
from ninedtact.simulation.calibration_press_models import BallPressModel, BallPressParameters, ParameterVector

_MAX_CACHED_BASES = 2
"""A derivative by the pose of one press leaves the predicted images of the others as they were."""
_MAX_COARSE_STEPS = 40
"""Largest number of steps of the first search, which yields the residual and a start for the second."""
_MAX_FINE_STEPS = 10
_COARSE_TOLERANCE = 5e-3
FINE_TOLERANCE = 1e-4
"""Relative reduction of the sum of squares below which each search ends. With 200 effective observations these are steps of 1 and
0.14 standard deviations of the result."""
_DERIVATIVE_REUSE_REDUCTION = 1e-2
"""Predicted relative reduction of the sum of squares below which the derivatives by the parameters of the contact, which need a
contact solution each, are reused in the next iteration."""
_REUSE_TOLERANCES = 5
"""The same in tolerances, for a search with a large one."""
_STEP_LENGTHS = (1.0, 0.4, 0.15)
"""Fractions of a step (the step lengths of a line search) that are tried until one reduces the sum of squares."""
_RIDGE = 1e-14
"""Share of the largest diagonal element that keeps the normal equations of a step regular."""
_TAIL_DEGREES = 3.0
"""Degrees of freedom of a prior with heavy tails: seven standard deviations cost as much as three of a normal one."""
_SHALLOWER = 0.98
"""Factor on the depth of a first guess that leaves nothing of the gel."""


@dataclass(frozen=True)
class BallPressProblem:
    """An observed press of a ball or a flat end, and the model that predicts it."""

    observed: ObservedRoundPress
    model: BallPressModel

    @cached_property
    def cached_bases(self) -> dict[BallPressParameters, Float[Array, "n 3"]]:
        """The bases that were computed last."""
        return {}

    @cached_property
    def brightness(self) -> Float[Array, " n"]:
        """Relative brightness of each observed point, without what a tilt explains."""
        return self.observed.without_tilt(self.observed.relative_brightness)

    def linear_basis(self, press: BallPressParameters) -> Float[Array, "n 3"]:
        """Return the coefficients of level, darkening slope and brightening slope at each observed point."""
        if press not in self.cached_bases:
            predicted = self.model.linear_basis(press, self.observed.centre_mm, self.observed.points_mm)
            basis = self.observed.without_tilt(predicted)
            if len(self.cached_bases) >= _MAX_CACHED_BASES:
                self.cached_bases.pop(next(iter(self.cached_bases)))
            self.cached_bases[press] = basis
        return self.cached_bases[press]

    def starting_from(self, press: BallPressParameters) -> "BallPressProblem":
        """Return the problem with the contacts of this press as first guesses, which save iterations for similar presses."""
        return replace(self, model=self.model.starting_from(press))


@dataclass(frozen=True)
class JointPressProblem:
    """Observed presses on one gel."""

    presses: tuple[BallPressProblem, ...]

    @cached_property
    def rows(self) -> list[slice]:
        """The rows of the residual that belong to each press."""
        ends = np.cumsum([0, *(press.observed.count for press in self.presses)]).tolist()
        return [slice(start, end) for start, end in pairwise(ends)]

    @property
    def row_count(self) -> int:
        """Number of observed points of all presses."""
        return self.rows[-1].stop

    def fit_linear_terms(self, vector: ParameterVector) -> tuple[Float[Array, " terms"], Float[Array, " n"]]:
        """Return the best level of every press, then the slopes of darkening and brightening at the level of the first, and the
        residual in grey levels, observed minus predicted.

        The residual is infinite where a ball would leave nothing of the gel.
        """
        count = len(self.presses)
        grey = [press.observed.mean_grey for press in self.presses]
        observed = [press.brightness for press in self.presses]
        try:
            bases = [
                press.linear_basis(parameters)
                for press, parameters in zip(self.presses, split_by_press(vector), strict=True)
            ]
        except InvalidPose:
            return np.full(count + 2, np.nan), np.full(self.row_count, np.inf)
        levels: Float[Array, " presses"] = np.ones(count)
        for _ in range(1 if count == 1 else 2):  # the slopes are proportional to the level of each press
            scales = [np.array([1.0, level / levels[0], level / levels[0]]) for level in levels.tolist()]
            normal, target = np.zeros((count + 2, count + 2)), np.zeros(count + 2)
            for number, (basis, scale) in enumerate(zip(bases, scales, strict=True)):
                terms, weight = [number, count, count + 1], (grey[number] / grey[0]) ** 2
                normal[np.ix_(terms, terms)] += weight * (basis.T @ basis) * np.outer(scale, scale)
                target[terms] += weight * (basis.T @ observed[number]) * scale
            coefficients = np.linalg.solve(normal, target)
            levels = coefficients[:count]
        residuals = [
            (observed[number] - basis @ (coefficients[[number, count, count + 1]] * scale)) * grey[number]
            for number, (basis, scale) in enumerate(zip(bases, scales, strict=True))
        ]
        return coefficients, np.concatenate(residuals)

    def starting_from(self, vector: ParameterVector) -> "JointPressProblem":
        """Return the problem with the contacts of these presses as first guesses, which save iterations for similar presses."""
        parameters = split_by_press(vector)
        return JointPressProblem(
            tuple(press.starting_from(one) for press, one in zip(self.presses, parameters, strict=True))
        )


@dataclass(frozen=True)
class ParameterPrior:
    """Prior knowledge of a parameter, from other sources than the image."""

    name: str
    value: float
    standard_deviation: float
    has_heavy_tails: bool = False
    """Whether values far from this one are rare rather than excluded, as for a logarithmic penalty (Student's distribution)."""

    def residual(self, value: float) -> tuple[float, float]:
        """Return the residual of a value in standard deviations, and its derivative by the value."""
        deviation = (value - self.value) / self.standard_deviation
        if not self.has_heavy_tails or deviation == 0:
            return deviation, 1 / self.standard_deviation
        square = deviation**2 / _TAIL_DEGREES
        residual = float(np.copysign(np.sqrt(_TAIL_DEGREES * np.log1p(square)), deviation))
        return residual, deviation / residual / (1 + square) / self.standard_deviation


@dataclass(frozen=True)
class PriorTerms:
    """Prior terms as observations beside those of the image."""

    priors: tuple[ParameterPrior, ...]
    grey_levels_per_std: float
    """Grey levels that correspond to one standard deviation of a prior: the residual of an independent observation."""

    def residual(self, vector: ParameterVector) -> Float[Array, " priors"]:
        """Return the deviation of the vector from the priors, in grey levels."""
        names = parameter_names(press_count_of(vector))
        deviations = [prior.residual(vector[names.index(prior.name)])[0] for prior in self.priors]
        return self.grey_levels_per_std * np.array(deviations, float)

    def jacobian(self, vector: ParameterVector) -> Float[Array, "priors parameters"]:
        """Return the derivative of the residual by the parameters."""
        names, rows = parameter_names(press_count_of(vector)), np.zeros((len(self.priors), vector.size))
        for row, prior in zip(rows, self.priors, strict=True):
            index = names.index(prior.name)
            row[index] = self.grey_levels_per_std * prior.residual(vector[index])[1]
        return rows


def fit_coarsely(problem: JointPressProblem, start: ParameterVector) -> ParameterVector:
    """Return the least-squares parameters from a distant start, by a trust-region method, without prior terms."""

    def residual(vector: ParameterVector) -> Float[Array, " n"]:
        return problem.fit_linear_terms(vector)[1]

    def jacobian(vector: ParameterVector) -> Float[Array, "n parameters"]:
        return image_jacobian(problem.starting_from(vector), vector, residual(vector))

    count = len(problem.presses)
    solution = least_squares(
        residual,
        start,
        jacobian,
        parameter_bounds(count),
        x_scale=parameter_scales(count),
        ftol=_COARSE_TOLERANCE,
        xtol=1e-3,
        max_nfev=_MAX_COARSE_STEPS,
    )
    return np.asarray(solution.x)


def leave_some_gel(problem: JointPressProblem, start: ParameterVector) -> tuple[ParameterVector, Float[Array, " n"]]:
    """Return the parameters with depths that leave some gel under every ball, and their residual.

    A coarse grid, which has no point under the ball's lowest, allows a little more, and so does a softer base.
    """
    possible = start.copy()
    depths = [index for index, one in enumerate(fit_parameters(press_count_of(start))) if "depth_mm" in one.name]
    _, residual = problem.fit_linear_terms(possible)
    if np.isfinite(residual).all():
        return possible, residual
    while not np.isfinite(residual).all():
        possible[depths] *= _SHALLOWER
        _, residual = problem.fit_linear_terms(possible)
    possible[depths] *= _SHALLOWER  # so that differences on either side leave some gel, too
    return possible, problem.fit_linear_terms(possible)[1]


def fit_finely(
    problem: JointPressProblem,
    start: ParameterVector,
    prior_terms: PriorTerms,
    tolerance: float = FINE_TOLERANCE,
    reused_jacobian: Float[Array, "rows parameters"] | None = None,
    held: int | None = None,
) -> tuple[JointPressProblem, ParameterVector, Float[Array, "rows parameters"]]:
    """Return the problem with the contacts of the last iteration as first guesses, the least-squares parameters with prior terms,
    and the last Jacobian of the residual, with one row for every prior. They are found from a start near by, by Gauss–Newton.

    The contacts are solved to a tolerance, so the sum of squares scatters from one vector to the next, and a search that waits for
    the smallest differences of it does not end. This one ends where the linearised problem predicts a smaller relative reduction
    than `tolerance`, or where no step length reduces the sum of squares.

    reused_jacobian: that of a similar problem, whose derivatives by the parameters of the contact serve for the first step. held:
    index of a parameter that stays as it is, whose derivatives in the Jacobian are zero.
    """

    def stacked_residual(vector: ParameterVector) -> Float[Array, " n"]:
        return np.append(problem.fit_linear_terms(vector)[1], prior_terms.residual(vector))

    vector = start
    residual = stacked_residual(start)
    reuse_reduction = max(_DERIVATIVE_REUSE_REDUCTION, _REUSE_TOLERANCES * tolerance)
    for _ in range(_MAX_FINE_STEPS):
        problem = problem.starting_from(vector)
        derivatives = image_jacobian(problem, vector, residual[: problem.row_count], reused_jacobian, held)
        jacobian = np.vstack([derivatives, prior_terms.jacobian(vector)])
        step = _bounded_step(jacobian, residual, vector)
        sum_of_squares = np.sum(residual**2)
        predicted_reduction = 1 - np.sum((residual + jacobian @ step) ** 2) / sum_of_squares
        if not predicted_reduction > tolerance:
            break
        reused_jacobian = jacobian if predicted_reduction < reuse_reduction else None
        for step_length in _STEP_LENGTHS:
            candidate = vector + step_length * step
            candidate_residual = stacked_residual(candidate)
            if np.sum(candidate_residual**2) < sum_of_squares:
                vector = candidate
                residual = candidate_residual
                break
        else:
            break
    return problem, vector, jacobian


def _bounded_step(
    jacobian: Float[Array, "n parameters"], residual: Float[Array, " n"], vector: ParameterVector
) -> ParameterVector:
    """Return the step that minimises the linearised sum of squares within the bounds of the parameters."""
    lower, upper = parameter_bounds(press_count_of(vector))
    square = jacobian.T @ jacobian
    cholesky = np.linalg.cholesky(square + _RIDGE * np.diag(square).max() * np.eye(vector.size))
    target = -np.linalg.solve(cholesky, jacobian.T @ residual)
    return np.asarray(lsq_linear(cholesky.T, target, (lower - vector, upper - vector), method="bvls").x)


def image_jacobian(
    problem: JointPressProblem,
    vector: ParameterVector,
    residual: Float[Array, " n"],
    reused_jacobian: Float[Array, "rows parameters"] | None = None,
    held: int | None = None,
) -> Float[Array, "n parameters"]:
    """Return the derivative of the residual by each searched parameter, with levels and slopes refitted (variable projection).

    residual: that at this vector. reused_jacobian: that at a vector near by, whose derivatives by the parameters of the contact are
    reused. held: index of a parameter that is not searched, by which the derivative is given as zero.
    """
    columns = []
    for index, parameter in enumerate(fit_parameters(len(problem.presses))):
        if index == held:
            columns.append(np.zeros_like(residual))
        elif reused_jacobian is not None and parameter.moves_contact:
            columns.append(reused_jacobian[: residual.size, index])
        else:
            columns.append(residual_derivative(problem, vector, residual, index))
    return np.column_stack(columns)


def residual_derivative(
    problem: JointPressProblem, vector: ParameterVector, residual: Float[Array, " n"], index: int
) -> Float[Array, " n"]:
    """Return the derivative of the residual by one parameter; zero on the verge of what the gel allows on both sides, where the
    parameter stays as it is until the others have led away from there.
    """
    perturbed, step = perturb_parameter(vector, index)
    change = problem.fit_linear_terms(perturbed)[1] - residual
    if not np.isfinite(change).all():  # deeper than the gel allows: take the other side
        step = -step
        perturbed = vector.copy()
        perturbed[index] += step
        change = problem.fit_linear_terms(perturbed)[1] - residual
    return change / step if np.isfinite(change).all() else np.zeros_like(change)

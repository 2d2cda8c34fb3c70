"""The base of the gel in the fit of ball presses: what the images say of it, and how all other parameters follow it.

The sum of squares as a function of the base is nearly flat, with side minima, and far from a parabola, so that neither the nearest
minimum nor the curvature there tells the base. The presses are therefore fitted with each of several bases held; the estimate is
the mean of the posterior, and its error the standard deviation.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.interpolate import CubicSpline

from ninedtact.calibration.twin.fit_parameters import (
    BASE_INDEX,
    NEARLY_RIGID,
    effective_observation_count,
    parameter_bounds,
)
from ninedtact.calibration.twin.press_search import (
    JointPressProblem,
    ParameterPrior,
    PriorTerms,
    fit_finely,
    leave_some_gel,
)
from ninedtact.simulation.calibration_press_models import (
    COARSE_PITCH_MM,
    COARSE_STEP_MM,
    BallPressModel,
    ParameterVector,
)

MODULUS_RATIO_MODEL_STD = 0.04
"""Standard deviation of the modulus of the gel over that of its base that no single image of a ball can reduce: changes of the
model of gel and light that are within its error move the result by as much."""
_HELD_BASES = (NEARLY_RIGID, 0.05, 0.1, 0.2, 0.3)
"""Moduli of the gel over that of its base with each of which the presses are fitted, in ascending order."""
_SOFTEST_BASE = 0.35
_EXCLUDED_CHI_SQUARE = 30.0
"""Excess of chi-square over the best base above which softer ones are not tried, with the residual of the start."""
_TOLERANCE = 1e-2
"""Tolerance of the fits with a base held, which is as small as an error of an error may be."""
_SCATTER = _TOLERANCE / 3
"""Relative scatter of the sums of squares of these fits, which is not evidence for a base."""
_HELD_STD = 1e-3
"""Standard deviation of the prior that holds the base at a value."""


@dataclass(frozen=True)
class KnownBase:
    """The base of a gel as known loads tell it, or as an earlier fit of the same images does."""

    modulus_ratio: float
    """Modulus of the gel over that of the base."""
    std: float = 0.0
    """Its standard deviation, which moves the other parameters along with it."""
    change_per_ratio: Float[Array, " parameters"] | None = None
    """How the best parameters change with the ratio; None where it is not known yet."""

    def hold(self, prior_terms: PriorTerms) -> PriorTerms:
        """Return the prior terms with one that holds the base in place of that of the base."""
        others = tuple(prior for prior in prior_terms.priors if prior.name != "gel_to_base_modulus_ratio")
        return replace(
            prior_terms,
            priors=(*others, ParameterPrior("gel_to_base_modulus_ratio", self.modulus_ratio, _HELD_STD)),
        )


@dataclass(frozen=True)
class _BaseProfile:
    """The best parameters with each of several bases held."""

    ratios: tuple[float, ...]
    vectors: tuple[ParameterVector, ...]
    chi_square: tuple[float, ...]
    """Sums of squares over the variance of an independent observation, and those of the prior terms."""

    def parameters_at(self, ratio: float) -> ParameterVector:
        """Return the best parameters with a base, by linear interpolation."""
        return np.array([np.interp(ratio, self.ratios, values) for values in np.array(self.vectors).T])

    def posterior(self) -> tuple[float, float]:
        """Return mean and standard deviation of the modulus ratio."""
        ratio = np.linspace(self.ratios[0], _SOFTEST_BASE, 141)
        # A natural spline, whose minimum may lie between the bases, and which goes on straight beyond the last.
        spline, last = CubicSpline(self.ratios, self.chi_square, bc_type="natural"), self.ratios[-1]
        chi_square = spline(np.minimum(ratio, last)) + spline(last, 1) * np.maximum(ratio - last, 0)
        weight = np.exp(-(chi_square - chi_square.min()) / 2)
        weight /= weight.sum()
        mean = float(weight @ ratio)
        return mean, float(np.sqrt(weight @ (ratio - mean) ** 2))


def estimate_base(
    problem: JointPressProblem, start: ParameterVector, prior_terms: PriorTerms
) -> tuple[KnownBase, ParameterVector]:
    """Return what the images and the priors say of the base, and the best parameters with it, from a start near by."""
    vector, squares, prior_squares = start, list[float](), list[float]()
    best_residual = np.zeros(0)
    ratios, vectors, jacobian = list[float](), list[ParameterVector](), None
    bounds = parameter_bounds(len(problem.presses))
    for ratio in _HELD_BASES:
        if len(vectors) > 1:  # on along the last change
            share = (ratio - ratios[-1]) / (ratios[-1] - ratios[-2])
            vector = np.clip(vectors[-1] + share * (vectors[-1] - vectors[-2]), *bounds)
        problem, vector, jacobian = _fit_with_base(problem, vector, prior_terms, ratio, jacobian)
        residual = problem.fit_linear_terms(vector)[1]
        ratios.append(ratio)
        vectors.append(vector)
        squares.append(float(residual @ residual))
        prior_squares.append(float(np.sum(prior_terms.residual(vector) ** 2)) / prior_terms.grey_levels_per_std**2)
        if squares[-1] == min(squares):
            best_residual = residual
        if squares[-1] > min(squares) + _EXCLUDED_CHI_SQUARE * prior_terms.grey_levels_per_std**2:
            break
    observations = sum(
        effective_observation_count(one.observed.image(best_residual[rows]))
        for one, rows in zip(problem.presses, problem.rows, strict=True)
    )
    variance = min(squares) * (1 / observations + _SCATTER)
    chi_square = np.array(squares) / variance + np.array(prior_squares)
    profile = _BaseProfile(tuple(ratios), tuple(vectors), tuple(chi_square.tolist()))
    mean, std = profile.posterior()
    # A difference over what is not known of the base says more than a derivative, because the fit is far from linear in it.
    reach = float(np.hypot(std, MODULUS_RATIO_MODEL_STD))
    lower, upper = max(mean - reach, ratios[0]), min(mean + reach, ratios[-1])
    change = (profile.parameters_at(upper) - profile.parameters_at(lower)) / (upper - lower)
    return KnownBase(mean, std, change), profile.parameters_at(mean)


def change_per_modulus_ratio(
    problem: JointPressProblem, vector: ParameterVector, prior_terms: PriorTerms, reach: float
) -> ParameterVector:
    """Return how the best parameters change with the modulus of the gel over that of its base, from a fit with another base.

    reach: distance of the other base. Both fits are made on the coarse grid, whose error they share.
    """
    coarse = on_coarse_grid(problem)
    fitted = float(vector[BASE_INDEX])
    stiffer = fitted > reach / 2  # towards a rigid base the press changes most
    other = max(fitted - reach, NEARLY_RIGID) if stiffer else fitted + reach
    coarse, here, _ = _fit_with_base(coarse, vector, prior_terms, fitted)
    _, there, _ = _fit_with_base(coarse, here, prior_terms, other)
    return np.asarray((there - here) / (there[BASE_INDEX] - here[BASE_INDEX]))


def _fit_with_base(
    problem: JointPressProblem,
    start: ParameterVector,
    prior_terms: PriorTerms,
    ratio: float,
    jacobian: Float[Array, "rows parameters"] | None = None,
) -> tuple[JointPressProblem, ParameterVector, Float[Array, "rows parameters"]]:
    """Return the best parameters with this base held, from a start near by, as `fit_finely` does.

    jacobian: that of the fit with another base.
    """
    start = start.copy()
    start[BASE_INDEX] = ratio
    start, _ = leave_some_gel(problem, start)
    return fit_finely(problem, start, KnownBase(ratio).hold(prior_terms), _TOLERANCE, jacobian, BASE_INDEX)


def on_coarse_grid(problem: JointPressProblem) -> JointPressProblem:
    """Return the problem with contacts on the coarse grid."""
    return JointPressProblem(
        tuple(
            replace(one, model=BallPressModel(one.model.design, COARSE_PITCH_MM, COARSE_STEP_MM, one.model.indenter))
            for one in problem.presses
        )
    )

"""The base of the gel in the fit of ball presses: fits with other bases, from which the search starts, and which tell how all other
parameters follow the base."""

from dataclasses import replace

import numpy as np

from ninedtact.calibration.twin.fit_parameters import BASE_INDEX, NEARLY_RIGID
from ninedtact.calibration.twin.press_search import (
    BallPressProblem,
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

MODULUS_RATIO_MODEL_STD = 0.06
"""Standard deviation of the modulus of the gel over that of its base that no single image of a ball can reduce: changes of the
model of gel and light that are within its error move the result by as much."""
SEARCHED_BASES = (1e-3, 0.05, 0.1, 0.2, 0.3)
"""Moduli of the gel over that of its base from each of which a fit is tried."""
_OTHER_BASE_TOLERANCE = 1e-2
"""Tolerance of the fit with another base, whose difference is as small as an error of an error may be."""
HELD_STD = 1e-3
"""Standard deviation of the prior that holds the base at another value."""


def starts_by_base(
    problem: JointPressProblem, start: ParameterVector, prior_terms: PriorTerms
) -> tuple[ParameterVector, ...]:
    """Return the two best of the fits with each of `SEARCHED_BASES`, on the coarse grid.

    All other parameters follow the base along a curved valley with several minima, in the nearest of which a single fit ends.
    """
    coarse, vector, fits = on_coarse_grid(problem), start, []
    for ratio in SEARCHED_BASES:
        vector = _best_with_base(coarse, vector, prior_terms, ratio)
        fits.append(vector)
    return tuple(sorted(fits, key=lambda one: sum_of_squares(coarse, one, prior_terms))[:2])


def sum_of_squares(problem: JointPressProblem, vector: ParameterVector, prior_terms: PriorTerms) -> float:
    """Return the sum of squares of residual and prior terms."""
    return float(np.sum(problem.fit_linear_terms(vector)[1] ** 2) + np.sum(prior_terms.residual(vector) ** 2))


def _best_with_base(
    coarse: JointPressProblem, start: ParameterVector, prior_terms: PriorTerms, ratio: float
) -> ParameterVector:
    """Return the best parameters with this base, from a start near by."""
    others = tuple(prior for prior in prior_terms.priors if prior.name != "gel_to_base_modulus_ratio")
    held = ParameterPrior("gel_to_base_modulus_ratio", ratio, HELD_STD)
    start = start.copy()
    start[BASE_INDEX] = ratio
    start, _ = leave_some_gel(coarse, start)
    return fit_finely(coarse, start, replace(prior_terms, priors=(*others, held)), _OTHER_BASE_TOLERANCE)[1]


def change_per_modulus_ratio(
    problem: JointPressProblem, vector: ParameterVector, prior_terms: PriorTerms
) -> ParameterVector:
    """Return how the best parameters change with the modulus of the gel over that of its base, from a fit with another base.

    A difference over what is not known of the base says more than the derivative, because the fit is far from linear in it. Both
    fits are made on the coarse grid, whose error they share.
    """
    coarse = on_coarse_grid(problem)
    fitted = float(vector[BASE_INDEX])
    stiffer = fitted > MODULUS_RATIO_MODEL_STD / 2  # towards a rigid base the press changes most
    other = max(fitted - MODULUS_RATIO_MODEL_STD, NEARLY_RIGID) if stiffer else fitted + MODULUS_RATIO_MODEL_STD
    here = _best_with_base(coarse, vector, prior_terms, fitted)
    there = _best_with_base(coarse, here, prior_terms, other)
    return np.asarray((there - here) / (there[BASE_INDEX] - here[BASE_INDEX]))


def on_coarse_grid(problem: JointPressProblem) -> JointPressProblem:
    """Return the problem with contacts on the coarse grid."""
    return JointPressProblem(
        tuple(
            BallPressProblem(one.observed, BallPressModel(one.model.design, COARSE_PITCH_MM, COARSE_STEP_MM))
            for one in problem.presses
        )
    )

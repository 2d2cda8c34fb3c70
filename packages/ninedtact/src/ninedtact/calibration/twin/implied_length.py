"""The length that the images of several presses on one gel imply for one of them, beside the stated one: the radius of a ball, or
the depth of a flat end.

Presses on one gel share light, thickness and base. What one of them shows of these predicts how dark another is for a contact
circle of its size, so that a wrong length contradicts the other images. A base that is not known takes up a part of the
contradiction.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.twin.fit_parameters import parameter_covariance, parameter_names
from ninedtact.calibration.twin.press_search import JointPressProblem, PriorTerms
from ninedtact.mechanics.indenter import Ball
from ninedtact.simulation.calibration_press_models import ParameterVector

_DIFFERENCE_STEP = 0.03
"""Relative step of the radius for the difference quotient."""
_MODEL_STD = 0.022
"""Relative standard deviation of the radius that the model leaves: the scatter of eight simulated sensors with right radii, on
bases of all kinds."""


@dataclass(frozen=True)
class ImpliedLength:
    """A length by the images of all presses, and its standard deviation."""

    mm: float
    std_mm: float


@dataclass(frozen=True)
class JointFit:
    """A joint fit near its best parameters."""

    problem: JointPressProblem
    vector: ParameterVector
    jacobian: Float[Array, "rows parameters"]
    """Derivative of the residual; the rows of the priors are last."""
    residual: Float[Array, " rows"]
    observations: float
    """Effective number of independent observations."""


def estimate_ball_radius_from_fit(fit: JointFit, number: int) -> ImpliedLength:
    """Return the radius of the ball of one press to first order, by one more column of the fit's Jacobian.

    number: the press, 0 for the first. A derivative that cannot be computed leaves the radius open.
    """
    problem, vector = fit.problem, fit.vector
    press = problem.presses[number]
    ball = press.model.indenter
    assert isinstance(ball, Ball), f"expected the press of a ball, got {ball}"
    model = replace(press.model, indenter=Ball(ball.radius_mm * (1 + _DIFFERENCE_STEP)))
    presses = (*problem.presses[:number], replace(press, model=model), *problem.presses[number + 1 :])
    rows = problem.row_count
    column = np.zeros(len(fit.residual))
    column[:rows] = JointPressProblem(presses).fit_linear_terms(vector)[1] - problem.fit_linear_terms(vector)[1]
    if not np.isfinite(column).all():
        return ImpliedLength(ball.radius_mm, ball.radius_mm)
    extended = np.column_stack([fit.jacobian, column / _DIFFERENCE_STEP])
    step = -np.linalg.lstsq(extended, fit.residual, rcond=None)[0][-1]
    covariance = parameter_covariance(extended, fit.residual[:rows], fit.observations)
    std = np.hypot(np.sqrt(covariance[-1, -1]), _MODEL_STD)
    return ImpliedLength(float(ball.radius_mm * np.exp(step)), float(ball.radius_mm * std))


def estimate_depth_from_fit(fit: JointFit, priors: PriorTerms, number: int) -> ImpliedLength:
    """Return the depth of one press to first order without its own prior, by leaving out the row of that.

    priors: the terms of the last rows. number: the press, 0 for the first.
    """
    name = f"press_{number + 1}_depth_mm"
    rows, index = fit.problem.row_count, parameter_names(len(fit.problem.presses)).index(name)
    kept = [*range(rows), *(rows + row for row, prior in enumerate(priors.priors) if prior.name != name)]
    jacobian = fit.jacobian[kept]
    step = -np.linalg.lstsq(jacobian, fit.residual[kept], rcond=None)[0][index]
    depth_mm = float(fit.vector[index] + step)
    std = np.sqrt(parameter_covariance(jacobian, fit.residual[:rows], fit.observations)[index, index])
    return ImpliedLength(depth_mm, float(np.hypot(std, _MODEL_STD * depth_mm)))

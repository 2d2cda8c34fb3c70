"""The radius that the images of several balls on one gel imply for one of them.

Balls on one gel share light, thickness and base. What one of them shows of these predicts how dark the other is for a contact
circle of its size, so that a wrong radius contradicts the other images. A base that is not known takes up a part of the
contradiction.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.twin.fit_parameters import parameter_covariance
from ninedtact.calibration.twin.press_search import JointPressProblem
from ninedtact.design import BallGauge
from ninedtact.simulation.calibration_press_models import ParameterVector

_DIFFERENCE_STEP = 0.03
"""Relative step of the radius for the difference quotient."""
_MODEL_STD = 0.022
"""Relative standard deviation of the radius that the model leaves: the scatter of eight simulated sensors with right radii, on
bases of all kinds."""


@dataclass(frozen=True)
class ImpliedRadius:
    """The radius of a ball by the images of all balls, and its standard deviation."""

    mm: float
    std_mm: float


def estimate_ball_radius_from_fit(
    problem: JointPressProblem,
    vector: ParameterVector,
    jacobian: Float[Array, "rows parameters"],
    residual: Float[Array, " rows"],
    observations: float,
    number: int,
) -> ImpliedRadius:
    """Return the radius of the ball of one press to first order, by one more column of the fit's Jacobian.

    vector, jacobian, residual: parameters of the joint fit, the derivative of its residual, and the residual; the rows of the
    priors are last. number: the press, 0 for the first. A derivative that cannot be computed leaves the radius open.
    """
    press = problem.presses[number]
    radius_mm = press.model.design.ball.radius_mm
    larger = BallGauge(radius_mm * (1 + _DIFFERENCE_STEP))
    model = replace(press.model, design=replace(press.model.design, ball=larger))
    presses = (*problem.presses[:number], replace(press, model=model), *problem.presses[number + 1 :])
    rows = problem.row_count
    column = np.zeros(len(residual))
    column[:rows] = JointPressProblem(presses).fit_linear_terms(vector)[1] - problem.fit_linear_terms(vector)[1]
    if not np.isfinite(column).all():
        return ImpliedRadius(radius_mm, radius_mm)
    extended = np.column_stack([jacobian, column / _DIFFERENCE_STEP])
    step = -np.linalg.lstsq(extended, residual, rcond=None)[0][-1]
    covariance = parameter_covariance(extended, residual[:rows], observations)
    std = np.hypot(np.sqrt(covariance[-1, -1]), _MODEL_STD)
    return ImpliedRadius(float(radius_mm * np.exp(step)), float(radius_mm * std))

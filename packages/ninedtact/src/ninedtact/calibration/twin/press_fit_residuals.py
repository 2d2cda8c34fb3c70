"""What is compared when a twin is fitted to presses of balls: the observed images, and those that the model predicts.

`BallPressProblem` is one press. `JointPressProblem` is one or more on the same gel: thickness, base, slopes of the brightness and
view are shared, and every press has a pose and a level of brightness of its own.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.twin.fit_parameters import split_by_press
from ninedtact.calibration.twin.observed_presses import ObservedBallPress
from ninedtact.mechanics.pose import InvalidPose
from ninedtact.simulation.calibration_press_models import BallPressModel, BallPressParameters, ParameterVector

_MAX_CACHED_BASES = 2
"""A derivative by the pose of one press leaves the predicted images of the others as they were."""


@dataclass(frozen=True)
class BallPressProblem:
    """An observed press of the ball, and the model that predicts it."""

    observed: ObservedBallPress
    model: BallPressModel

    @cached_property
    def cached_bases(self) -> dict[BallPressParameters, Float[Array, "n 3"]]:
        """The bases that were computed last."""
        return {}

    def linear_basis(self, press: BallPressParameters) -> Float[Array, "n 3"]:
        """Return the coefficients of level, darkening slope and brightening slope at each observed point."""
        if press not in self.cached_bases:
            basis = self.model.linear_basis(press, self.observed.centre_mm, self.observed.points_mm)
            if len(self.cached_bases) >= _MAX_CACHED_BASES:
                self.cached_bases.pop(next(iter(self.cached_bases)))
            self.cached_bases[press] = basis
        return self.cached_bases[press]

    def starting_from(self, press: BallPressParameters) -> "BallPressProblem":
        """Return the problem with the contacts of this press as first guesses, which save iterations for similar presses."""
        return replace(self, model=self.model.starting_from(press))


@dataclass(frozen=True)
class JointPressProblem:
    """Observed presses of balls on one gel."""

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
        observed = [press.observed.relative_brightness for press in self.presses]
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

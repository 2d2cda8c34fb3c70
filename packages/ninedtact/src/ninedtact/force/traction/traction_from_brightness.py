"""The inversion: the tractions that explain an observation best, by Gauss–Newton iteration on the brightness law.

The objective is ‖(observed − predicted)/σ‖² + ‖pressure‖² + ‖shear modes‖², with the last two norms those of the prior. Pressure is
nowhere negative, and both are zero outside the contact region. Each linearised quadratic programme is solved exactly
(`linearisation_and_qp`). σ is not a setting: it is the noise of this image and the error of this sensor's calibration, or the
residual of the best fit, where that is larger (discrepancy principle; docs/force_physics.md has the sources).

`UncertaintyModel` computes the standard deviation of the wrench from the posterior covariance of the tractions and from the
relative errors of the sensor's parameters.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.force.hidden_twist import pressure_rms_radii
from ninedtact.force.traction.brightness_from_traction import (
    DeformedSkin,
    ForwardModel,
    InfluenceKernels,
    SkinField,
    Tractions,
    View,
)
from ninedtact.force.traction.linearisation_and_qp import (
    DiscretePrior,
    LinearisedBrightnessProblem,
    QPSolution,
    TractionPrior,
    Whitener,
    solve_nonnegative_qp,
)
from ninedtact.force.traction.observation import BrightnessLaw, ObservationOnCells

WINKLER_PER_MM = 3.9
"""Pressure (over the shear modulus) per mm of indentation in the middle of presses, used for the initial guess."""
MIN_PRIOR_DEPTH_MM = 0.02
"""Smallest indentation by which the prior of pressure is scaled."""
SMALLEST_STEP = 0.25
"""Smallest part of the way to a result by which the tractions about which the problem is linearised move."""
SLIDES_FROM = 0.8
"""Shear over pressure from which a contact is taken to slide, so that the skin under it spreads freely. Loads of sheared contacts
with friction of 0.4 and 1 are then right to a tenth. They would be up to a third too large if the skin were always held."""
_WARM_SLACK = 1.5
"""Factor by which a result that started from the previous image may be farther from convergence than that image's."""
STICKING_CHANGE = 2.0
"""Weight of a change of the part of the shear that friction bears, beside a change of the pressure."""
CARRYING_EXPONENT = 0.75
"""Power of the smoothed pressure to which shear is proportional: towards the rim it falls off more slowly than pressure."""
LEVEL_STD = 0.003
"""Standard deviation of the relative brightness offset that all cells share."""


@dataclass(frozen=True)
class SolverSettings:
    """Limits of the iteration, and its convergence criteria, which are the same wherever it starts."""

    max_iterations: int = 8
    """Largest number of linearisations without a previous result."""
    max_qp_solves: int = 30
    """Largest number of linear solves for each quadratic programme."""
    target_decrement: float = 0.5
    """Newton decrement, in standard deviations of any sum of the unknowns, below which the iteration may end."""
    target_change: float = 0.04
    """Change of the pressure, relative to its sum, below which the iteration may end: shear is carried by the pressure of the
    iteration before."""
    max_warm_decrement: float = 2.0
    """Newton decrement above which a result that started from the previous image is discarded."""
    max_warm_change: float = 0.25
    """Change of the pressure in the last iteration, relative to its sum, above which such a result is discarded."""
    max_trusted_decrement: float = 5.0
    """Newton decrement above which the result counts as not converged."""


@dataclass(frozen=True)
class InitialGuess:
    """The tractions and the skin about which the problem is linearised."""

    tractions: Tractions
    skin: DeformedSkin
    misfit: float = 1.0
    iterations: int = 0
    predicted: View | None = None
    """The observed signal of this skin, where it is known."""


@dataclass(frozen=True)
class InversionResult:
    """The tractions over the shear modulus, with the data that the uncertainty and the next inversion need."""

    tractions: Tractions
    skin: DeformedSkin
    """All skin under these tractions."""
    guess: Tractions
    """The tractions from which the last iteration started."""
    problem: LinearisedBrightnessProblem
    """The problem of the last iteration."""
    solution: QPSolution
    predicted: View
    """The observed signal of this skin."""
    misfit: float
    """Root mean square of the residual over its standard deviation; at least one."""
    newton_decrement: float
    """Upper bound of the distance to the optimum, in standard deviations of any sum of the unknowns."""
    pressure_change: float
    """Change of the pressure since the problem was linearised, relative to its sum; or `STICKING_CHANGE` times that of the part of
    the shear that friction bears, where that is larger."""
    iterations: int
    step: float = 1.0
    """Part of the way from the guess to this result at which the next iteration starts."""

    def distance_from(self, decrement: float, change: float) -> float:
        """Return the Newton decrement and the change of the pressure over these limits, the larger of the two."""
        return max(self.newton_decrement / decrement, self.pressure_change / change)


@dataclass(frozen=True)
class TractionInversion:
    """The inversion for one sensor and size of image, for any number of observations."""

    forward: ForwardModel
    law: BrightnessLaw
    prior: TractionPrior = TractionPrior()
    solver: SolverSettings = SolverSettings()

    def invert(
        self, observation: ObservationOnCells, region: View, last: InversionResult | None = None
    ) -> InversionResult:
        """Return the tractions in a contact region. The result of a stream's previous image, given as `last`, saves iterations.

        The iteration starts from the observed heights where the previous result has no pressure in the region, or where the
        iterations from it stay farther from convergence than it: the result then does not depend on the previous image.
        """
        if last is not None and bool((last.tractions[0] * region).any()):
            result = self._follow(observation, region, last)
            nearest = max(_WARM_SLACK * self._warm_distance(last), 1.0)
            if self._warm_distance(result) <= nearest and result.newton_decrement <= self.solver.max_trusted_decrement:
                return result
        return self._converge(observation, region)

    def _follow(self, observation: ObservationOnCells, region: View, last: InversionResult) -> InversionResult:
        """Iterate once with the problem of the previous image, which costs little, and once more, linearised there, where the
        contact has moved or grown beyond the region of that problem."""
        guess = replace(self._guess_after(last), iterations=0, predicted=None)
        result = replace(self._iterate(observation, guess, last.problem, last.solution), step=last.step)
        if self._distance(result) <= 1:
            if (region <= last.problem.region).all():
                return result
            region = np.maximum(region, last.problem.region)  # noise at its border then does not make it grow again
        return replace(self._linearise_and_iterate(observation, region, self._guess_after(result)), step=last.step)

    def _warm_distance(self, result: InversionResult) -> float:
        """Return how far a result is from one that the next image may start from."""
        return result.distance_from(self.solver.max_warm_decrement, self.solver.max_warm_change)

    def _distance(self, result: InversionResult) -> float:
        """Return how far a result is from convergence; at one and below, another iteration would hardly change it."""
        return result.distance_from(self.solver.target_decrement, self.solver.target_change)

    def _converge(self, observation: ObservationOnCells, region: View) -> InversionResult:
        """Iterate from the observed heights until the result has converged, or as often as allowed; return the result nearest to
        convergence.

        Where an iteration brings the result no nearer, the next ones start closer to where this one did: what finite strain adds is
        not part of the derivative, and pressure would oscillate in deep presses. Where the pressure has hardly changed since the
        problem was linearised, the same problem serves again.
        """
        result = best = self._linearise_and_iterate(observation, region, self._guess_from_heights(observation, region))
        while result.iterations < self.solver.max_iterations and self._distance(result) > 1:
            step, guess = result.step, self._guess_after(result)
            if result.pressure_change > self.solver.target_change:
                result = self._linearise_and_iterate(observation, region, guess)
            else:
                result = self._iterate(observation, guess, result.problem, result.solution)
            is_better = self._distance(result) < self._distance(best)
            result = replace(result, step=step if is_better else max(step / 2, SMALLEST_STEP))
            best = result if is_better else best
        return best

    def _guess_after(self, result: InversionResult) -> InitialGuess:
        """Return the guess a step of the way to a result from its own guess."""
        tractions, skin, predicted = result.tractions, result.skin, result.predicted
        if result.step < 1:
            tractions = result.guess + np.float32(result.step) * (tractions - result.guess)
            skin, predicted = self.forward.deform(tractions), None
        return InitialGuess(tractions, skin, result.misfit, result.iterations, predicted)

    def _linearise_and_iterate(
        self, observation: ObservationOnCells, region: View, guess: InitialGuess
    ) -> InversionResult:
        """Compute one Gauss–Newton iteration from a guess."""
        return self._iterate(observation, guess, self._linearise(observation, region, guess))

    def _iterate(
        self,
        observation: ObservationOnCells,
        guess: InitialGuess,
        problem: LinearisedBrightnessProblem,
        last: QPSolution | None = None,
    ) -> InversionResult:
        """Solve a problem with the nonlinear residual of a guess, and measure the residual that remains.

        last: a solution of this problem for another residual, where there is one.
        """
        constant, sight = guess.predicted, observation.sight
        if constant is None:
            constant = self.forward.observed_change(self.law, guess.skin, sight)
        constant = constant - self.forward.scatter(problem.slope * guess.skin.linear_mm)
        programme = problem.quadratic_programme(observation.change - constant)
        if last is None:
            free, factor = problem.initially_free(guess.tractions[0]), None
        else:
            free, factor = last.free, last.factor
        solution = solve_nonnegative_qp(programme, free, self.solver.max_qp_solves, factor)
        tractions = problem.tractions(solution.x)
        skin = self.forward.deform(tractions)
        predicted = self.forward.observed_change(self.law, skin, sight)
        nonlinear = predicted - constant - self.forward.scatter(problem.slope * skin.linear_mm)
        return InversionResult(
            tractions,
            skin,
            guess.tractions,
            problem,
            solution,
            predicted,
            self._misfit(observation, predicted),
            problem.newton_decrement(solution, nonlinear) if solution.converged else np.inf,
            _change(tractions, problem),
            guess.iterations + 1,
        )

    def _linearise(
        self, observation: ObservationOnCells, region: View, guess: InitialGuess
    ) -> LinearisedBrightnessProblem:
        """Return the problem linearised about the guessed skin."""
        depth_mm = max(float(np.sqrt((observation.z_mm[region > 0] ** 2).mean())), MIN_PRIOR_DEPTH_MM)
        strain = depth_mm / self.forward.gel.thickness_mm
        slope = self.forward.slope_per_mm(self.law.slope_per_mm, guess.skin)
        width_px = self.prior.smooth_mm / self.forward.cells.pitch_mm
        carries = np.asarray(cv2.GaussianBlur(guess.tractions[0] * region, (0, 0), width_px) * region)
        power = np.maximum(carries, 0) ** np.float32(CARRYING_EXPONENT)
        carries = power * np.float32(carries.sum() / max(float(power.sum()), 1e-9))
        whitener = self._whitener(observation, guess.misfit)
        sticking_part = _sticking_part(guess.tractions)
        return LinearisedBrightnessProblem(
            self.kernels, self.discrete_prior, region, guess.tractions, carries, slope, whitener, strain, sticking_part
        )

    def _guess_from_heights(self, observation: ObservationOnCells, region: View) -> InitialGuess:
        """Return a guess of the observed skin, with pressure in proportion to the thinning of the gel under it, and no shear."""
        height_mm = self._extend_to_skin(observation.z_mm)
        thickness_change_mm = self.forward.thickness_change_mm(height_mm)
        rows, cols = region.shape
        tractions = np.zeros((3, rows, cols), np.float32)
        tractions[0] = np.maximum(-thickness_change_mm[:rows, :cols], 0) * region * np.float32(WINKLER_PER_MM)
        skin = DeformedSkin(height_mm, thickness_change_mm, np.ones_like(height_mm), thickness_change_mm)
        return InitialGuess(tractions, skin)

    def _misfit(self, observation: ObservationOnCells, predicted: View) -> float:
        """Return the root mean square of the residual over its standard deviation; at least one."""
        residual = observation.change - predicted
        square = float(np.vdot(residual, self._whitener(observation, 1.0)(residual)))
        return float(np.sqrt(max(square / max(float(observation.in_view.sum()), 1.0), 1.0)))

    def _whitener(self, observation: ObservationOnCells, misfit: float) -> Whitener:
        """Return the inverse covariance of noise and calibration error combined, scaled to the misfit."""
        std = np.float32(np.hypot(observation.error, observation.noise) * misfit)
        return Whitener(observation.in_view / std, LEVEL_STD)

    def _extend_to_skin(self, z_mm: View) -> SkinField:
        """Extend heights of the view to all skin by repeating those of its border."""
        cells = self.forward.cells
        row, col = (np.clip(cells.offsets(axis), 0, side - 1).astype(int) for axis, side in enumerate(cells.shape))
        return z_mm[np.ix_(row, col)]

    @cached_property
    def kernels(self) -> InfluenceKernels:
        """The responses to the traction on single cells."""
        return InfluenceKernels(self.forward)

    @cached_property
    def discrete_prior(self) -> DiscretePrior:
        """The prior on the cells."""
        return DiscretePrior(self.forward.cells, self.prior)


def _change(tractions: Tractions, problem: LinearisedBrightnessProblem) -> float:
    """Return the change since the problem was linearised (`InversionResult.pressure_change`)."""
    change = float(np.abs(tractions[0] - problem.about[0]).sum()) / max(float(tractions[0].sum()), 1e-9)
    return max(change, STICKING_CHANGE * abs(_sticking_part(tractions) - problem.sticking_part))


def _sticking_part(tractions: Tractions) -> float:
    """Return the part of the shear which keeps the skin in place that friction still bears under these tractions."""
    pressed, along_x, along_y = tractions.sum(axis=(1, 2)).tolist()
    return max(1 - float(np.hypot(along_x, along_y)) / max(SLIDES_FROM * pressed, 1e-9), 0.0)


_THICKNESS_EXPONENT = 1.0
"""Exponent with which forces fall with the assumed thickness: an average, larger for shear and smaller for load."""


@dataclass(frozen=True)
class UncertaintyModel:
    """Computes the covariance of the wrench: that of a single inversion, and the errors that it does not contain.

    What the scattered light blurs is not resolved, and pressure that is even over several thicknesses of an incompressible gel
    hardly deforms it. So the force of one rounded contact is found well, and that of many fine ridges or dots is not.
    """

    model: float = 0.06
    """Relative error of the mechanics and of the brightness law."""
    thickness: float = 0.02
    """Relative error of the gel's thickness, as fitted to the ball press."""
    unresolved: float = 0.01
    """Relative error of the force of one peak of pressure per ratio of the resolution to the gel's thickness. Found on simulated
    sensors, as the two below."""
    peaks_exponent: float = 2.0
    """Exponent with which the relative error grows with the number of peaks."""
    stiffening: float = 0.3
    """Relative error of what finite strain adds to the force."""
    torque_arm: float = 0.5
    """Arm of the unresolved force that makes a torque of its own, in radii of gyration of the pressure."""

    def wrench_covariance(
        self, result: InversionResult, six: Float64[Array, "6"], modulus_mpa: float, stiffening: float = 1.0
    ) -> Float64[Array, "6 6"]:
        """Return the covariance of the wrench, N and N·m, without the errors of the gel's shear modulus and base, which scale all
        of it (`ForceScale.error`).

        stiffening: ratio of the load at finite strain to that of the linear layer.
        """
        forward, pressure = result.problem.kernels.forward, result.tractions[0].astype(float)
        unresolved = min(self.unresolved_error(_count_peaks(pressure), forward), 1.0)
        relative_variance = self.relative_variance(unresolved, stiffening)
        covariance = _wrench_covariance(result) * (modulus_mpa * stiffening) ** 2 + np.diag(relative_variance * six**2)
        extent = pressure_rms_radii(pressure, *forward.cells.coordinates_mm)
        structure_nm = unresolved * self.torque_arm * abs(six[2]) * extent.radius_of_gyration_mm / 1e3
        twist_nm = extent.hidden_torque_nm(six[2])
        return covariance + np.diag([0, 0, 0, structure_nm**2, structure_nm**2, structure_nm**2 + twist_nm**2])

    def relative_variance(self, unresolved: Any, stiffening: Any) -> Any:
        """Return the variance of the wrench relative to its square, for one contact or an array of contacts.

        unresolved: relative error due to structure that is not resolved. stiffening: as in `wrench_covariance`.
        """
        constant = self.model**2 + (_THICKNESS_EXPONENT * self.thickness) ** 2
        return constant + unresolved**2 + (self.stiffening * (1 - 1 / stiffening)) ** 2

    def unresolved_error(self, peaks: Any, forward: ForwardModel) -> Any:
        """Return the relative error of the force due to structure that is not resolved; the caller limits it to one.

        peaks: number of peaks of the pressure, of one contact or of an array of contacts.
        """
        resolution_mm = max(forward.point_spread_mm, forward.cells.pitch_mm / 2)
        return self.unresolved * resolution_mm / forward.gel.thickness_mm * peaks**self.peaks_exponent


def _count_peaks(pressure: Float64[Array, "rows cols"]) -> float:
    """Return the number of separate Gaussian peaks that would have the mean pressure and the gradients of this one; at least one.

    It is (Σp)² Σ|Δp|² / 4π (Σp²)², with the differences Δp of neighbours, and one for a Gaussian peak of any width and height.
    """
    square = float((pressure**2).sum())
    if square == 0:
        return 1.0
    differences = sum(float((np.diff(pressure, axis=axis) ** 2).sum()) for axis in (0, 1))
    return max(float(pressure.sum()) ** 2 * differences / (4 * np.pi * square**2), 1.0)


def _wrench_covariance(result: InversionResult) -> Float64[Array, "6 6"]:
    """Return the covariance S H⁻¹ Sᵀ of the wrench over the shear modulus, given the image."""
    whitened = result.solution.whiten_rows(_wrench_operator(result.problem))
    return np.asarray(whitened @ whitened.T)


def _wrench_operator(problem: LinearisedBrightnessProblem) -> Float64[Array, "6 unknowns"]:
    """Return S: the force and torque due to a unit of each unknown, N and N·m per MPa."""
    cells, carried = problem.kernels.forward.cells, problem.carried_shear
    x, y = (coordinate[problem.contact_cells].astype(float) for coordinate in cells.coordinates_mm)
    none, one = np.zeros((1, carried.shape[1])), np.ones_like(x)
    pressed = np.stack([0 * x, 0 * x, -one, -y / 1e3, x / 1e3, 0 * x])
    common, turned_x, turned_y = (row[None] @ carried for row in (one, -y / 1e3, x / 1e3))
    along_x = np.concatenate([common, none, none, none, none, turned_x])
    along_y = np.concatenate([none, common, none, none, none, turned_y])
    return np.concatenate([pressed, along_x, along_y], axis=1) * cells.patch.cell_area_mm2

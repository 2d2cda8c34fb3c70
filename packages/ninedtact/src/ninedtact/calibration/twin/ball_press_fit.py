"""The fit of the digital twin to one ball press: the pose of the press, the thickness of the gel and the brightness model that
explain the whole image, with their uncertainties. In: a `BallPress`, the rectified images and the contact circle in them. Out:
`TwinFit`, from `fit_twin_to_ball_press`.

The residual is not noise but a model error, smooth over millimetres. The number of independent observations is therefore estimated
from the residual itself, and the design's gel thickness is added as one more observation. Where the residual is plain noise, that
observation has no weight.
"""

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from time import perf_counter

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import least_squares, lsq_linear

from ninedtact.calibration.ball.ball_press import BallPress
from ninedtact.calibration.ball.contact_circle import spherical_cap_height_mm
from ninedtact.calibration.twin.fit_parameters import (
    FIT_PARAMETERS,
    NEARLY_RIGID,
    PARAMETER_NAMES,
    parameter_bounds,
    parameter_scales,
    perturb_parameter,
)
from ninedtact.calibration.twin.fit_uncertainty import (
    FitUncertainty,
    effective_observation_count,
    estimate_uncertainty,
)
from ninedtact.calibration.twin.observed_presses import ObservedBallPress
from ninedtact.design import Gel, SensorDesign
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.pose import InvalidPose
from ninedtact.shape.depth import mean_view_darkening
from ninedtact.simulation.calibration_press_models import (
    COARSE_PATCH,
    BallPressModel,
    BallPressParameters,
    ParameterVector,
)
from ninedtact.simulation.gel_brightness import BrightnessModel

RELATIVE_THICKNESS_STD = 0.22
"""Relative standard deviation of the thickness with which moulded gels act, about the designed one: from fits to six real sensors
(`simulation.real_sensor_twins`)."""
MODULUS_RATIO_STD = 0.04
"""Standard deviation of the gel's modulus over that of its base, about the designed one, before the image is seen: from a rigid
base to one eight times as stiff as the gel."""
MODULUS_RATIO_MODEL_STD = 0.04
"""Standard deviation of the same that no single image of a ball can reduce: changes of the model of gel and light that are within
its error move the result by as much."""
TYPICAL_PARAMETERS = {
    "thickness_mm": 2.0,
    "point_spread_mm": 0.45,
    "saturation": 0.4,
    "inverse_distance_per_mm": 0.04,
}
"""Initial values of the parameters that the contact circle does not show; the thickness is that of a gel of the published
design."""
EDGE_RULE_BIAS_MM = 0.1
"""Usual excess of the depth that the rule of the disc's edge gives."""
WIDE_DISC_RADIUS = 0.95
"""Radius of the disc for the initial guess, as a fraction of the ball's radius, where the disc is wider than the ball (as in thick
gel) and does not determine the depth.
"""
DRAG_PER_ASYMMETRY_MM = 3.0
"""Usual drag of a press per asymmetry of its bulge; used for the initial guess only."""
MAX_COARSE_STEPS = 40
"""Largest number of steps of the first search, which yields the residual and a start for the second."""
MAX_FINE_STEPS = 10
COARSE_TOLERANCE = 3e-3
FINE_TOLERANCE = 5e-5
"""Relative reduction of the sum of squares below which each search ends. With 200 effective observations these are steps of 0.8 and
0.1 standard deviations of the result."""
DERIVATIVE_REUSE_REDUCTION = 1e-2
"""Predicted relative reduction of the sum of squares below which the derivatives by the parameters of the contact, which need a
contact solution each, are reused in the next iteration."""
_HELD_STD = 1e-3
"""Standard deviation of the prior that holds the base at another value."""
_SHALLOWER = 0.98
"""Factor on the depth of a first guess that leaves nothing of the gel."""
STEP_LENGTHS = (1.0, 0.4, 0.15)
"""Fractions of a step (the step lengths of a line search) that are tried until one reduces the sum of squares."""


@dataclass(frozen=True)
class BallPressProblem:
    """An observed press of the ball, and the model that predicts it."""

    observed: ObservedBallPress
    model: BallPressModel

    def linear_basis(self, press: BallPressParameters) -> Float[Array, "n 3"]:
        """Return the coefficients of level, darkening slope and brightening slope at each observed point."""
        return self.model.linear_basis(press, self.observed.centre_mm, self.observed.points_mm)

    def fit_linear_terms(self, vector: ParameterVector) -> tuple[Float[Array, "3"], Float[Array, " n"]]:
        """Return the best level and slopes for these parameters, and their residual in grey levels, observed minus predicted.

        The residual is infinite where the ball would leave nothing of the gel.
        """
        observed = self.observed.relative_brightness
        try:
            basis = self.linear_basis(BallPressParameters.from_vector(vector))
        except InvalidPose:
            return np.full(3, np.nan), np.full(observed.shape, np.inf)
        coefficients = np.linalg.solve(basis.T @ basis, basis.T @ observed)
        return coefficients, (observed - basis @ coefficients) * self.observed.mean_grey

    def starting_from(self, vector: ParameterVector) -> "BallPressProblem":
        """Return the problem with the contacts of this press as first guesses, which save iterations for similar presses."""
        return replace(self, model=self.model.starting_from(BallPressParameters.from_vector(vector)))


@dataclass(frozen=True)
class TwinFit:
    """The best parameters, their residual and their uncertainties."""

    problem: BallPressProblem
    press: BallPressParameters
    brightness_coefficients: Float[Array, "3"]
    """Level, slope of darkening and slope of brightening, solved linearly."""
    residual_grey_levels: Float[Array, " n"]
    """Observed minus predicted brightness at the observed points."""
    uncertainty: FitUncertainty
    duration_s: float

    @cached_property
    def parameters(self) -> dict[str, float]:
        """All parameters by name, the searched ones and those solved linearly."""
        level, darkening, brightening = self.brightness_coefficients.tolist()
        linear = {"loss": level - 1, "darkening_per_mm": darkening / level, "brightening_per_mm": brightening / level}
        return {**asdict(self.press), **linear}

    @property
    def centre_px(self) -> Float[Array, "2"]:
        """The centre of the contact, (x, y) in the rectified image."""
        before = self.problem.observed.before
        rows, cols = before.grey.shape
        middle_px = np.array([(cols - 1) / 2, (rows - 1) / 2])
        return np.asarray(np.array(self.press.centre_mm) / before.mm_per_px + middle_px)

    @property
    def gel(self) -> Gel:
        """The design's gel with the fitted thickness and base; a base that is rigid by design stays rigid."""
        designed, press = self.problem.model.design.gel, self.press
        ratio = 0.0 if designed.has_rigid_base else press.gel_to_base_modulus_ratio
        return replace(designed, thickness_mm=press.thickness_mm, gel_to_base_modulus_ratio=ratio)

    @property
    def relative_depth_std(self) -> float:
        """Standard deviation of the depth of the press, relative to the depth."""
        return self.uncertainty.standard_deviations["depth_mm"] / self.press.depth_mm

    @cached_property
    def contact(self) -> Contact:
        """The solved contact of the skin under the ball, with pressures in shear moduli."""
        return self.problem.model.contact(self.press)

    @property
    def image_rmse_grey_levels(self) -> float:
        """Root mean square residual over all observed points."""
        return float(np.sqrt(np.mean(self.residual_grey_levels**2)))

    @cached_property
    def radial_rmse_grey_levels(self) -> float:
        """Root mean square of the mean residuals of rings of 0.05 mm, 0.1 to 8 mm from the contact's centre."""
        radius_mm, residual = self.radial_profile(self.residual_grey_levels, 0.05)
        return float(np.sqrt(np.mean(residual[(radius_mm > 0.1) & (radius_mm < 8.0)] ** 2)))

    def radial_profile(
        self, values: Float[Array, " n"], ring_width_mm: float
    ) -> tuple[Float[Array, " rings"], Float[Array, " rings"]]:
        """Return the radii in mm of rings about the contact's centre, and the mean of values at the observed points in each."""
        x, y = self.problem.observed.points_mm
        ring = (np.hypot(x - self.press.x_mm, y - self.press.y_mm).ravel() / ring_width_mm).astype(int)
        count = np.bincount(ring)
        occupied = np.flatnonzero(count)
        return (occupied + 0.5) * ring_width_mm, np.bincount(ring, values)[occupied] / count[occupied]

    @cached_property
    def light(self) -> BrightnessModel:
        """The fitted brightness model of the sensor. The loss of light is proportional to the mean darkening of the whole view."""
        observed, parameters = self.problem.observed, self.parameters
        darkening = mean_view_darkening(observed.after.grey, observed.before.grey, parameters["loss"])
        return BrightnessModel(
            darkening_per_mm=max(parameters["darkening_per_mm"], 0.0),
            saturation=self.press.saturation,
            brightening_per_mm=max(parameters["brightening_per_mm"], 0.0),
            point_spread_mm=self.press.point_spread_mm,
            global_dimming=max(-parameters["loss"], 0.0) / darkening if darkening > 0 else 0.0,
            inverse_distance_per_mm=self.press.inverse_distance_per_mm,
            thickness_mm=self.problem.model.design.gel.thickness_mm,
        )


@dataclass(frozen=True)
class ParameterPrior:
    """Prior knowledge of a parameter, from other sources than the image."""

    name: str
    value: float
    standard_deviation: float


@dataclass(frozen=True)
class KnownBase:
    """The base of a gel as known loads tell it, which the fit takes as it is."""

    modulus_ratio: float
    """Modulus of the gel over that of the base."""
    std: float = 0.0
    """Its standard deviation, which moves the other parameters along with it."""

    @property
    def held(self) -> ParameterPrior:
        """The prior that holds the base there."""
        return ParameterPrior("gel_to_base_modulus_ratio", self.modulus_ratio, _HELD_STD)


@dataclass(frozen=True)
class _PriorTerms:
    """Prior terms as observations beside those of the image."""

    priors: tuple[ParameterPrior, ...]
    grey_levels_per_std: float
    """Grey levels that correspond to one standard deviation of a prior: the residual of an independent observation."""

    def residual(self, vector: ParameterVector) -> Float[Array, " priors"]:
        """Return the deviation of the vector from the priors, in grey levels."""
        deviations = [(vector[PARAMETER_NAMES.index(p.name)] - p.value) / p.standard_deviation for p in self.priors]
        return self.grey_levels_per_std * np.array(deviations, float)

    @property
    def jacobian(self) -> Float[Array, "priors parameters"]:
        """The derivative of the residual by the parameters."""
        rows = [np.array([name == p.name for name in PARAMETER_NAMES]) / p.standard_deviation for p in self.priors]
        return self.grey_levels_per_std * np.array(rows, float).reshape(-1, len(PARAMETER_NAMES))


def fit_twin_to_ball_press(
    press: BallPress,
    design: SensorDesign,
    priors: tuple[ParameterPrior, ...] = (),
    initial: BallPressParameters | None = None,
    base: KnownBase | None = None,
) -> TwinFit:
    """Fit mechanics and light to one press of the design's ball.

    priors: prior terms from other images. initial: initial parameters, where approximate values are known. base: the base of the
    gel, where something else than this image tells it.
    """
    start_s = perf_counter()
    observed, model = ObservedBallPress(press.before, press.after, press.centre_mm), BallPressModel(design)
    problem = BallPressProblem(observed, model)
    if initial is None:
        coarse = replace(problem, model=replace(model, patch=COARSE_PATCH))
        start = _fit_coarsely(coarse, _initial_guess(press, design))
    else:
        start = initial.vector
    start, initial_residual = _leave_some_gel(problem, start)
    observations = effective_observation_count(observed.image(initial_residual))
    priors = priors if base is None else (*priors, base.held)
    prior_terms = _make_prior_terms(design.gel, initial_residual, observations, priors)
    problem, vector, jacobian = _fit_finely(problem, start, prior_terms)
    coefficients, residual = problem.fit_linear_terms(vector)
    model_error, base_std = np.zeros_like(vector), MODULUS_RATIO_MODEL_STD if base is None else base.std
    if base_std > 0 and not design.gel.has_rigid_base:
        model_error = base_std * _change_per_modulus_ratio(problem, vector, prior_terms)
    uncertainty = estimate_uncertainty(jacobian, residual, observations, model_error)
    return TwinFit(
        problem, BallPressParameters.from_vector(vector), coefficients, residual, uncertainty, perf_counter() - start_s
    )


def _leave_some_gel(problem: BallPressProblem, start: ParameterVector) -> tuple[ParameterVector, Float[Array, " n"]]:
    """Return the parameters with a depth that leaves some gel under the ball, and their residual.

    A coarse grid, which has no point under the ball's lowest, allows a little more, and so does a softer base.
    """
    possible = start.copy()
    _, residual = problem.fit_linear_terms(possible)
    while not np.isfinite(residual).all():
        possible[PARAMETER_NAMES.index("depth_mm")] *= _SHALLOWER
        _, residual = problem.fit_linear_terms(possible)
    return possible, residual


def _initial_guess(press: BallPress, design: SensorDesign) -> ParameterVector:
    """Return the initial guess from the disc: its centre, the depth by the rule of its edge, the drag by the asymmetry
    of its bulge.
    """
    ball_mm = design.ball.radius_mm
    radius_mm = press.edge_radius_mm
    if radius_mm >= ball_mm:
        radius_mm = WIDE_DISC_RADIUS * ball_mm
    depth_mm = spherical_cap_height_mm(ball_mm, radius_mm) - EDGE_RULE_BIAS_MM
    x, y = press.centre_mm
    drag = dict(
        zip(("drag_x_mm", "drag_y_mm"), DRAG_PER_ASYMMETRY_MM * np.array(press.circle.asymmetry_vector), strict=True)
    )
    guess = {"x_mm": x, "y_mm": y, "depth_mm": depth_mm, **drag, **TYPICAL_PARAMETERS}
    guess["thickness_mm"] *= design.gel.thickness_mm / SensorDesign().gel.thickness_mm
    guess["gel_to_base_modulus_ratio"] = max(design.gel.gel_to_base_modulus_ratio, NEARLY_RIGID)
    lower, upper = parameter_bounds()
    return np.clip([guess[name] for name in PARAMETER_NAMES], lower + 1e-3, upper - 1e-3)


def _fit_coarsely(problem: BallPressProblem, start: ParameterVector) -> ParameterVector:
    """Return the least-squares parameters from a distant start, by a trust-region method, without prior terms."""

    def residual(vector: ParameterVector) -> Float[Array, " n"]:
        return problem.fit_linear_terms(vector)[1]

    def jacobian(vector: ParameterVector) -> Float[Array, "n parameters"]:
        return _image_jacobian(problem.starting_from(vector), vector, residual(vector))

    lower, upper = parameter_bounds()
    scales = parameter_scales()
    solution = least_squares(
        residual,
        start,
        jacobian,
        (lower, upper),
        x_scale=scales,
        ftol=COARSE_TOLERANCE,
        xtol=1e-3,
        max_nfev=MAX_COARSE_STEPS,
    )
    return np.asarray(solution.x)


def _fit_finely(
    problem: BallPressProblem, start: ParameterVector, prior_terms: _PriorTerms
) -> tuple[BallPressProblem, ParameterVector, Float[Array, "n parameters"]]:
    """Return the problem with the contacts of the last iteration as first guesses, the least-squares parameters with prior terms,
    and the last Jacobian of the residual, with one row for every prior. They are found from a start near by, by Gauss–Newton.

    The contacts are solved to a tolerance, so the sum of squares scatters from one vector to the next, and a search that waits for
    the smallest differences of it does not end. This one ends where the linearised problem predicts too small a reduction, or where
    no step length reduces the sum of squares.
    """

    def stacked_residual(vector: ParameterVector) -> Float[Array, " n"]:
        return np.append(problem.fit_linear_terms(vector)[1], prior_terms.residual(vector))

    vector = start
    residual = stacked_residual(start)
    reused_jacobian = None
    for _ in range(MAX_FINE_STEPS):
        problem = problem.starting_from(vector)
        image_residual = residual[: problem.observed.count]
        image_jacobian = _image_jacobian(problem, vector, image_residual, reused_jacobian)
        jacobian = np.vstack([image_jacobian, prior_terms.jacobian])
        step = _bounded_step(jacobian, residual, vector)
        sum_of_squares = np.sum(residual**2)
        predicted_reduction = 1 - np.sum((residual + jacobian @ step) ** 2) / sum_of_squares
        if not predicted_reduction > FINE_TOLERANCE:
            break
        reused_jacobian = jacobian if predicted_reduction < DERIVATIVE_REUSE_REDUCTION else None
        for step_length in STEP_LENGTHS:
            candidate = vector + step_length * step
            candidate_residual = stacked_residual(candidate)
            if np.sum(candidate_residual**2) < sum_of_squares:
                vector = candidate
                residual = candidate_residual
                break
        else:
            break
    return problem, vector, jacobian


def _change_per_modulus_ratio(
    problem: BallPressProblem, vector: ParameterVector, prior_terms: _PriorTerms
) -> ParameterVector:
    """Return how the best parameters change with the modulus of the gel over that of its base, from a fit with another base.

    A difference over what is not known of the base says more than the derivative, because the fit is far from linear in it.
    """
    start, base = vector.copy(), PARAMETER_NAMES.index("gel_to_base_modulus_ratio")
    stiffer = vector[base] > MODULUS_RATIO_MODEL_STD / 2  # towards a rigid base the press changes most
    start[base] = (
        max(vector[base] - MODULUS_RATIO_MODEL_STD, NEARLY_RIGID) if stiffer else vector[base] + MODULUS_RATIO_MODEL_STD
    )
    start, _ = _leave_some_gel(problem, start)
    others = tuple(prior for prior in prior_terms.priors if prior.name != "gel_to_base_modulus_ratio")
    held = ParameterPrior("gel_to_base_modulus_ratio", float(start[base]), _HELD_STD)
    _, moved, _ = _fit_finely(problem, start, replace(prior_terms, priors=(*others, held)))
    return np.asarray((moved - vector) / (moved[base] - vector[base]))


def _bounded_step(
    jacobian: Float[Array, "n parameters"], residual: Float[Array, " n"], vector: ParameterVector
) -> ParameterVector:
    """Return the step that minimises the linearised sum of squares within the bounds of the parameters."""
    lower, upper = parameter_bounds()
    cholesky = np.linalg.cholesky(jacobian.T @ jacobian)
    target = -np.linalg.solve(cholesky, jacobian.T @ residual)
    return np.asarray(lsq_linear(cholesky.T, target, (lower - vector, upper - vector), method="bvls").x)


def _make_prior_terms(
    gel: Gel, residual: Float[Array, " n"], observations: float, priors: tuple[ParameterPrior, ...]
) -> _PriorTerms:
    """Return the design's thickness and base and other priors, each as one observation among this many independent ones."""
    thickness = ParameterPrior("thickness_mm", gel.thickness_mm, RELATIVE_THICKNESS_STD * gel.thickness_mm)
    base = ParameterPrior("gel_to_base_modulus_ratio", gel.gel_to_base_modulus_ratio, MODULUS_RATIO_STD)
    if gel.has_rigid_base:  # by choice: a design without a layer that yields
        base = ParameterPrior("gel_to_base_modulus_ratio", NEARLY_RIGID, _HELD_STD * NEARLY_RIGID)
    grey_levels_per_std = float(np.sqrt(np.sum(residual**2) / observations))
    return _PriorTerms((thickness, base, *priors), grey_levels_per_std)


def _image_jacobian(
    problem: BallPressProblem,
    vector: ParameterVector,
    residual: Float[Array, " n"],
    reused_jacobian: Float[Array, "rows parameters"] | None = None,
) -> Float[Array, "n parameters"]:
    """Return the derivative of the residual by each searched parameter, with level and slopes refitted (variable projection).

    residual: that at this vector. reused_jacobian: that at a vector near by, whose derivatives by the parameters of the contact are
    reused.
    """
    columns = []
    for index, parameter in enumerate(FIT_PARAMETERS):
        if reused_jacobian is not None and parameter.moves_contact:
            columns.append(reused_jacobian[: residual.size, index])
            continue
        perturbed, step = perturb_parameter(vector, index)
        change = problem.fit_linear_terms(perturbed)[1] - residual
        if not np.isfinite(change).all():  # deeper than the gel allows: take the other side
            step = -step
            perturbed = vector.copy()
            perturbed[index] += step
            change = problem.fit_linear_terms(perturbed)[1] - residual
        columns.append(change / step)
    return np.column_stack(columns)

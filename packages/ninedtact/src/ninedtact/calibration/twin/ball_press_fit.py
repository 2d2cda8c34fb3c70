"""The fit of the digital twin to presses: the pose of every press, the thickness of the gel and its base, and the brightness model
that explain the whole images, with their uncertainties. In: a `BallPress` of the design's ball, and any number of `ObjectPress`, of
other balls or of flat ends at a known depth, on the same gel. Out: `TwinFit`, from `fit_twin_to_ball_press`.

The residual is not noise but a model error, smooth over millimetres. The number of independent observations is therefore estimated
from the residual itself, and the design's gel thickness is added as one more observation. Where the residual is plain noise, that
observation has no weight.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from time import perf_counter

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.ball.ball_press import BallPress
from ninedtact.calibration.ball.second_press import ObjectPress, PressedBall, PressedObject
from ninedtact.calibration.twin.fit_parameters import (
    BASE_INDEX,
    NEARLY_RIGID,
    PARAMETER_NAMES,
    FitUncertainty,
    effective_observation_count,
    estimate_uncertainty,
    join_presses,
    model_error_share,
    parameter_bounds,
    split_by_press,
)
from ninedtact.calibration.twin.gel_base import (
    MODULUS_RATIO_MODEL_STD,
    KnownBase,
    change_per_modulus_ratio,
    estimate_base,
    on_coarse_grid,
)
from ninedtact.calibration.twin.implied_length import (
    ImpliedLength,
    JointFit,
    estimate_ball_radius_from_fit,
    estimate_depth_from_fit,
)
from ninedtact.calibration.twin.observed_presses import ObservedRoundPress
from ninedtact.calibration.twin.press_search import (
    BallPressProblem,
    JointPressProblem,
    ParameterPrior,
    PriorTerms,
    fit_coarsely,
    fit_finely,
    leave_some_gel,
    residual_derivative,
)
from ninedtact.design import Gel, SensorDesign
from ninedtact.mechanics.contact_result import Contact
from ninedtact.shape.depth import mean_view_darkening
from ninedtact.simulation.calibration_press_models import (
    BallPressModel,
    BallPressParameters,
    ParameterVector,
)
from ninedtact.simulation.gel_brightness import BrightnessModel

RELATIVE_THICKNESS_STD = 0.22
"""Relative standard deviation of the thickness with which moulded gels act, about the designed one: from fits to six real sensors
(benchmarks/real_sensor_twins.py)."""
MODULUS_RATIO_STD = 0.08
"""Standard deviation of the gel's modulus over that of its base, about the designed one, before the image is seen: from a rigid
base to one eight times as stiff as the gel."""
TYPICAL_PARAMETERS = {
    "thickness_mm": 2.0,
    "point_spread_mm": 0.45,
    "saturation": 0.4,
    "inverse_distance_per_mm": 0.04,
}
"""Initial values of the parameters that the contact circle does not show; the thickness is that of a gel of the published
design."""
DRAG_PER_ASYMMETRY_MM = 3.0
"""Usual drag of a press per asymmetry of its bulge; used for the initial guess only."""


@dataclass(frozen=True)
class SecondPressFit:
    """What the joint fit says of a second press."""

    press: BallPressParameters
    object: PressedObject
    residual_rms_grey_levels: float
    implied: ImpliedLength
    """What all images imply of the length that is stated: the radius of a ball, the depth of a flat end."""


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
    """Standard deviations and correlations of the searched parameters."""
    base: KnownBase
    """What is known of the base of the gel."""
    duration_s: float
    further: tuple[SecondPressFit, ...] = ()
    """The other presses that were fitted together with this one."""

    @cached_property
    def parameters(self) -> dict[str, float]:
        """All parameters by name, the searched ones and those solved linearly."""
        level, darkening, brightening = self.brightness_coefficients.tolist()
        linear = {"loss": level - 1, "darkening_per_mm": darkening / level, "brightening_per_mm": brightening / level}
        return {**asdict(self.press), **linear}

    @property
    def presses(self) -> tuple[BallPressParameters, ...]:
        """The parameters of all presses that were fitted together, this one first."""
        return self.press, *(one.press for one in self.further)

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


def fit_twin_to_ball_press(
    press: BallPress,
    design: SensorDesign,
    priors: tuple[ParameterPrior, ...] = (),
    initial: tuple[BallPressParameters, ...] = (),
    further: tuple[ObjectPress, ...] = (),
    base: KnownBase | None = None,
) -> TwinFit:
    """Fit mechanics and light to one press of the design's ball, and to further presses on the same gel together with it.

    priors: prior terms from other images. initial: initial parameters of every press, where approximate values are known. base: the
    base of the gel, where something else than these images tells it.
    """
    start_s = perf_counter()
    presses = ObjectPress(press.before, press.after, press.circle, PressedBall(design.ball.radius_mm)), *further
    problem = JointPressProblem(tuple(_press_problem(one, design) for one in presses))
    start = join_presses(list(initial)) if initial else _search_from_circles(problem, presses)
    priors = (*priors, *_known_depths(presses))
    start, residual = leave_some_gel(problem, start)
    observations = [
        effective_observation_count(one.observed.image(residual[rows]))
        for one, rows in zip(problem.presses, problem.rows, strict=True)
    ]
    prior_terms = _make_prior_terms(design.gel, residual, sum(observations), priors)
    model_std = 0.0
    if design.gel.has_rigid_base:  # by choice: a design without a layer that yields
        base = KnownBase(NEARLY_RIGID)
    elif base is None:
        # The board leads to another fit, which starts here; the grid moves it by less than its error.
        base, start = estimate_base(problem if initial else on_coarse_grid(problem), start, prior_terms)
        model_std = MODULUS_RATIO_MODEL_STD
    held = base.hold(prior_terms)
    start[BASE_INDEX] = max(base.modulus_ratio, NEARLY_RIGID)
    problem, vector, jacobian = fit_finely(problem, leave_some_gel(problem, start)[0], held, held=BASE_INDEX)
    coefficients, residual = problem.fit_linear_terms(vector)
    jacobian[: problem.row_count, BASE_INDEX] = residual_derivative(problem, vector, residual, BASE_INDEX)
    base = replace(base, std=float(np.hypot(base.std, model_std * model_error_share(jacobian, problem.rows))))
    if base.std > 0 and base.change_per_ratio is None:
        base = replace(base, change_per_ratio=change_per_modulus_ratio(problem, vector, held, base.std))
    moved_by_base = np.zeros_like(vector) if base.change_per_ratio is None else base.std * base.change_per_ratio
    uncertainty = estimate_uncertainty(jacobian, residual, sum(observations), moved_by_base)
    # What several images say of a radius, and one alone of the depth, depends on the base, which is free there.
    open_terms = held if design.gel.has_rigid_base else prior_terms
    stacked = np.append(residual, open_terms.residual(vector))
    jacobian = np.vstack([jacobian[: problem.row_count], open_terms.jacobian(vector)])
    joint = JointFit(problem, vector, jacobian, stacked, sum(observations))
    return TwinFit(
        problem.presses[0],
        split_by_press(vector)[0],
        np.array([coefficients[0], *coefficients[len(presses) :]]),
        residual[problem.rows[0]],
        uncertainty,
        base,
        perf_counter() - start_s,
        tuple(_second_press_fit(joint, open_terms, number, one.object) for number, one in enumerate(further, start=1)),
    )


def _press_problem(press: ObjectPress, design: SensorDesign) -> BallPressProblem:
    """Return what is observed of a press, with the model that predicts it."""
    observed = ObservedRoundPress(press.before, press.after, press.centre_mm, press.object.face_radius_mm)
    return BallPressProblem(observed, BallPressModel(design, indenter=press.object.indenter))


def _second_press_fit(joint: JointFit, priors: PriorTerms, number: int, pressed: PressedObject) -> SecondPressFit:
    """Return what a joint fit says of the press with this number, 0 for the first."""
    by_depth = pressed.known_depth is not None
    implied = (
        estimate_depth_from_fit(joint, priors, number) if by_depth else estimate_ball_radius_from_fit(joint, number)
    )
    rms_grey = float(np.sqrt(np.mean(joint.residual[joint.problem.rows[number]] ** 2)))
    return SecondPressFit(split_by_press(joint.vector)[number], pressed, rms_grey, implied)


def _search_from_circles(problem: JointPressProblem, presses: tuple[ObjectPress, ...]) -> ParameterVector:
    """Return approximate parameters from the contact circles of all presses, by a search on a coarse grid."""
    coarse, design = on_coarse_grid(problem), problem.presses[0].model.design
    guesses = [_initial_guess(press, design) for press in presses]
    start = join_presses([BallPressParameters.from_vector(guess) for guess in guesses])
    return fit_coarsely(coarse, leave_some_gel(coarse, start)[0])


def _known_depths(presses: tuple[ObjectPress, ...]) -> Iterator[ParameterPrior]:
    """Yield the depths that stops set, as priors."""
    for number, press in enumerate(presses, start=1):
        if press.object.known_depth is not None:
            yield ParameterPrior(f"press_{number}_depth_mm", *press.object.known_depth)


def _initial_guess(press: ObjectPress, design: SensorDesign) -> ParameterVector:
    """Return the initial guess from the disc: its centre, the depth by the rule of its edge or by the stop, the drag by the
    asymmetry of its bulge.
    """
    depth_mm = press.object.estimate_depth_mm(press.edge_radius_mm)
    x, y = press.centre_mm
    drag = dict(
        zip(("drag_x_mm", "drag_y_mm"), DRAG_PER_ASYMMETRY_MM * np.array(press.circle.asymmetry_vector), strict=True)
    )
    guess = {"x_mm": x, "y_mm": y, "depth_mm": depth_mm, **drag, **TYPICAL_PARAMETERS}
    guess["thickness_mm"] *= design.gel.thickness_mm / SensorDesign().gel.thickness_mm
    guess["gel_to_base_modulus_ratio"] = max(design.gel.gel_to_base_modulus_ratio, NEARLY_RIGID)
    lower, upper = parameter_bounds()
    return np.clip([guess[name] for name in PARAMETER_NAMES], lower + 1e-3, upper - 1e-3)


def prior_of_base(gel: Gel) -> ParameterPrior:
    """Return what is known of the base before any image: most are far stiffer than the gel, and a few are not."""
    name = "gel_to_base_modulus_ratio"
    return ParameterPrior(name, gel.gel_to_base_modulus_ratio, MODULUS_RATIO_STD, has_heavy_tails=True)


def _make_prior_terms(
    gel: Gel, residual: Float[Array, " n"], observations: float, priors: tuple[ParameterPrior, ...]
) -> PriorTerms:
    """Return the design's thickness and base and other priors, each as one observation among this many independent ones."""
    thickness = ParameterPrior("thickness_mm", gel.thickness_mm, RELATIVE_THICKNESS_STD * gel.thickness_mm)
    base = prior_of_base(gel)
    grey_levels_per_std = float(np.sqrt(np.sum(residual**2) / observations))
    return PriorTerms((thickness, base, *priors), grey_levels_per_std)

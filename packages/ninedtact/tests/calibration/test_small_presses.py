"""A ball and a board on small grids: what the forward models predict, the closed forms of the fits' parts, and their answers.

The images are drawn by the contact model, light and lines of sight of known presses. Where a figure has no closed form, it is the
one that the method had; who changes the method on purpose writes it anew.
"""

from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy import ndimage

from ninedtact.calibration.ball.ball_fit import ContactDiscFit, TwinBallFit, _refine_centre, fit_ball_by_physics
from ninedtact.calibration.ball.ball_press import BallPress, find_usable_contact_circle
from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.board.detection import lattice_to_skin_mm
from ninedtact.calibration.board.lens_fit import fit_lens_with_terms, with_radial_term_count
from ninedtact.calibration.twin import ball_press_fit, ball_press_model, board_press_model, lens_refinement
from ninedtact.calibration.twin.ball_press_fit import (
    FitUncertainty,
    ParameterPrior,
    TwinFit,
    _bounded_step,
    _estimate_uncertainty,
    _fit_coarsely,
    _fit_finely,
    _image_jacobian,
    _initial_guess,
    _make_prior_terms,
    _PriorTerms,
    effective_observation_count,
    parameter_covariance,
)
from ninedtact.calibration.twin.ball_press_model import (
    COARSE_PATCH,
    FIT_PARAMETERS,
    PARAMETER_NAMES,
    BallPressModel,
    BallPressParameters,
    ObservedBallPress,
    perturb_parameter,
)
from ninedtact.calibration.twin.board_press_model import BoardPressModel, BoardPressParameters, ObservedBoardPress
from ninedtact.calibration.twin.lens_refinement import (
    INITIAL_PRESS,
    BoardPressFit,
    _BoardPressSolver,
    _image_gradient,
    _invert_lens_projection,
    _lens_displacement_modes,
    fit_board_press_and_lens,
    refine_board_lens,
)
from ninedtact.calibration.twin.sensor_twin import _invert_rectification, make_twin_table
from ninedtact.design import PinBoard, SensorDesign
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Rectified, skin_grid_mm
from ninedtact.shape.depth import Smoothing
from ninedtact.shape.lens import LensModel
from ninedtact.shape.rectification import Rectification
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import SightlineGrid

DESIGN = SensorDesign()
SHAPE, MM_PER_PX = (96, 128), 0.18
X_MM, Y_MM = skin_grid_mm(SHAPE, MM_PER_PX)
UNTOUCHED = Rectified((150 + 2 * X_MM - 1.5 * Y_MM).astype(np.float32), MM_PER_PX)
LIGHT = BrightnessModel(0.12, 0.5, 0.35, 0.5, 0.8, 0.05)
PRESS = BallPressParameters(0.6, -0.4, 1.3, 0.3, -0.2, 2.3, 0.5, 0.5, 0.05, 0.25)
"""The drawn press: centre, depth, drag, thickness, point spread, saturation, nearness and share of finite strain."""
SAME = {"rtol": 2e-3, "atol": 1e-9}
SAME_FIT = {"rtol": 5e-3, "atol": 0}


def model_of(after: Rectified) -> BallPressModel:
    """The model of an image of the ball, on the coarse grid."""
    return BallPressModel(ObservedBallPress(UNTOUCHED, after, PRESS.centre_mm), DESIGN, COARSE_PATCH)


@pytest.fixture(scope="module")
def change() -> np.ndarray:
    """The change of brightness of every pixel, drawn through lines of sight and point spread."""
    contact = model_of(UNTOUCHED).contact(PRESS)
    sightlines = SightlineGrid(X_MM, Y_MM, PRESS.inverse_distance_per_mm)
    height_mm = sightlines.height_mm(
        COARSE_PATCH, PRESS.centre_mm, np.asarray(contact.height_mm, np.float32), fine=True
    )
    return ndimage.gaussian_filter(LIGHT.brightness_change(height_mm), PRESS.point_spread_mm / MM_PER_PX)


@pytest.fixture(scope="module")
def press(change: np.ndarray) -> BallPress:
    noise = np.random.default_rng(0).normal(0, 0.3, SHAPE)
    grey = UNTOUCHED.grey * (1 + LIGHT.image_dimming(change)) * (1 + change) + noise
    after = Rectified(grey.astype(np.float32), MM_PER_PX)
    return BallPress(UNTOUCHED, after, find_usable_contact_circle(UNTOUCHED, after, DESIGN.ball, "physics"))


@pytest.fixture(scope="module")
def model(press: BallPress) -> BallPressModel:
    return model_of(press.after)


@pytest.fixture(scope="module")
def fit(press: BallPress) -> TwinBallFit:
    """The fit by physics from the drawn press on."""
    return fit_ball_by_physics(press, DESIGN, (), PRESS)


def as_drawn(forward: BallPressModel, press: BallPressParameters = PRESS, loss: float = -0.05) -> TwinFit:
    """The fit that knows all of the drawn press."""
    coefficients = (1 + loss) * np.array([1, LIGHT.darkening_per_mm, LIGHT.brightening_per_mm])
    deviations = dict(zip(PARAMETER_NAMES, (0.1 * np.abs(press.vector)).tolist(), strict=True))
    correlation = np.eye(10)
    correlation[2, 5] = correlation[5, 2] = -0.7
    correlation[2, 7] = correlation[7, 2] = 0.4
    uncertainty = FitUncertainty(90.0, deviations, correlation)
    return TwinFit(forward, press, coefficients, np.full(forward.observed.count, -2.0), uncertainty, 1.5)


def test_a_ball_goes_down_in_steps_and_then_sideways() -> None:
    assert PRESS.poses() == [
        *(Pose(depth_mm=depth_mm) for depth_mm in (0.5, 1.0, 1.3)),
        Pose(0.15, -0.1, 1.3),
        Pose(0.3, -0.2, 1.3),
    ]
    straight = replace(PRESS, depth_mm=0.5, drag_x_mm=0.0, drag_y_mm=0.0)
    assert straight.poses() == [Pose(depth_mm=0.5)]
    assert len(replace(straight, drag_y_mm=-0.34).poses()) == 2
    assert len(replace(straight, drag_y_mm=-0.36).poses()) == 3


def test_a_step_ends_at_the_bounds_of_what_can_be_pressed() -> None:
    """Half of the sensing area, a fraction of the ball, gels from thin to thick, light from linear to saturated."""
    lower = [-12, -9, 0.1, -4, -4, 0.8, 0.05, 0, 0, 0]
    upper = [12, 9, 3, 4, 4, 6, 1.5, 5, 0.08, 1]
    for bounds, sign in ((lower, 1), (upper, -1)):
        far = np.full(10, sign * 1e3)
        np.testing.assert_allclose(PRESS.vector + _bounded_step(np.eye(10), far, PRESS.vector), bounds, atol=1e-9)
    near = np.array([0.01, -0.01] * 5)
    np.testing.assert_allclose(_bounded_step(2 * np.eye(10), near, PRESS.vector), -near / 2, atol=1e-12)


def test_a_parameter_is_moved_up_but_at_its_upper_bound_down() -> None:
    moved, step = perturb_parameter(PRESS.vector, 2)
    assert step == 0.02 and moved[2] == pytest.approx(1.32)
    at_bound, back = perturb_parameter(replace(PRESS, finite_strain=0.9).vector, 9)
    assert back == -0.1 and at_bound[9] == pytest.approx(0.8)
    np.testing.assert_array_equal(np.delete(at_bound, 9), np.delete(PRESS.vector, 9))


def test_the_predicted_ball_is_what_is_drawn(change: np.ndarray) -> None:
    forward = model_of(UNTOUCHED)
    basis = forward.linear_basis(PRESS)
    predicted = basis @ [0, LIGHT.darkening_per_mm, LIGHT.brightening_per_mm]
    np.testing.assert_allclose(predicted, change[forward.observed.fitted_pixels], atol=4e-3)
    assert np.abs(predicted).max() > 0.15
    np.testing.assert_allclose(np.linalg.norm(basis, axis=0), [39.370, 12.682, 3.3674], **SAME)


def test_level_and_slopes_are_solved_and_the_rest_is_in_grey_levels(model: BallPressModel, change: np.ndarray) -> None:
    coefficients, residual = model.fit_linear_terms(PRESS.vector)
    level = 1 + LIGHT.image_dimming(change)
    np.testing.assert_allclose(coefficients / level, [1, 0.12, 0.35], rtol=0.05)
    basis = model.linear_basis(PRESS)
    np.testing.assert_allclose(basis.T @ residual, 0, atol=1e-6)
    np.testing.assert_allclose(
        residual, (model.observed.relative_brightness - basis @ coefficients) * UNTOUCHED.grey.mean(), rtol=1e-6
    )


def test_brightness_before_the_slopes_is_linear_but_for_saturation() -> None:
    heights_mm = np.array([[-3.0, -2.5, -1.0, 0.0, 0.4]], np.float32)
    dark, bright = model_of(UNTOUCHED).brightness_terms(heights_mm, 0.0)
    np.testing.assert_allclose(dark, [[-2.5, -2.5, -1.0, 0, 0]])
    np.testing.assert_allclose(bright, [[0, 0, 0, 0, 0.4]], rtol=1e-6)
    saturated, _ = model_of(UNTOUCHED).brightness_terms(heights_mm, 1.0)
    np.testing.assert_allclose(saturated, [[-5, -5, -2 / 1.6, 0, 0]], rtol=1e-6)


def test_finite_strain_adds_its_share_and_contacts_are_kept(model: BallPressModel) -> None:
    none, half, all_of_it = (
        model.contact(replace(PRESS, finite_strain=share)).height_mm.astype(float) for share in (0, 0.5, 1)
    )
    np.testing.assert_allclose(half, (none + all_of_it) / 2, atol=1e-6)
    assert np.abs(all_of_it - none).max() == pytest.approx(0.018713, rel=2e-3)
    key = PRESS.thickness_mm, tuple(PRESS.poses())
    kept = model.cached_contacts[key]
    model.contact(replace(PRESS, finite_strain=0.3))
    assert model.cached_contacts[key] is kept


def test_first_guesses_save_iterations_and_contacts_do_not_depend_on_those_solved_before(model: BallPressModel) -> None:
    deeper = replace(PRESS, depth_mm=1.32)
    other_model = replace(model)
    other_model.contact(replace(PRESS, thickness_mm=2.33))
    alone, later = model.contact(deeper), other_model.contact(deeper)
    np.testing.assert_array_equal(later.pressure_mpa, alone.pressure_mpa)
    near = model.starting_from(PRESS)
    assert near.contact(PRESS).pressure_mpa is model.contact(PRESS).pressure_mpa
    guessed = near.contact(deeper)
    assert guessed.iterations < 0.7 * alone.iterations
    np.testing.assert_allclose(guessed.height_mm, alone.height_mm, atol=1.5e-3)


def test_smoothing_is_a_part_of_the_point_spread() -> None:
    after = UNTOUCHED.grey.copy()
    after[48, 64] *= 2
    observed = ObservedBallPress(UNTOUCHED, Rectified(after, MM_PER_PX), (0.0, 0.0))
    bump = observed.ratio - 1
    rows, cols = np.indices(SHAPE)
    assert bump.sum() == pytest.approx(1, rel=1e-3)
    for axis, middle in ((rows, 48), (cols, 64)):
        assert np.sqrt((bump * (axis - middle) ** 2).sum()) * MM_PER_PX == pytest.approx(observed.blur_mm, rel=0.01)
    assert observed.blur_mm == pytest.approx(1.5 * MM_PER_PX)
    image = observed.image(observed.relative_brightness)
    assert image.shape == (48, 64)
    assert image[24, 32] == pytest.approx(observed.ratio[48, 64])
    assert np.isnan(image[0, 0]) and np.isfinite(image).sum() == observed.count


def test_the_derivatives_of_the_image_are_those_they_were(model: BallPressModel) -> None:
    _, residual = model.fit_linear_terms(PRESS.vector)
    jacobian = _image_jacobian(model, PRESS.vector, residual)
    figures = [137.05, 144.36, 150.53, 92.199, 97.448, 56.471, 64.128, 8.4422, 99.081, 5.3682]
    np.testing.assert_allclose(np.linalg.norm(jacobian, axis=0), figures, **SAME)
    reused = _image_jacobian(model, PRESS.vector, residual, np.vstack([2 * jacobian, np.ones((3, 10))]))
    twice = [
        parameter.name for parameter, ratio in zip(FIT_PARAMETERS, (reused / jacobian)[700], strict=True) if ratio == 2
    ]
    assert twice == ["depth_mm", "drag_x_mm", "drag_y_mm", "thickness_mm"]


def test_a_guess_is_read_off_the_disc(press: BallPress) -> None:
    circle = replace(press.circle, centre_px=(73.5, 37.5), radius_px=2.4 / MM_PER_PX, asymmetry_vector=(0.05, -0.1))
    guess = _initial_guess(replace(press, circle=circle), DESIGN)
    np.testing.assert_allclose(guess, [1.8, -1.8, 0.7, 0.15, -0.3, 2.0, 0.45, 0.4, 0.04, 0.5], atol=1e-9)
    wide = replace(press, circle=replace(circle, radius_px=4.1 / MM_PER_PX))
    thick = replace(DESIGN, gel=replace(DESIGN.gel, thickness_mm=5.0))
    depth_mm, thickness_mm = _initial_guess(wide, thick)[[2, 5]]
    assert depth_mm == pytest.approx(4 - np.sqrt(16 - 3.8**2) - 0.1) and thickness_mm == pytest.approx(4.0)
    shallow = _initial_guess(replace(press, circle=replace(circle, radius_px=0.5)), DESIGN)
    thin = replace(DESIGN, gel=replace(DESIGN.gel, thickness_mm=0.5))
    assert shallow[2] == pytest.approx(0.101) and _initial_guess(press, thin)[5] == pytest.approx(0.801)
    deep = replace(DESIGN, gel=replace(DESIGN.gel, thickness_mm=12.0))
    assert _initial_guess(press, deep)[5] == pytest.approx(5.999)


def test_the_coarse_search_goes_as_it_went(
    model: BallPressModel, press: BallPress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Finite strain stays out of it: no image determines that before the rest is known."""
    monkeypatch.setattr(ball_press_fit, "MAX_COARSE_STEPS", 2)
    found = _fit_coarsely(model, _initial_guess(press, DESIGN))
    assert found[9] == pytest.approx(0.5, abs=1.01e-3)
    figures = [0.59026, -0.39103, 1.3349, 0.34307, -0.22658, 2.2095, 0.54494, 0.55756, 0.043509]
    np.testing.assert_allclose(found[:9], figures, **SAME_FIT)


def test_the_drawn_press_is_found(fit: TwinBallFit) -> None:
    twin = fit.twin_fit
    np.testing.assert_allclose(twin.press.vector[:5], PRESS.vector[:5], atol=0.02)
    assert twin.press.point_spread_mm == pytest.approx(np.hypot(0.5, 1.5 * MM_PER_PX), abs=0.05)
    assert fit.press.circle.centre_px == pytest.approx((0.6 / MM_PER_PX + 63.5, -0.4 / MM_PER_PX + 47.5), abs=0.05)
    figures = [0.59974, -0.39990, 1.2816, 0.29337, -0.19446, 2.3725, 0.53352, 0.43025, 0.047014, 0.46478]
    np.testing.assert_allclose(twin.press.vector, figures, **SAME_FIT)
    np.testing.assert_allclose(twin.brightness_coefficients, [0.99533, 0.12304, 0.35390], **SAME_FIT)
    figures = [0.0023211, 0.0020290, 0.0095398, 0.0067126, 0.0047190, 0.046102, 0.026082, 0.12430, 0.0075660, 0.16532]
    np.testing.assert_allclose(list(twin.uncertainty.standard_deviations.values()), figures, **SAME_FIT)
    assert twin.uncertainty.effective_observations == pytest.approx(88.548, rel=2e-3)
    assert (twin.image_rmse_grey_levels, twin.radial_rmse_grey_levels) == pytest.approx((0.063203, 0.028568), rel=5e-3)


def test_prior_knowledge_has_the_weight_of_an_observation(
    model: BallPressModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ball_press_fit, "MAX_FINE_STEPS", 2)
    _, residual = model.fit_linear_terms(PRESS.vector)
    prior = ParameterPrior("inverse_distance_per_mm", 0.08, 0.01)
    terms = _make_prior_terms(model, residual, 80.0, (prior,))
    assert terms.priors == (
        ParameterPrior("thickness_mm", 2.5, 0.55),
        ParameterPrior("finite_strain", 0.5, 0.5),
        prior,
    )
    assert terms.grey_levels_per_std == pytest.approx(np.sqrt((residual**2).sum() / 80))
    _, found, jacobian = _fit_finely(model, PRESS.vector, terms)
    figures = [0.59683, -0.39733, 1.3097, 0.30854, -0.20492, 2.2764, 0.57386, 0.75001, 0.072758, 0.29856]
    np.testing.assert_allclose(found, figures, **SAME_FIT)
    assert jacobian.shape == (model.observed.count + 3, 10)
    np.testing.assert_allclose(jacobian[-3:], terms.jacobian)


class BentModel(BallPressModel):
    """Residuals: the arc tangent of twice the deviation from the drawn press at a saturation of 2.5, and one that stays."""

    def fit_linear_terms(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """No image is predicted."""
        return np.ones(3), np.append(np.arctan(2 * (vector - replace(PRESS, saturation=2.5).vector)), 0.1)


def test_a_step_that_goes_too_far_is_shortened(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method for the arc tangent diverges from 1.39 on."""
    bent = BentModel(ObservedBallPress(UNTOUCHED, UNTOUCHED, (0.0, 0.0)), DESIGN)
    start, no_priors = replace(PRESS, saturation=3.3).vector, _PriorTerms((), 1.0)
    newton_step = -np.arctan(1.6) * (1 + 1.6**2) / 2
    _, found, _ = _fit_finely(bent, start, no_priors)
    np.testing.assert_allclose(found, replace(PRESS, saturation=2.5).vector, atol=1e-3)
    monkeypatch.setattr(ball_press_fit, "MAX_FINE_STEPS", 1)
    _, found, _ = _fit_finely(bent, start, no_priors)
    assert found[7] == pytest.approx(3.3 + 0.4 * newton_step, abs=0.05)


def test_prior_terms_are_deviations_in_grey_levels() -> None:
    terms = _PriorTerms((ParameterPrior("depth_mm", 1.1, 0.1), ParameterPrior("saturation", 0.9, 0.2)), 3.0)
    np.testing.assert_allclose(terms.residual(PRESS.vector), [6, -6])
    step = np.linspace(0.1, 1, 10)
    np.testing.assert_allclose(
        terms.residual(PRESS.vector + step), terms.residual(PRESS.vector) + terms.jacobian @ step
    )
    assert _PriorTerms((), 1.0).jacobian.shape == (0, 10)


def test_uncertainty_is_that_of_least_squares_with_fewer_observations() -> None:
    rng = np.random.default_rng(1)
    jacobian, residual = rng.normal(size=(60, 10)), rng.normal(size=60)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * (residual @ residual)
    np.testing.assert_allclose(parameter_covariance(jacobian, residual, 40.0), covariance / 30, rtol=1e-9)
    np.testing.assert_allclose(parameter_covariance(jacobian, residual, 5.0), covariance, rtol=1e-9)
    jacobian[:, 3] = 0
    uncertainty = _estimate_uncertainty(jacobian, residual, 40.0)
    known = np.delete(np.arange(10), 3)
    expected = parameter_covariance(jacobian[:, known], residual, 39.0)
    deviations = np.array(list(uncertainty.standard_deviations.values()))
    np.testing.assert_allclose([deviations[3], *uncertainty.correlation[3]], 0, atol=1e-12)
    np.testing.assert_allclose(deviations[known], np.sqrt(np.diag(expected)))
    np.testing.assert_allclose(np.diag(uncertainty.correlation)[known], 1)
    covariances = uncertainty.correlation * np.outer(deviations, deviations)
    np.testing.assert_allclose(covariances[np.ix_(known, known)], expected, atol=1e-12)


def test_correlated_observations_count_by_their_correlations() -> None:
    """A field of the first neighbour's correlation q in one direction counts as n/(1 + 2q) observations."""
    rng = np.random.default_rng(2)
    assert effective_observation_count(np.add.outer(np.arange(20.0), np.arange(20.0)) - 19) == 11
    white = rng.normal(size=(150, 151))
    pairs = white[:, 1:] + white[:, :-1]
    pairs[:, 70:75] = np.nan
    assert effective_observation_count(pairs) == pytest.approx(pairs.size / 2, rel=0.03)
    assert effective_observation_count(pairs) == pytest.approx(11086, rel=1e-3)


def test_what_follows_from_a_fit(model: BallPressModel) -> None:
    twin = as_drawn(model)
    parameters = twin.parameters
    assert parameters["depth_mm"] == 1.3 and parameters["loss"] == pytest.approx(-0.05)
    assert (parameters["darkening_per_mm"], parameters["brightening_per_mm"]) == pytest.approx((0.12, 0.35))
    np.testing.assert_allclose(twin.centre_px, [0.6 / 0.18 + 63.5, -0.4 / 0.18 + 47.5])
    assert twin.relative_depth_std == pytest.approx(0.1) and twin.image_rmse_grey_levels == pytest.approx(2)
    assert twin.uncertainty.most_correlated_parameter("depth_mm") == ("thickness_mm", -0.7)
    assert twin.uncertainty.most_correlated_parameter("saturation") == ("depth_mm", 0.4)
    ratio = model.observed.after.grey / UNTOUCHED.grey / 0.95
    darkening = np.where(ratio < 0.98, 1 - ratio, 0)[::5, ::5].mean()
    assert twin.light.global_dimming == pytest.approx(0.05 / darkening, rel=1e-4)
    expected = replace(LIGHT, global_dimming=twin.light.global_dimming)
    np.testing.assert_allclose(astuple(twin.light), astuple(expected))
    brighter = as_drawn(model, loss=0.1)
    odd = replace(brighter, brightness_coefficients=np.array([1.1, -0.1, -0.1])).light
    assert (odd.darkening_per_mm, odd.brightening_per_mm, odd.global_dimming) == (0, 0, 0)


def test_rings_are_averaged_from_a_tenth_of_a_millimetre_to_eight() -> None:
    fine = Rectified(np.full((400, 400), 100, np.float32), 0.05)
    forward = BallPressModel(ObservedBallPress(fine, fine, (0.0, 0.0)), DESIGN)
    twin = as_drawn(forward, replace(PRESS, x_mm=1.01, y_mm=0.013))
    x, y = forward.observed.points_mm
    distance_mm = np.hypot(x - 1.01, y - 0.013).ravel().astype(float)
    beyond = np.where((distance_mm < 0.1) | (distance_mm >= 8), 100.0, 0.0)
    assert beyond.max() == 100 and replace(twin, residual_grey_levels=beyond).radial_rmse_grey_levels == 0
    for first, last in ((0.1, 0.15), (7.95, 8.0)):
        within = ((distance_mm >= first) & (distance_mm < last)).astype(float)
        assert replace(twin, residual_grey_levels=within).radial_rmse_grey_levels == pytest.approx(
            np.sqrt(1 / 158), rel=0.02
        )
    radius_mm, mean_mm = twin.radial_profile(distance_mm, 0.2)
    assert radius_mm[0] == pytest.approx(0.1)
    np.testing.assert_allclose(mean_mm[2:40], radius_mm[2:40], atol=0.03)


def test_the_curve_of_a_fit_by_physics_is_the_one_it_was(fit: TwinBallFit) -> None:
    curve, beyond = fit.curve, fit.curve.beyond
    assert (len(curve.darkening), len(beyond.darkening)) == (25, 8)
    np.testing.assert_allclose(curve.darkening[::8], [0, 0.044069, 0.099672, 0.17179], **SAME_FIT)
    np.testing.assert_allclose(curve.indentation_mm, np.linspace(0, fit.twin_fit.press.depth_mm, 25))
    np.testing.assert_allclose(curve.error_mm[::8], [0.12176, 0.12181, 0.12193, 0.12214], **SAME_FIT)
    end_mm = 0.9 * fit.twin_fit.press.thickness_mm
    step_mm = (end_mm - curve.max_indentation_mm) / 8
    np.testing.assert_allclose(beyond.indentation_mm, curve.max_indentation_mm + step_mm * np.arange(1, 9))
    np.testing.assert_allclose(beyond.error_mm, curve.error_mm[-1] + 0.2 * step_mm * np.arange(1, 9))
    drawn = -fit.twin_fit.light.brightness_change(-np.array([curve.max_indentation_mm, *beyond.indentation_mm]))
    np.testing.assert_allclose(beyond.darkening, curve.darkening[-1] + drawn[1:] - drawn[0])
    assert (curve.brightening, curve.bulge_mm) == ((0.0, fit.twin_fit.light.brightening_per_mm), (0.0, 1.0))
    assert fit.deblurring.floor == 0.01
    assert fit.deblurring.point_spread_mm == pytest.approx(
        np.sqrt(fit.twin_fit.press.point_spread_mm**2 - (1.5 * MM_PER_PX) ** 2)
    )
    assert (fit.disc.sum(), fit.height_mm.sum()) == pytest.approx((545, -89.160), rel=5e-3)
    assert fit.loss.global_dimming == fit.twin_fit.light.global_dimming
    assert (fit.cross_validation_mae_mm, fit.reconstruction_mae_mm) == pytest.approx((0.11920, 0.024712), rel=5e-3)


def test_curves_of_discs_are_those_they_were(press: BallPress) -> None:
    centred = _refine_centre(press, DESIGN)
    np.testing.assert_allclose(centred.circle.centre_px, [66.615, 45.428], atol=0.01)
    discs = {
        "ratio": [915, -757.84, 1.4358, 0.056235, 27, 0.18125, 1.4188, 0.060480, 0.057444],
        "difference": [915, -757.84, 1.4358, 0.057018, 26, 28, 1.4249, 0.062924, 0.057981],
    }
    for signal, figures in discs.items():
        fit = ContactDiscFit(centred, Smoothing(), signal, DESIGN)
        curve = fit.curve
        knots = [len(curve.darkening), curve.darkening[-1], curve.max_indentation_mm]
        errors = [curve.error_mm[1], curve.error_mm[-1]]
        disc = [fit.disc.sum(), fit.height_mm.sum(), fit.max_indentation_mm, fit.cross_validation_mae_mm]
        np.testing.assert_allclose([*disc, *knots, *errors], figures, **SAME)


def test_the_table_of_a_twin_is_of_its_fits(model: BallPressModel) -> None:
    twin = as_drawn(model)
    board = board_press_fit(depth_mm=0.7)
    table = make_twin_table(twin, 0.6, board)
    assert (table.gel.thickness_mm, table.gel.finite_strain, table.gel.poisson_ratio) == (2.3, 0.25, 0.5)
    assert (table.light, table.noise_grey_levels) == (twin.light, 0.6)
    assert table.board_press.depth_std_mm == pytest.approx(np.hypot(0.03, 0.07))
    assert table.board_press.inverse_distance_std_per_mm == 0.005 and table.board_press.accepted
    depth, loss = table.fit.parameters["depth_mm"], table.fit.parameters["loss"]
    assert (depth.value, depth.std, depth.most_correlated_with, depth.correlation) == (
        1.3,
        pytest.approx(0.13),
        "thickness_mm",
        -0.7,
    )
    assert (loss.std, loss.most_correlated_with, loss.correlation) == (None, None, None)
    assert (table.fit.drag_mm, table.fit.duration_s, table.fit.effective_observations) == ((0.3, -0.2), 1.5, 90)
    assert make_twin_table(twin, 0.6, None).board_press is None


BOARD = PinBoard(3, 4)
NODES = np.array([(column, row) for row in range(3) for column in range(4)])
PINS_MM = lattice_to_skin_mm(NODES, BOARD, 0)
LENS = LensModel(
    (0.0625, 0.001, 0.01, -0.001, 0.0625, -0.02, 0.0003, -0.0002), (0.01, 0.0), (0.1,), (0.001, -0.001), (480, 640)
)
WRONG_LENS = replace(LENS, homography=(0.063125, 0.001, 0.01, -0.001, 0.063125, -0.02, 0.0003, -0.0002))
"""One per cent more magnification: as of a lens that is fitted to imprints."""
BOARD_PRESS = BoardPressParameters(0.7, 0.01, -0.02, 0.49, 0.05, 0.5)


def board_press_fit(
    depth_mm: float = 0.7, point_spread_mm: float = 0.5, residual: float = 0.5, converged: bool = True
) -> BoardPressFit:
    """A result whose imprints have a contrast of ten grey levels, and whose ball had a point spread of half a millimetre."""
    press = replace(BOARD_PRESS, depth_mm=depth_mm, point_spread_mm=point_spread_mm)
    deviations = BoardPressParameters(0.03, 0.001, 0.001, 0.001, 0.005, 0.01)
    return BoardPressFit(press, deviations, LENS, residual, 10.0, 0.5, converged, np.zeros((2, 1)))


@pytest.mark.parametrize(
    ("fit", "accepted"),
    [
        (board_press_fit(), True),
        (board_press_fit(converged=False), False),
        (board_press_fit(point_spread_mm=0.599), True),
        (board_press_fit(point_spread_mm=0.601), False),
        (board_press_fit(point_spread_mm=0.401), True),
        (board_press_fit(point_spread_mm=0.399), False),
        (board_press_fit(residual=0.6), True),
        (board_press_fit(residual=0.601), False),
    ],
)
def test_a_board_is_accepted_that_the_twin_explains(fit: BoardPressFit, accepted: bool) -> None:
    assert fit.accepted == accepted
    assert fit.priors == ((ParameterPrior("inverse_distance_per_mm", 0.05, 0.005),) if accepted else ())


@pytest.fixture(scope="module")
def board_model() -> BoardPressModel:
    return BoardPressModel(as_drawn(model_of(UNTOUCHED)), BOARD, 10)


@pytest.fixture(scope="module")
def board_fit() -> BoardFit:
    """The pins as found through the wrong lens."""
    pixels = LENS.to_px(PINS_MM)
    lens_fit = replace(fit_lens_with_terms(PINS_MM, pixels, LENS.raw_shape, 1), lens=WRONG_LENS)
    contrast, change = np.linspace(10, 20, 12), np.zeros((4, 4), np.float32)
    return BoardFit(BOARD, 0, lens_fit, NODES, PINS_MM, pixels, np.ones(12, bool), contrast, 0.5, change)


@pytest.fixture(scope="module")
def observed(board_model: BoardPressModel, board_fit: BoardFit) -> ObservedBoardPress:
    """The drawn board in dimmer light, rectified through the wrong lens."""
    mm_per_px = 0.11
    x, y = skin_grid_mm((90, 110), mm_per_px)
    grid_mm = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    pixels = WRONG_LENS.to_px(grid_mm)
    seen_mm = _invert_lens_projection(LENS, pixels, _invert_lens_projection(LENS, pixels, grid_mm))
    change = board_model.predict_image(BOARD_PRESS).at(seen_mm).reshape(x.shape)
    reference = (150 + 2 * x - 1.5 * y).astype(np.float32)
    pressed = reference * 0.98 * (1 + 0.003 * x) * (1 + change) + np.random.default_rng(0).normal(0, 0.3, x.shape)
    return ObservedBoardPress(
        Rectified(reference, mm_per_px), Rectified(pressed.astype(np.float32), mm_per_px), board_fit
    )


def test_the_height_under_the_board_is_solved_once_for_all_views(board_model: BoardPressModel) -> None:
    height_mm = board_model.height_mm(BOARD_PRESS)
    assert board_model.height_mm(replace(BOARD_PRESS, inverse_distance_per_mm=0.0, point_spread_mm=0.3)) is height_mm
    assert height_mm.min() == pytest.approx(-0.7, abs=0.08)
    for other in ({"depth_mm": 0.6}, {"tilt_x_rad": 0.0}, {"tilt_y_rad": 0.0}, {"poisson_ratio": 0.45}):
        assert np.abs(board_model.height_mm(replace(BOARD_PRESS, **other)) - height_mm).max() > 0.01
        assert list(board_model.cached_height_mm) == [astuple(replace(BOARD_PRESS, **other))[:4]]
    np.testing.assert_array_equal(board_model.height_mm(BOARD_PRESS), height_mm)


def test_the_predicted_board_is_the_one_it_was(board_model: BoardPressModel) -> None:
    image = board_model.predict_image(BOARD_PRESS)
    assert (image.patch.rows, image.patch.cols, image.patch.pitch_mm) == (72, 80, 0.25)
    np.testing.assert_allclose(image.at(PINS_MM[[0, 3, 8, 11]]), [-0.047124, -0.035166, -0.043049, -0.031181], **SAME)
    beside_mm = np.array([[0.0, 0.0], [5.0, 3.75], [7.5, 0.0]])
    np.testing.assert_allclose(image.at(beside_mm), [-0.003568, 0.007469, 0.01027], atol=1e-5)
    cols, rows = np.rint(image.to_px(PINS_MM[:1]))[0].astype(int)
    assert image.field[rows, cols] == pytest.approx(image.at(PINS_MM[:1])[0], rel=0.02)


def test_imprints_appear_farther_out_than_pins_are(board_model: BoardPressModel) -> None:
    """By the height of the skin around a pin, less than that of its tip, over the distance of the eye."""
    level = replace(BOARD_PRESS, tilt_x_rad=0.0, tilt_y_rad=0.0)
    appear_mm = board_model.imprints_mm(board_model.predict_image(level), PINS_MM)
    outwards = ((appear_mm - PINS_MM) * PINS_MM).sum() / (PINS_MM**2).sum()
    assert outwards < 0.7 * 0.05 and outwards == pytest.approx(0.024733, rel=2e-3)
    straight = board_model.predict_image(replace(level, inverse_distance_per_mm=0.0))
    straight_mm = board_model.imprints_mm(straight, PINS_MM)
    assert (straight_mm * PINS_MM).sum() / (PINS_MM**2).sum() - 1 == pytest.approx(0.010784, rel=5e-3)


def test_modes_of_a_lens_move_points_by_a_millimetre_in_independent_ways() -> None:
    modes = _lens_displacement_modes(LENS, PINS_MM)
    flat = modes.reshape(24, -1)
    np.testing.assert_allclose(flat.T @ flat / 12, np.eye(flat.shape[1]), atol=1e-9)
    step = 1e-6 * np.eye(len(LENS.parameters))[0]
    nudged = LENS.with_parameters(LENS.parameters + step)
    moved_mm = _invert_lens_projection(LENS, nudged.to_px(PINS_MM), PINS_MM) - PINS_MM
    within = flat @ (flat.T @ moved_mm.ravel()) / 12
    np.testing.assert_allclose(within, moved_mm.ravel(), atol=1e-3 * np.abs(moved_mm).max())


def test_the_linearised_board_is_its_difference_quotients(
    board_model: BoardPressModel, observed: ObservedBoardPress
) -> None:
    solver = _BoardPressSolver(observed, board_model, WRONG_LENS)
    points_mm = observed.points_mm
    modes = _lens_displacement_modes(WRONG_LENS, points_mm)
    problem = solver.linearise(BOARD_PRESS, points_mm, modes, None)

    def predicted(press: BoardPressParameters, at_mm: np.ndarray) -> np.ndarray:
        """The prediction in this light."""
        return light * (1 + board_model.predict_image(press).at(at_mm))

    unmoved = board_model.predict_image(BOARD_PRESS).at(points_mm)
    light = (observed.relative_brightness - problem.residual / observed.mean_grey) / (1 + unmoved)
    steps = {"depth_mm": 0.02, "tilt_x_rad": 0.003, "tilt_y_rad": 0.003, "poisson_ratio": -0.003}
    steps |= {"inverse_distance_per_mm": 0.004, "point_spread_mm": 0.02}
    for column, (name, step) in zip(problem.jacobian.T, steps.items(), strict=False):
        moved = replace(BOARD_PRESS, **{name: getattr(BOARD_PRESS, name) + step})
        quotient = (predicted(moved, points_mm) - predicted(BOARD_PRESS, points_mm)) / step * observed.mean_grey
        alike = column @ quotient / np.linalg.norm(column) / np.linalg.norm(quotient)
        assert alike > (0.9 if "tilt" in name else 1 - 1e-9), name
    for mode, column in zip(np.moveaxis(modes, -1, 0), problem.jacobian[:, 6:-3].T, strict=True):
        moved = predicted(BOARD_PRESS, points_mm + 0.02 * mode) - predicted(BOARD_PRESS, points_mm - 0.02 * mode)
        quotient = np.where(True, moved / 0.04, 0) * observed.mean_grey
        assert np.linalg.norm(column - quotient) < 0.2 * np.linalg.norm(quotient)
    plane = np.column_stack([np.ones(len(points_mm)), points_mm / 10])
    lit = plane * (1 + unmoved)[:, None] * observed.mean_grey
    np.testing.assert_allclose(problem.jacobian[:, -3:], lit, rtol=1e-9)
    np.testing.assert_allclose(lit.T @ problem.residual, 0, atol=1e-4)
    np.testing.assert_allclose(problem.contact_derivatives[0] * light * observed.mean_grey, problem.jacobian[:, 0])
    reused = solver.linearise(BOARD_PRESS, points_mm, modes, np.ones((2, len(points_mm))))
    np.testing.assert_allclose(reused.jacobian[:, [0, 3]] / reused.jacobian[:, :1], 1)
    figures = [133.48, 286.80, 396.32, 938.49, 72.534, 135.46]
    np.testing.assert_allclose(np.linalg.norm(problem.jacobian[:, :6], axis=0), figures, **SAME)


def test_a_gradient_is_per_millimetre(board_model: BoardPressModel) -> None:
    image = board_model.predict_image(BOARD_PRESS)
    rows, cols = np.indices(image.field.shape)
    ramp = replace(image, field=(2 * cols - 3 * rows).astype(np.float32))
    np.testing.assert_allclose(_image_gradient(ramp, PINS_MM), np.tile([24, -36], (12, 1)), rtol=1e-3)


def test_steps_of_a_board_press_are_limited(board_model: BoardPressModel, observed: ObservedBoardPress) -> None:
    solver = _BoardPressSolver(observed, board_model, WRONG_LENS)
    far = np.full(6, 10.0)
    up, down = (np.array(astuple(solver.bounded_step(INITIAL_PRESS, step))) for step in (far, -far))
    np.testing.assert_allclose(up, [1.0, 0.02, 0.02, 0.5, 0.06, 0.7])
    np.testing.assert_allclose(down, [0.6, -0.02, -0.02, 0.485, 0.0, 0.3])
    highest = BoardPressParameters(5.0, 0.09, 0.09, 0.5, 0.09, 1.4)
    lowest = BoardPressParameters(0.2, -0.09, -0.09, 0.352, 0.01, 0.2)
    np.testing.assert_allclose(
        astuple(solver.bounded_step(highest, far)), [0.9 * PRESS.thickness_mm, 0.1, 0.1, 0.5, 0.1, 1.5]
    )
    np.testing.assert_allclose(astuple(solver.bounded_step(lowest, -far)), [0.1, -0.1, -0.1, 0.35, 0, 0.1])


def test_the_drawn_board_is_found(board_model: BoardPressModel, observed: ObservedBoardPress) -> None:
    solver = _BoardPressSolver(observed, board_model, WRONG_LENS)
    assert not solver.solve(BOARD_PRESS, WRONG_LENS, 1).converged
    fit = solver.solve(BOARD_PRESS, WRONG_LENS, 4)
    assert fit.accepted and fit.contrast_grey_levels == 15 and fit.ball_point_spread_mm == 0.5
    np.testing.assert_allclose(fit.press.vector, [*BOARD_PRESS.vector[:5], 0.525], rtol=0.06)
    np.testing.assert_allclose(fit.lens.to_px(PINS_MM), LENS.to_px(PINS_MM), atol=0.5)
    figures = [0.69880, 0.010566, -0.019822, 0.48964, 0.048934, 0.52508]
    np.testing.assert_allclose(fit.press.vector, figures, **SAME_FIT)
    assert fit.residual_rms_grey_levels == pytest.approx(0.056381, rel=5e-3)


def test_the_fit_of_a_board_goes_as_it_went(
    board_model: BoardPressModel, observed: ObservedBoardPress, board_fit: BoardFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lens_refinement, "MAX_COARSE_ITERATIONS", 3)
    monkeypatch.setattr(lens_refinement, "MAX_FINE_ITERATIONS", 2)
    fit = fit_board_press_and_lens(observed, board_model.twin_fit)
    assert not fit.converged and len(fit.lens.radial) == 3
    figures = [0.69829, 0.010229, -0.019352, 0.48877, 0.034762, 0.52861]
    np.testing.assert_allclose(fit.press.vector, figures, **SAME_FIT)
    figures = [0.004833, 0.000557, 0.000495, 0.000615, 0.007653, 0.002661]
    np.testing.assert_allclose(fit.standard_deviations.vector, figures, rtol=1e-2)
    np.testing.assert_allclose(fit.lens.to_px(PINS_MM[[0, 11]]), [[246.006, 183.600], [399.144, 282.284]], atol=0.01)
    refined = refine_board_lens(board_fit, board_model.twin_fit, fit)
    assert refined.lens == fit.lens and refined.correction is None
    imprints_mm = BoardPressModel(board_model.twin_fit, BOARD).imprints_mm(
        BoardPressModel(board_model.twin_fit, BOARD).predict_image(fit.press), PINS_MM
    )
    np.testing.assert_allclose(refined.lens_fit.points_mm, imprints_mm, atol=1e-9)


def test_a_board_unlike_the_ball_is_not_fitted_on_the_fine_grid(
    board_model: BoardPressModel, observed: ObservedBoardPress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lens_refinement, "MAX_COARSE_ITERATIONS", 1)
    monkeypatch.setattr(lens_refinement, "MAX_FINE_ITERATIONS", 1)
    lens = with_radial_term_count(WRONG_LENS, 3)
    coarse = _BoardPressSolver(observed, board_model, lens).solve(INITIAL_PRESS, lens, 1)
    for ball_point_spread_mm, stays in ((0.95, True), (0.8, False)):
        twin = replace(board_model.twin_fit, press=replace(PRESS, point_spread_mm=ball_point_spread_mm))
        fit = fit_board_press_and_lens(observed, twin)
        assert fit.point_spread_difference > 0.3 and (fit.press == coarse.press) == stays


def test_a_fit_of_a_board_goes_on_from_the_press_of_an_earlier_one(
    board_model: BoardPressModel, observed: ObservedBoardPress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the fine grid, and with the lens through which the image is rectified now."""
    monkeypatch.setattr(lens_refinement, "MAX_FINE_ITERATIONS", 1)
    lens = with_radial_term_count(WRONG_LENS, 3)
    fine = _BoardPressSolver(observed, BoardPressModel(board_model.twin_fit, BOARD), lens)
    fit = fit_board_press_and_lens(observed, board_model.twin_fit, board_press_fit())
    assert fit.press == fine.solve(BOARD_PRESS, lens, 1).press


def test_a_contact_that_misses_its_tolerance_is_a_prediction_too(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (ball_press_model, board_press_model):
        hasty = replace(module.SOLVER_SETTINGS, tolerance=1e-9, max_rounds=1)
        monkeypatch.setattr(module, "SOLVER_SETTINGS", hasty)
    forward = model_of(UNTOUCHED)
    assert forward.contact(replace(PRESS, depth_mm=0.4)).height_mm.min() < -0.3
    assert BoardPressModel(as_drawn(forward), BOARD, 10).height_mm(BOARD_PRESS).min() < -0.5


def test_raw_pixels_see_the_skin_that_the_rectification_takes_from_them() -> None:
    """Points that the raw image does not show, marked by −1, have no part in it."""
    x, y = skin_grid_mm((173, 230), 0.1)
    points_mm = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    source_px = LENS.to_px(points_mm).reshape(173, 230, 2).astype(np.float32)
    source_px[:30] = -1
    seen_mm = _invert_rectification(Rectification(source_px, 0.1, LENS.raw_shape, (-11.5, -8.7, 11.5, 8.7))).plane_mm
    assert seen_mm.shape == (480, 640, 2)
    pixels = np.array([[100.0, 240.0], [320.0, 200.0], [320.0, 380.0], [500.0, 300.0]])
    there_mm = seen_mm[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    np.testing.assert_allclose(LENS.to_px(there_mm.astype(float)), pixels, atol=0.1)

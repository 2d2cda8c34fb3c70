"""A ball and a board on small grids: what the forward models predict, the closed forms of the fits' parts, and their answers.

The images are drawn by the contact model, light and lines of sight of known presses.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from ninedtact.calibration.ball.ball_fit import TwinBallFit, fit_ball_by_physics
from ninedtact.calibration.ball.ball_press import BallPress, find_usable_contact_circle
from ninedtact.calibration.board.detection import lattice_to_skin_mm
from ninedtact.calibration.twin.ball_press_fit import TwinFit
from ninedtact.calibration.twin.fit_parameters import (
    PARAMETER_NAMES,
    FitUncertainty,
    effective_observation_count,
    parameter_covariance,
)
from ninedtact.calibration.twin.gel_base import KnownBase
from ninedtact.calibration.twin.lens_refinement import (
    appearing_imprints_mm,
)
from ninedtact.calibration.twin.observed_presses import ObservedRoundPress
from ninedtact.calibration.twin.press_search import BallPressProblem
from ninedtact.calibration.twin.sensor_twin import assemble_twin
from ninedtact.design import Gel, PinBoard, SensorDesign
from ninedtact.quantities import Rectified, skin_grid_mm
from ninedtact.shape.lens_and_rectification import LensModel, Rectification
from ninedtact.simulation.calibration_press_models import (
    COARSE_PITCH_MM,
    BallPressModel,
    BallPressParameters,
    BoardPressModel,
    BoardPressParameters,
)
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import SightlineGrid

DESIGN = SensorDesign()
SHAPE, MM_PER_PX = (96, 128), 0.18
X_MM, Y_MM = skin_grid_mm(SHAPE, MM_PER_PX)
UNTOUCHED = Rectified((150 + 2 * X_MM - 1.5 * Y_MM).astype(np.float32), MM_PER_PX)
LIGHT = BrightnessModel(0.12, 0.5, 0.35, 0.5, 0.8, 0.05)
PRESS = BallPressParameters(0.6, -0.4, 1.3, 0.3, -0.2, 2.3, 0.5, 0.5, 0.05, 0.12)
"""The drawn press: centre, depth, drag, thickness, point spread, saturation, nearness and base."""


def problem_of(after: Rectified) -> BallPressProblem:
    """An image of the ball, and its model on the coarse grid."""
    observed = ObservedRoundPress(UNTOUCHED, after, PRESS.centre_mm)
    return BallPressProblem(observed, BallPressModel(DESIGN, COARSE_PITCH_MM))


@pytest.fixture(scope="module")
def change() -> np.ndarray:
    """The change of brightness of every pixel, drawn through lines of sight and point spread."""
    model = BallPressModel(DESIGN)
    contact = model.contact(PRESS)
    sightlines = SightlineGrid(X_MM, Y_MM, PRESS.inverse_distance_per_mm)
    height_mm, thicker_mm = (np.asarray(mm, np.float32) for mm in (contact.height_mm, contact.thickness_change_mm))
    seen_mm = sightlines.sample(model.patch, PRESS.centre_mm, height_mm, thicker_mm)
    return ndimage.gaussian_filter(LIGHT.brightness_change(seen_mm), PRESS.point_spread_mm / MM_PER_PX)


@pytest.fixture(scope="module")
def press(change: np.ndarray) -> BallPress:
    noise = np.random.default_rng(0).normal(0, 0.3, SHAPE)
    grey = UNTOUCHED.grey * (1 + LIGHT.image_dimming(change)) * (1 + change) + noise
    after = Rectified(grey.astype(np.float32), MM_PER_PX)
    return BallPress(
        UNTOUCHED, after, find_usable_contact_circle(UNTOUCHED, after, DESIGN.ball, "physics"), DESIGN.ball
    )


@pytest.fixture(scope="module")
def problem(press: BallPress) -> BallPressProblem:
    return problem_of(press.after)


@pytest.fixture
def model() -> BallPressModel:
    return BallPressModel(DESIGN, COARSE_PITCH_MM)


@pytest.fixture(scope="module")
def fit(press: BallPress) -> TwinBallFit:
    """The fit by physics from the drawn press on, with its base."""
    return fit_ball_by_physics(press, DESIGN, (), (PRESS,), base=KnownBase(PRESS.gel_to_base_modulus_ratio))


def as_drawn(problem: BallPressProblem, press: BallPressParameters = PRESS, loss: float = -0.05) -> TwinFit:
    """The fit that knows all of the drawn press."""
    coefficients = (1 + loss) * np.array([1, LIGHT.darkening_per_mm, LIGHT.brightening_per_mm])
    deviations = dict(zip(PARAMETER_NAMES, (0.1 * np.abs(press.vector)).tolist(), strict=True))
    correlation = np.eye(10)
    correlation[2, 5] = correlation[5, 2] = -0.7
    correlation[2, 7] = correlation[7, 2] = 0.4
    uncertainty = FitUncertainty(90.0, deviations, correlation)
    return TwinFit(
        problem, press, coefficients, np.full(problem.observed.count, -2.0), uncertainty, KnownBase(0.02), 1.5
    )


def test_the_predicted_ball_is_what_is_drawn(change: np.ndarray) -> None:
    problem = problem_of(UNTOUCHED)
    basis = problem.linear_basis(PRESS)
    predicted = basis @ [0, LIGHT.darkening_per_mm, LIGHT.brightening_per_mm]
    np.testing.assert_allclose(predicted, change[problem.observed.fitted_pixels], atol=4e-3)
    assert np.abs(predicted).max() > 0.12


def test_first_guesses_save_iterations_and_contacts_do_not_depend_on_those_solved_before(model: BallPressModel) -> None:
    deeper = replace(PRESS, depth_mm=1.32)
    other_model = replace(model)
    other_model.contact(replace(PRESS, thickness_mm=2.33))
    alone, later = model.contact(deeper), other_model.contact(deeper)
    np.testing.assert_array_equal(later.height_mm, alone.height_mm)
    near = model.starting_from(PRESS)
    assert near.contact(PRESS).tangential_mm is model.contact(PRESS).tangential_mm
    guessed = near.contact(deeper)
    assert guessed.iterations < 0.8 * alone.iterations
    np.testing.assert_allclose(guessed.height_mm, alone.height_mm, atol=1.5e-3)


def test_the_base_is_found_between_those_that_are_tried(press: BallPress) -> None:
    twin = fit_ball_by_physics(press, DESIGN, (), (PRESS,)).twin_fit
    assert twin.base.modulus_ratio == pytest.approx(PRESS.gel_to_base_modulus_ratio, abs=0.03)
    assert twin.press.depth_mm == pytest.approx(PRESS.depth_mm, abs=0.03)
    assert 0.02 < twin.uncertainty.standard_deviations["depth_mm"] < 0.06


def test_the_drawn_press_is_found(fit: TwinBallFit) -> None:
    twin = fit.twin_fit
    np.testing.assert_allclose(twin.press.vector[:3], PRESS.vector[:3], atol=0.02)
    assert twin.press.drag_mm == pytest.approx(PRESS.drag_mm, abs=0.06), "which follows the base"
    assert twin.press.point_spread_mm == pytest.approx(np.hypot(0.5, 1.5 * MM_PER_PX), abs=0.05)
    assert fit.press.circle.centre_px == pytest.approx((0.6 / MM_PER_PX + 63.5, -0.4 / MM_PER_PX + 47.5), abs=0.05)
    deviations = np.array(list(twin.uncertainty.standard_deviations.values()))
    assert (np.abs(twin.press.vector - PRESS.vector) < 4 * deviations)[np.arange(10) != 6].all(), (
        "the point spread includes smoothing"
    )
    assert twin.image_rmse_grey_levels < 0.3 and twin.radial_rmse_grey_levels < 0.1, "less than the noise"
    assert fit.deblurring.point_spread_mm == pytest.approx(
        np.sqrt(twin.press.point_spread_mm**2 - (1.5 * MM_PER_PX) ** 2)
    )
    assert (np.diff(fit.curve.darkening) > 0).all()
    assert fit.curve.max_indentation_mm == pytest.approx(-twin.contact.thickness_change_mm.min())
    assert fit.curve.max_indentation_mm < twin.press.depth_mm, "the base yields"


def test_uncertainty_is_that_of_least_squares_with_fewer_observations() -> None:
    rng = np.random.default_rng(1)
    jacobian, residual = rng.normal(size=(60, 10)), rng.normal(size=60)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * (residual @ residual)
    np.testing.assert_allclose(parameter_covariance(jacobian, residual, 40.0), covariance / 30, rtol=1e-9)
    np.testing.assert_allclose(parameter_covariance(jacobian, residual, 5.0), covariance, rtol=1e-9)


def test_correlated_observations_count_by_their_correlations() -> None:
    """A field of the first neighbour's correlation q in one direction counts as n/(1 + 2q) observations."""
    rng = np.random.default_rng(2)
    assert effective_observation_count(np.add.outer(np.arange(20.0), np.arange(20.0)) - 19) == 11
    white = rng.normal(size=(150, 151))
    pairs = white[:, 1:] + white[:, :-1]
    pairs[:, 70:75] = np.nan
    assert effective_observation_count(pairs) == pytest.approx(pairs.size / 2, rel=0.03)


BOARD = PinBoard(3, 4)
NODES = np.array([(column, row) for row in range(3) for column in range(4)])
PINS_MM = lattice_to_skin_mm(NODES, BOARD, 0)
LENS = LensModel(
    (0.0625, 0.001, 0.01, -0.001, 0.0625, -0.02, 0.0003, -0.0002), (0.01, 0.0), (0.1,), (0.001, -0.001), (480, 640)
)
BOARD_PRESS = BoardPressParameters(0.7, 0.01, -0.02, 0.49, 0.05, 0.5)


@pytest.fixture(scope="module")
def board_model() -> BoardPressModel:
    twin = as_drawn(problem_of(UNTOUCHED))
    return BoardPressModel(twin.gel, twin.light, BOARD, 10)


def test_imprints_appear_farther_out_than_pins_are(board_model: BoardPressModel) -> None:
    """By the height of the skin around a pin, less than that of its tip, over the distance of the eye."""
    level = replace(BOARD_PRESS, tilt_x_rad=0.0, tilt_y_rad=0.0)
    seen, straight = (
        appearing_imprints_mm(board_model.predict_image(one), PINS_MM, BOARD.pitch_mm)
        for one in (level, replace(level, inverse_distance_per_mm=0.0))
    )
    outwards = ((seen - straight) * PINS_MM).sum() / (PINS_MM**2).sum()
    assert 0.01 < outwards < level.depth_mm * level.inverse_distance_per_mm


def test_raw_pixels_see_the_skin_that_the_rectification_takes_from_them() -> None:
    """Points that the raw image does not show, marked by −1, have no part in it."""
    x, y = skin_grid_mm((173, 230), 0.1)
    points_mm = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    source_px = LENS.to_px(points_mm).reshape(173, 230, 2).astype(np.float32)
    source_px[:30] = -1
    rectify = Rectification(source_px, 0.1, LENS.raw_shape, (-11.5, -8.7, 11.5, 8.7))
    twin = assemble_twin("known", Gel(), LIGHT, rectify, np.zeros((480, 640, 3), np.uint8), 0.6)
    seen_mm = twin.renderer.pixel_map.plane_mm
    assert seen_mm.shape == (480, 640, 2)
    pixels = np.array([[100.0, 240.0], [320.0, 200.0], [320.0, 380.0], [500.0, 300.0]])
    there_mm = seen_mm[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    np.testing.assert_allclose(LENS.to_px(there_mm.astype(float)), pixels, atol=0.1)

"""The board drawn by a twin: what is known of it is found again, and a board that is not like it is not accepted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ninedtact.calibration.procedure import Calibration, CalibrationImages, calibrate
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.calibration.twin.lens_refinement import fit_board_press_and_lens
from ninedtact.calibration.twin.observed_presses import ObservedBoardPress
from ninedtact.quantities import Frame, skin_grid_mm
from ninedtact.simulation.calibration_images import HandPressImperfections, simulate_calibration_images
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.twin import Twin, default_twin
from ninedtact_train.population.sensor_population import interpolate_image

NEARNESS, IMPRINT_MM = 0.05, 0.85
LIGHT = BrightnessModel(
    darkening_per_mm=0.15,
    saturation=0.5,
    brightening_per_mm=0.35,
    point_spread_mm=0.5,
    global_dimming=0.8,
    inverse_distance_per_mm=NEARNESS,
)


@pytest.fixture(scope="module")
def twin() -> Twin:
    """A twin whose lens, light and nearness are known."""
    standard = default_twin()
    return replace(standard, renderer=replace(standard.renderer, light=LIGHT))


@pytest.fixture(scope="module")
def images(twin: Twin) -> CalibrationImages:
    return CalibrationImages(
        **vars(simulate_calibration_images(twin, presses=HandPressImperfections(IMPRINT_MM), frames=8))
    )


@pytest.fixture(scope="module")
def steps() -> list[str]:
    """What the calibration `together` announced."""
    return []


@pytest.fixture(scope="module")
def together(images: CalibrationImages, steps: list[str]) -> Calibration:
    return calibrate(images, on_step=steps.append)


@pytest.fixture(scope="module")
def apart(images: CalibrationImages) -> Calibration:
    """By a method that has no twin, so that the lens is that of the pins alone."""
    return calibrate(images, settings=CalibrationSettings(method="ratio"))


def scale_error(made: Calibration, twin: Twin) -> float:
    """Relative, over the middle of the view."""
    rectify = made.rectify
    true_mm = interpolate_image(twin.renderer.pixel_map.plane_mm, rectify.source_px)
    place_mm = np.stack(skin_grid_mm(true_mm.shape[:2], rectify.mm_per_px), axis=-1)
    middle = (np.abs(place_mm[..., 0]) < 8) & (np.abs(place_mm[..., 1]) < 6)
    return abs(float((true_mm * place_mm)[middle].sum() / (place_mm**2)[middle].sum()) - 1)


def test_the_depth_of_imprints_is_found(together: Calibration) -> None:
    assert together.record.twin is not None and together.record.twin.board_press is not None
    board_press = together.record.twin.board_press
    assert board_press.accepted
    assert board_press.depth_mm == pytest.approx(IMPRINT_MM, abs=max(3 * board_press.depth_std_mm, 0.05))
    assert board_press.inverse_distance_per_mm == pytest.approx(NEARNESS, abs=0.01)


def test_board_and_ball_are_announced_in_turn(together: Calibration, steps: list[str]) -> None:
    pins, ball, board = (
        "finding the pins of the board and fitting the lens to them",
        "fitting gel and light to the image of the ball",
        "fitting the depth of the pins and the lens to the image of the board",
    )
    assert steps == [pins, ball, board, ball, board, ball]


def test_the_lens_is_not_magnified_by_imprints(together: Calibration, apart: Calibration, twin: Twin) -> None:
    assert scale_error(apart, twin) > 0.004
    assert scale_error(together, twin) < 0.5 * scale_error(apart, twin)


def test_pins_predict_each_other_as_well(together: Calibration, apart: Calibration) -> None:
    assert together.board.lens_fit.leave_one_out_rms_mm < 1.1 * apart.board.lens_fit.leave_one_out_rms_mm


def test_the_ball_is_as_deep_as_it_was_pressed(together: Calibration) -> None:
    assert together.ball.max_indentation_mm == pytest.approx(1.8, abs=0.05)


def test_a_board_that_is_not_as_drawn_changes_nothing(calibrated_a: Calibration) -> None:
    """Pins of sensor A's board are of uneven height, and other than the design's."""
    assert calibrated_a.record.twin is not None and calibrated_a.record.twin.board_press is not None
    assert not calibrated_a.record.twin.board_press.accepted
    assert calibrated_a.board.refined is None


def test_a_missing_pin_is_not_looked_at(together: Calibration) -> None:
    board, images = together.board, (together.images.board_reference, together.images.board)
    found = board.found.copy()
    found[0] = False
    before, after = (together.rectify(Frame(image)) for image in images)
    seen = ObservedBoardPress(before, after, replace(board, found=found)).points_mm
    assert np.hypot(*(seen - board.points_mm[0]).T).min() > 0.5 * board.board.pitch_mm


FOLDING = (0.35, 1.5, -2.3)
"""Radial terms that follow a strong lens up to the outermost pins, and fold it over in the corners beyond."""


def test_places_where_a_lens_folds_the_image_are_not_looked_at(together: Calibration) -> None:
    board, images = together.board, (together.images.board_reference, together.images.board)
    before, after = (together.rectify(Frame(image)) for image in images)
    plain, folded = (
        ObservedBoardPress(before, after, replace(board, refined=replace(board.lens, radial=radial)))
        for radial in ((0.0,), FOLDING)
    )
    assert 0 < len(folded.points_mm) < len(plain.points_mm)
    assert folded.pixel_density(folded.points_mm).min() > 0 > folded.pixel_density(plain.points_mm).min()


def test_a_fit_whose_lens_folds_is_not_accepted(together: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends without an answer, and the calibration keeps the lens of the pins."""
    assert together.fits.twin is not None
    board = together.board
    before, after = (
        together.rectify(Frame(image)) for image in (together.images.board_reference, together.images.board)
    )
    astray = replace(board.lens, radial=FOLDING)
    monkeypatch.setattr(
        "ninedtact.calibration.twin.lens_refinement.refine_lens", lambda *_: SimpleNamespace(lens=astray)
    )
    board_press_fit = fit_board_press_and_lens(ObservedBoardPress(before, after, board), together.fits.twin)
    assert not board_press_fit.converged and not board_press_fit.accepted

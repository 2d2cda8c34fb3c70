"""The parts of a fitted board: which lens and errors it has, its warnings, and what is refused, on a board made up."""

from dataclasses import replace

import numpy as np
import pytest
from known_sensor import LENS

from ninedtact.calibration.board import board_fit, lens_fit, pin_imprint_centres
from ninedtact.calibration.board.board_fit import (
    BoardFit,
    PublishedPinMap,
    _add_correction,
    _require_enough_pins,
    build_rectification,
    calibrated_area_mm,
    fit_board,
)
from ninedtact.calibration.board.detection import BoardCandidate, BoardNotFound, PinLattice, lattice_to_skin_mm
from ninedtact.calibration.board.lens_fit import LensCorrectionFit, LensFit, fit_lens_with_terms
from ninedtact.design import PinBoard, SensorDesign
from ninedtact.shape.lens_and_rectification import CorrectedLensModel, LensModel, LensModelCorrection

BOARD = PinBoard()
NODES = np.array([(column, row) for row in range(7) for column in range(9)])
POINTS_MM = lattice_to_skin_mm(NODES, BOARD, 0)
STRAIGHT = LensModel((0.0625, 0.0, 0.0, 0.0, 0.0625, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0), (480, 640))
"""20 pixels per mm, without distortion."""
POINTS_PX = STRAIGHT.to_px(POINTS_MM)
LENS_FIT = fit_lens_with_terms(POINTS_MM, POINTS_PX, (480, 640), 1)


def with_error(fit: LensFit, error_mm: float) -> LensFit:
    """The same fit, of which every leave-one-out error has this length."""
    fit = replace(fit)
    fit.__dict__["leave_one_out_errors_mm"] = np.tile([error_mm, 0.0], (len(fit.points_mm), 1))
    return fit


def made_up(error_mm: float = 0.0, **parts: object) -> BoardFit:
    """The fit of a whole board."""
    change = np.zeros((480, 640), np.float32)
    fit = BoardFit(
        BOARD,
        0,
        with_error(LENS_FIT, error_mm),
        NODES,
        POINTS_MM,
        POINTS_PX,
        np.ones(63, bool),
        np.ones(63),
        0.6,
        change,
    )
    return replace(fit, **parts)


CORRECTION = LensCorrectionFit(LensModelCorrection(POINTS_MM, np.full((63, 2), 0.1), 3.0), np.full((63, 2), 0.07))
REFINED = replace(STRAIGHT, homography=(0.05, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0))


def test_the_refined_lens_and_the_correction_are_used_where_there_are_any() -> None:
    plain, refined, corrected = made_up(0.05), made_up(refined=REFINED), made_up(0.05, correction=CORRECTION)
    assert plain.lens is plain.projection is plain.lens_fit.lens and refined.lens is refined.projection is REFINED
    assert corrected.projection == CorrectedLensModel(corrected.lens, CORRECTION.correction)
    assert (plain.mm_per_px, refined.mm_per_px) == pytest.approx((0.05, 0.0625))
    assert plain.leave_one_out_errors_mm[0].tolist() == [0.05, 0.0]
    assert corrected.leave_one_out_errors_mm is CORRECTION.leave_one_out_errors_mm
    assert plain.camera_noise_grey_levels == pytest.approx(0.6 / np.sqrt(2))
    assert plain.lens_of_kind("model") is plain and plain.lens_of_kind("paper") is plain.published_map
    noisy = fit_lens_with_terms(POINTS_MM, POINTS_PX + np.random.default_rng(0).normal(0, 0.2, (63, 2)), (480, 640), 1)
    fit = made_up(lens_fit=noisy)
    assert fit.relative_scale_std == pytest.approx(noisy.mm_per_px_std(2.5) / 0.05, rel=0.01)


@pytest.mark.parametrize(("error_mm", "warned"), [(0.099, False), (0.101, True), (0.15, True)])
def test_pins_that_are_missing_or_badly_predicted_are_a_warning(error_mm: float, warned: bool) -> None:
    found = np.ones(63, bool)
    whole = made_up(error_mm).warnings
    assert len(whole) == warned and all(f"only to {error_mm:.2f} mm" in each for each in whole)
    found[[0, 62]] = False
    first, *others = made_up(error_mm, found=found).warnings
    assert "found 61 of 63 pins" in first and "column 1, row 1; column 9, row 7" in first and others == whole


@pytest.mark.parametrize(
    ("lens_mm", "paper_mm", "corrected"),
    [(0.059, 0.07, False), (0.061, 0.07, True), (0.04, 0.03, True), (0.07, 0.06, True), (0.04, 0.05, False)],
)
def test_a_lens_is_corrected_where_it_is_bad_or_worse_than_the_papers_map(
    lens_mm: float, paper_mm: float, corrected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bad is an error above 0.024 pitches of 2.5 mm."""
    monkeypatch.setattr(PublishedPinMap, "leave_one_out_rms_mm", paper_mm)
    monkeypatch.setattr(board_fit, "fit_smooth_lens_residual", lambda fit, pitch_mm: CORRECTION)
    assert _add_correction(made_up(lens_mm)).correction is (CORRECTION if corrected else None)
    monkeypatch.setattr(board_fit, "fit_smooth_lens_residual", lambda fit, pitch_mm: None)
    assert _add_correction(made_up(lens_mm)).correction is None


def lacking(board: PinBoard, *missing: int) -> bool:
    """Whether a board is refused in which these pins are missing, counted row by row."""
    nodes = np.array([(column, row) for row in range(board.rows) for column in range(board.cols)])
    found = ~np.isin(np.arange(board.count), missing)
    candidate = BoardCandidate(PinLattice(NODES, POINTS_PX, np.ones(63)), 0, LENS_FIT)
    try:
        _require_enough_pins(np.zeros((48, 64), np.float32), board, nodes, found, np.zeros((board.count, 2)), candidate)
    except BoardNotFound:
        return True
    return False


def test_a_tenth_of_the_pins_may_be_missing_but_no_side() -> None:
    assert not lacking(PinBoard(4, 5), 6, 12) and lacking(PinBoard(4, 5), 6, 7, 12)
    assert not lacking(BOARD, *range(10, 16)) and lacking(BOARD, *range(10, 17))
    large = PinBoard(20, 21)
    whole_sides = (range(21), range(399, 420), range(0, 420, 21), range(20, 420, 21))
    for side in whole_sides:
        assert lacking(large, *side) and not lacking(large, *list(side)[:-1])
    assert not lacking(large, *range(21, 42)) and not lacking(large, *range(1, 420, 21))  # rows and columns within


@pytest.mark.parametrize(("rows", "cols"), [(480, 640), (640, 480), (240, 320)])
def test_the_grid_has_the_scale_of_the_lens_at_the_size_of_the_design(rows: int, cols: int) -> None:
    design = SensorDesign(pin_board=PinBoard(7, 9, 3.0))
    rectify = build_rectification(made_up(change=np.zeros((rows, cols), np.float32)), design)
    assert rectify.mm_per_px == pytest.approx(0.05 * max(rows, cols) / 640) and rectify.raw_shape == (rows, cols)
    assert rectify.calibrated_area_mm == calibrated_area_mm(design) == (-15.0, 15.0, -12.0, 12.0)
    np.testing.assert_allclose(rectify.source_px[172, [229, 230]].mean(axis=0), [319.5, 239.5], atol=1e-3)


def test_the_papers_centres_are_those_that_they_were() -> None:
    """Smoothing and window have a part in these figures; who changes one on purpose writes them anew."""
    y, x = np.mgrid[:480, :640]
    spots = sum(np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 2 / 6.0**2) for cx, cy in POINTS_PX[:18])
    change = (-9 * spots + np.random.default_rng(0).normal(0, 8, (480, 640)) - 0.02 * x).astype(np.float32)
    found = np.arange(63) < 18
    pin_map = made_up(change=change, found=found).published_map
    np.testing.assert_array_equal(pin_map.points_px[18:], POINTS_PX[18:])
    off_x = [-1, 1, 0, 1, -1, 1, 1, 2, 2, 1, 1, 0, 1, -2, -1, 1, 1, -1]
    off_y = [-1, 1, -1, 0, 0, 0, -1, 0, 0, 0, -1, 0, 0, 0, -1, -2, -2, 0]
    np.testing.assert_array_equal(pin_map.points_px[:18] - np.floor(POINTS_PX[:18]), np.column_stack([off_x, off_y]))


FLAT = np.full((60, 80, 3), 120, np.uint8)


def test_an_image_without_a_spot_and_one_with_half_a_board_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BoardNotFound, match=r"found 0; nothing touched"):
        fit_board(FLAT, FLAT, BOARD)
    press = FLAT.copy()
    press[20:40, 30:50] = 60
    fit = with_error(LENS_FIT, 0.0)
    fit.leave_one_out_errors_mm[5:, 0] = 0.4
    candidate = BoardCandidate(PinLattice(NODES, POINTS_PX, np.ones(63)), 0, fit)
    monkeypatch.setattr(board_fit, "find_board_candidate", lambda *_: candidate)
    with pytest.raises(BoardNotFound, match=r"expected 63 pins .* found 5; press harder"):
        fit_board(FLAT, press, BOARD)


def test_a_stray_imprint_is_left_out_and_predicted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between a tenth and a quarter of the pitch from its place."""
    monkeypatch.setattr(lens_fit, "_RADIAL_TERM_COUNTS", (1,))
    monkeypatch.setattr(pin_imprint_centres, "_PATCH_SAMPLES", 15)
    lens = replace(LENS, radial=(0.4,))
    points_px, away_px = lens.to_px(POINTS_MM), lens.to_px(POINTS_MM)
    away_px[31] += [9.0, 0.0]
    across, down = (np.exp(-((np.arange(640) - away_px[:, axis, None]) ** 2) / 2 / 6.0**2) for axis in (0, 1))
    grey = np.rint(150 - 30 * down[:, :480].T @ across).astype(np.uint8)
    reference = np.full((480, 640, 3), 150, np.uint8)
    fit = LensFit(lens, POINTS_MM, points_px, lens.px_per_parameter(POINTS_MM).reshape(126, -1))
    candidate = BoardCandidate(PinLattice(NODES, points_px, np.ones(63)), 0, fit)
    monkeypatch.setattr(board_fit, "find_board_candidate", lambda *_: candidate)
    made = fit_board(reference, np.repeat(grey[..., None], 3, axis=2), BOARD)
    assert np.flatnonzero(~made.found).tolist() == [31]
    np.testing.assert_allclose(made.points_px, points_px, atol=0.3)
    assert made.noise == pytest.approx(0.1) and made.correction is None

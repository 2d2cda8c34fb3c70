"""Laws of the parts that find the board and fit the lens: lattices, imprints, the lens and its errors."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from known_sensor import LENS

from ninedtact.calibration.board.board_fit import BoardFit, PublishedPinMap, build_rectification, calibrated_area_mm
from ninedtact.calibration.board.detection import (
    DarkSpots,
    detect_dark_spots,
    find_pin_lattices,
    lattice_to_skin_mm,
)
from ninedtact.calibration.board.lens_fit import (
    LensFit,
    fit_lens,
    fit_lens_with_terms,
    fit_smooth_lens_residual,
    rms_vector_length,
)
from ninedtact.calibration.board.pin_imprint_centres import (
    find_stray_pins,
    locate_imprints_mm,
    measure_pins,
)
from ninedtact.design import PinBoard, SensorDesign
from ninedtact.errors import InputError
from ninedtact.shape.lens_and_rectification import LensModel, central_mm_per_px

RNG = np.random.default_rng(0)
BOARD = PinBoard()
NODES = np.array([(column, row) for row in range(7) for column in range(9)])
POINTS_MM = lattice_to_skin_mm(NODES, BOARD, 0)
STRAIGHT = LensModel((0.0625, 0.0, 0.0, 0.0, 0.0625, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0), (480, 640))
"""20 pixels per mm, without distortion."""


@pytest.mark.parametrize(
    ("mounting", "first", "last"),
    [
        (0, (-10, -7.5), (10, 7.5)),
        (90, (-10, 7.5), (10, -7.5)),
        (180, (10, 7.5), (-10, -7.5)),
        (270, (10, -7.5), (-10, 7.5)),
    ],
)
def test_the_first_and_the_last_pin_lie_where_the_mounting_turns_them(mounting, first, last) -> None:
    size = (9, 7) if mounting in (0, 180) else (7, 9)
    corners = lattice_to_skin_mm(np.array([(0, 0), (size[0] - 1, size[1] - 1), (1, 0)]), BOARD, mounting)
    np.testing.assert_allclose(corners[:2], [first, last])
    along = {0: (2.5, 0), 90: (0, -2.5), 180: (-2.5, 0), 270: (0, 2.5)}[mounting]
    np.testing.assert_allclose(corners[2] - corners[0], along, atol=1e-12)


def test_spots_are_found_where_they_are_strongest_first() -> None:
    y, x = np.mgrid[:120, :160]
    depths = {(40, 30): 2.0, (100, 60): 5.0, (130, 100): 3.0}
    image = -sum(depth * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 2 / 4.0**2) for at, depth in depths.items())
    spots = detect_dark_spots((image + 7).astype(np.float32), 4.0)
    assert [tuple(point) for point in spots.points_px[:3].tolist()] == [(100, 60), (130, 100), (40, 30)]
    # The Laplacian of a Gaussian spot of the sought size, times its variance, is half its depth.
    np.testing.assert_allclose(spots.strength[:3], [2.5, 1.5, 1.0], rtol=0.02)


def test_a_lattice_grows_over_a_bent_grid_and_leaves_out_what_is_off_it() -> None:
    column, row = NODES.T.astype(float)
    points = np.column_stack([40 + 30 * column + 0.6 * column**2, 30 + 28 * row + 0.5 * row * column])
    strength = np.arange(63, 0, -1.0) ** 2
    stray = points[31] + [12.0, 12.0]
    spots = DarkSpots(np.vstack([points, stray]), np.append(strength, 0.01))
    largest = max(find_pin_lattices(spots, np.array([200.0, 110.0])), key=len)
    assert len(largest) == 63
    order = np.lexsort(((largest.nodes - largest.nodes.min(axis=0))[:, 0], largest.nodes[:, 1]))
    np.testing.assert_allclose(largest.points_px[order], points)
    assert largest.score == pytest.approx(np.arange(1, 64).sum())
    part = largest.window(3, 2)
    assert sorted(part.strength.tolist(), reverse=True) == [63**2, 62**2, 61**2, 54**2, 53**2, 52**2]
    assert part.nodes.min(axis=0).tolist() == [0, 0] and part.nodes.max(axis=0).tolist() == [2, 1]


def noisy_pins(noise_px: float, seed: int, lens: LensModel = LENS) -> np.ndarray:
    """Where the pins appear, with noise."""
    return lens.to_px(POINTS_MM) + np.random.default_rng(seed).normal(0, noise_px, (63, 2))


def test_a_lens_is_fitted_exactly_and_one_wrong_pin_hardly_bends_it() -> None:
    true_px = noisy_pins(0, 0)
    fit = fit_lens_with_terms(POINTS_MM, true_px, (480, 640), 3)
    np.testing.assert_allclose(fit.lens.to_px(POINTS_MM), true_px, atol=1e-3)
    wrong = true_px.copy()
    wrong[20] += [25.0, -10.0]
    bent = fit_lens_with_terms(POINTS_MM, wrong, (480, 640), 3)
    assert np.abs(bent.lens.to_px(POINTS_MM) - true_px).max() < 1.5
    assert np.flatnonzero(find_stray_pins(bent, BOARD)).tolist() == [20]
    np.testing.assert_allclose(bent.residual_px[20], [-25.0, 10.0], atol=1.5)


def test_as_many_radial_terms_are_taken_as_predict_best() -> None:
    points_px = noisy_pins(0.05, 1)
    start = fit_lens_with_terms(POINTS_MM, points_px, (480, 640), 1).lens
    fit = fit_lens(POINTS_MM, points_px, start)
    each = [fit_lens_with_terms(POINTS_MM, points_px, (480, 640), terms).leave_one_out_rms_mm for terms in (1, 2, 3)]
    assert fit.leave_one_out_rms_mm == pytest.approx(min(each), rel=1e-3)
    assert len(fit.lens.radial) == 1 + int(np.argmin(each)) > 1
    few = np.arange(12)  # pins, less than the parameters of two radial terms
    assert len(fit_lens(POINTS_MM[few], points_px[few], start).lens.radial) == 1


def test_the_stated_error_of_the_scale_is_its_scatter() -> None:
    fits = [fit_lens_with_terms(POINTS_MM, noisy_pins(0.2, seed), (480, 640), 3) for seed in range(40)]
    scatter = np.std([central_mm_per_px(fit.lens, 2.5) for fit in fits])
    stated = np.mean([fit.mm_per_px_std(2.5) for fit in fits])
    assert stated == pytest.approx(scatter, rel=0.3)


def linear_fit(residual_px: np.ndarray, derivative: np.ndarray) -> LensFit:
    """A fit with these residuals and this Jacobian."""
    return LensFit(STRAIGHT, POINTS_MM, STRAIGHT.to_px(POINTS_MM) - residual_px, derivative)


def test_residuals_without_a_pin_are_those_of_the_fit_to_all_others() -> None:
    """Of a linear model the update is exact: the fit with a random Jacobian is repeated without each pin."""
    derivative = RNG.normal(0, 1, (126, 4))
    found = RNG.normal(0, 1, 126)
    fitted = found - derivative @ np.linalg.lstsq(derivative, found, rcond=None)[0]
    fit = linear_fit(fitted.reshape(63, 2), derivative)
    for pin in (0, 17, 62):
        others = np.arange(126) // 2 != pin
        change = np.linalg.lstsq(derivative[others], -fitted[others], rcond=None)[0]
        left_out = (fitted + derivative @ change).reshape(63, 2)
        np.testing.assert_allclose(fit.residuals_without_each_pin_px[pin], left_out, atol=1e-9)
        np.testing.assert_allclose(fit.leave_one_out_errors_mm[pin], left_out[pin] / 20, atol=1e-9)


def test_a_smooth_residual_is_corrected_and_a_straight_lens_is_left_alone() -> None:
    x, y = POINTS_MM.T
    bent_px = noisy_pins(0.02, 4) + np.column_stack([3 * np.sin(x / 2) * np.cos(y / 3), 2 * np.cos(x / 2.5)])
    fit = fit_lens_with_terms(POINTS_MM, bent_px, (480, 640), 3)
    found = fit_smooth_lens_residual(fit, 2.5)
    assert found is not None and rms_vector_length(found.leave_one_out_errors_mm) < 0.5 * fit.leave_one_out_rms_mm
    assert fit_smooth_lens_residual(fit_lens_with_terms(POINTS_MM, noisy_pins(0.1, 5), (480, 640), 3), 2.5) is None


def test_an_imprint_is_located_on_tilted_brightness() -> None:
    y, x = np.mgrid[:480, :640]
    true_mm = np.array([[1.3, -0.7], [-3.0, 2.2]])
    centres = STRAIGHT.to_px(true_mm)
    spots = sum(np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 2 / 8.0**2) for at in centres)
    image = (0.002 * x - 0.001 * y - 0.3 * spots).astype(np.float32)
    found = locate_imprints_mm(image, STRAIGHT, true_mm + np.array([[0.2, -0.15], [-0.1, 0.2]]), 1.3)
    np.testing.assert_allclose(found, true_mm, atol=0.01)


def drawn_pins(depths: np.ndarray, offsets_mm: np.ndarray) -> np.ndarray:
    """An image with a dark spot of this depth near each pin, through a lens without distortion."""
    centres = STRAIGHT.to_px(POINTS_MM + offsets_mm)
    across, down = (np.exp(-((np.arange(640) - centres[:, axis, None]) ** 2) / 2 / 6.0**2) for axis in (0, 1))
    return -((depths[:, None] * down[:, :480]).T @ across).astype(np.float32)


def test_pins_are_found_where_they_are_dark_and_near_their_place() -> None:
    depths, offsets = np.full(63, 10.0), np.zeros((63, 2))
    depths[[3, 25]] = 1.0, 1.5  # of a median contrast of 10
    offsets[[13, 31]] = [[0.75, 0.0], [0.0, -0.5]]  # of a pitch of 2.5
    image = drawn_pins(depths, offsets)
    points_px, contrast, found = measure_pins(image, STRAIGHT, POINTS_MM, 0.5, BOARD)
    assert np.flatnonzero(~found).tolist() == [3, 13]
    np.testing.assert_allclose(contrast, depths, rtol=0.03)
    seen = np.arange(63) != 13
    np.testing.assert_allclose(points_px[seen], STRAIGHT.to_px(POINTS_MM + offsets)[seen], atol=0.5)


def test_the_papers_map_without_a_pin_predicts_it_from_the_others() -> None:
    """A cubic map goes straight through a straight grid, so that a pin of which the spot is off is predicted off by as much."""
    points_px, found = STRAIGHT.to_px(POINTS_MM), np.arange(63) != 5
    points_px[0] += [4.0, -6.0]
    errors_mm = PublishedPinMap(BOARD, POINTS_MM, points_px, found).leave_one_out_errors_mm
    np.testing.assert_allclose(errors_mm[0], [0.2, -0.3], atol=1e-9)
    assert errors_mm.shape == (62, 2) and 0 < np.abs(errors_mm[1:]).max() < 0.2


@pytest.mark.parametrize(
    ("rows", "cols", "has_middle"), [(9, 9, True), (7, 5, True), (7, 8, False), (8, 7, False), (4, 4, False)]
)
def test_the_papers_way_needs_a_pin_in_the_middle(rows: int, cols: int, has_middle: bool) -> None:
    board, nodes = PinBoard(rows, cols), np.array(list(product(range(cols), range(rows))))
    points_mm = lattice_to_skin_mm(nodes, board, 0)
    pin_map = PublishedPinMap(board, points_mm, STRAIGHT.to_px(points_mm), np.ones(rows * cols, bool))
    if has_middle:
        assert pin_map.mm_per_px == pytest.approx(0.05)
    else:
        with pytest.raises(InputError, match=f"got {cols} x {rows} pins"):
            _ = pin_map.mm_per_px


def made_up(**parts: object) -> BoardFit:
    """The fit of a whole board through a lens without distortion."""
    points_px, change = STRAIGHT.to_px(POINTS_MM), np.zeros((480, 640), np.float32)
    lens_fit, every = fit_lens_with_terms(POINTS_MM, points_px, (480, 640), 1), np.ones(63)
    return replace(BoardFit(BOARD, 0, lens_fit, NODES, POINTS_MM, points_px, every > 0, every, 0.6, change), **parts)


@pytest.mark.parametrize(("rows", "cols"), [(480, 640), (640, 480), (240, 320)])
def test_the_grid_has_the_scale_of_the_lens_at_the_size_of_the_design(rows: int, cols: int) -> None:
    design = SensorDesign(pin_board=PinBoard(7, 9, 3.0))
    rectify = build_rectification(made_up(change=np.zeros((rows, cols), np.float32)), design)
    assert rectify.mm_per_px == pytest.approx(0.05 * max(rows, cols) / 640) and rectify.raw_shape == (rows, cols)
    assert rectify.calibrated_area_mm == calibrated_area_mm(design) == (-15.0, 15.0, -12.0, 12.0)
    np.testing.assert_allclose(rectify.source_px[172, [229, 230]].mean(axis=0), [319.5, 239.5], atol=1e-3)

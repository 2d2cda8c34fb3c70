"""Laws of the parts that find the board and fit the lens: lattices, imprints, the lens and its errors."""

from dataclasses import replace

import numpy as np
import pytest
from known_sensor import LENS

from ninedtact.calibration.board.board_fit import BoardFit, build_rectification, calibrated_area_mm
from ninedtact.calibration.board.detection import (
    DarkSpots,
    find_pin_lattices,
    lattice_to_skin_mm,
)
from ninedtact.calibration.board.lens_fit import (
    LensFit,
    fit_lens_with_terms,
    fit_smooth_lens_residual,
    rms_vector_length,
)
from ninedtact.calibration.board.pin_imprint_centres import (
    find_stray_pins,
)
from ninedtact.design import PinBoard, SensorDesign
from ninedtact.shape.lens_and_rectification import LensModel

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

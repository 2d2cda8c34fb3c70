"""Closed forms of small parts: the motion of the skin and its error, and which pixels of a press are fitted."""

import numpy as np
import pytest

from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.board.detection import lattice_to_skin_mm
from ninedtact.calibration.board.lens_fit import fit_lens_with_terms
from ninedtact.calibration.twin.ball_press_fit import _autocorrelation_sums, effective_observation_count
from ninedtact.calibration.twin.observed_presses import REACH_MM, ObservedBallPress, ObservedBoardPress
from ninedtact.design import PinBoard
from ninedtact.quantities import Rectified, skin_grid_mm
from ninedtact.shape.lens import LensModel

RNG = np.random.default_rng(0)
STRAIGHT = LensModel((0.0625, 0.0, 0.0, 0.0, 0.0625, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0), (480, 640))
"""20 pixels per mm, without distortion."""


def test_autocorrelation_sums_are_those_of_the_definition() -> None:
    field = RNG.normal(size=(5, 7))
    sums = _autocorrelation_sums(field)
    assert sums.shape == (9, 13) and sums[4, 6] == pytest.approx((field**2).sum())
    assert sums[5, 8] == pytest.approx((field[1:, 2:] * field[:-1, :-2]).sum())
    np.testing.assert_allclose(sums, sums[::-1, ::-1], atol=1e-12)


def test_blocks_of_equal_pixels_count_as_one_observation_each() -> None:
    independent = effective_observation_count(RNG.normal(size=(60, 60)))
    assert independent == pytest.approx(3600, rel=0.15)
    blocks = np.kron(RNG.normal(size=(20, 20)), np.ones((3, 3)))
    assert effective_observation_count(blocks) == pytest.approx(400, rel=0.25)


def observed(shape: tuple[int, int], mm_per_px: float) -> Rectified:
    return Rectified(np.full(shape, 100, np.float32), mm_per_px)


def test_the_pixels_around_the_ball_are_fitted() -> None:
    middle = (-3.1, 1.9)
    press = ObservedBallPress(observed((345, 460), 0.05), observed((345, 460), 0.05), middle)
    x, y = skin_grid_mm((345, 460), 0.05)
    expected = np.zeros((345, 460), bool)
    expected[::2, ::2] = (np.hypot(x - middle[0], y - middle[1]) < REACH_MM)[::2, ::2]
    np.testing.assert_array_equal(press.fitted_pixels, expected)
    np.testing.assert_array_equal(press.points_mm[0][0], x[expected])
    np.testing.assert_allclose(press.relative_brightness, 1, rtol=1e-5)


def test_the_pixels_among_the_pins_are_fitted_but_for_those_near_a_missing_pin() -> None:
    board, nodes = PinBoard(), np.array([(column, row) for row in range(7) for column in range(9)])
    points_mm = lattice_to_skin_mm(nodes, board, 0)
    lens_fit = fit_lens_with_terms(points_mm, STRAIGHT.to_px(points_mm), (480, 640), 1)
    found = np.ones(63, bool)
    found[12] = False  # at (-2.5, -5) mm
    change, ones = np.zeros((480, 640), np.float32), np.ones(63)
    fit = BoardFit(board, 0, lens_fit, nodes, points_mm, STRAIGHT.to_px(points_mm), found, ones, 0.5, change)
    assert fit.missing_pins == ["column 4, row 2"]
    press = ObservedBoardPress(observed((345, 460), 0.055), observed((345, 460), 0.055), fit)
    x, y = skin_grid_mm((345, 460), 0.055)
    among = (np.abs(x) < 11.5) & (np.abs(y) < 9) & (np.hypot(x + 2.5, y + 5) > 1.5)
    expected = np.zeros_like(among)
    expected[::3, ::3] = among[::3, ::3]
    np.testing.assert_array_equal(press.fitted_pixels, expected)
    np.testing.assert_allclose(press.pixel_density(points_mm[:5]), 1, rtol=1e-4)

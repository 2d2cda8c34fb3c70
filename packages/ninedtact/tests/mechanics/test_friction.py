"""Drags and twists: what sticks, what slips, and what the skin remembers."""

import numpy as np
import pytest
from gels import BALL, DOUBLE, SMALL, model, pressed
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.design import Gel
from ninedtact.mechanics.closed_forms import SQUARE_LATTICE_SUM, hertz_contact, mindlin_shear_force_n
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.friction import FrictionLimit, ShearSolution, solve_shear
from ninedtact.mechanics.layer_compliance import half_space_compliance
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, Skin

DOWN = Pose(depth_mm=1.0)
FINE = SolverSettings(tolerance=1e-4)


def shear_n(contact: Contact) -> np.ndarray:
    return contact.wrench().force_n[:2]


@pytest.mark.parametrize("part", [0.2, 0.5, 0.8])
def test_a_ball_on_a_half_space_slips_from_its_rim_as_cattaneo_and_mindlin_say(part):
    """Pressure held; the drag allows for the images' share of the displacement."""
    gel, grid, friction, radius, depth = Gel(2.5, 0.1, 0.5), PeriodicGrid(128, 128, 0.1), 0.5, 4.0, 0.2
    operators, zero = Skin(grid, gel, DOUBLE, half_space_compliance).operators, np.zeros((1, 1))
    ball, tolerance = hertz_contact(gel, radius, depth), np.full((1, 1), 1e-6)
    x, y = grid.positions_mm
    pressure = ball.peak_mpa * np.sqrt(np.maximum(1 - (x**2 + y**2) / ball.radius_mm**2, 0))
    slips_at = 3 * friction * ball.load_n * 1.5 / (16 * 0.1 * ball.radius_mm)
    shear = mindlin_shear_force_n(gel, ball, friction, part * slips_at)
    images = SQUARE_LATTICE_SUM / grid.width_mm * shear * 1.5 / (4 * np.pi * 0.1)
    target = np.stack([np.full(grid.shape, part * slips_at - images), np.zeros(grid.shape)])
    start = ShearSolution(0 * target, 0 * target, zero, zero, zero, operators.first_step_lengths(zero)[1])
    found = solve_shear(operators, target, FrictionLimit(friction * pressure), start, tolerance, 500)
    assert found.residual_mm <= tolerance
    assert found.shear_mpa[0].sum() * grid.cell_area_mm2 == pytest.approx(shear, rel=0.03)
    stuck = np.hypot(*found.shear_mpa) < 0.999 * friction * pressure
    radius_stuck = np.sqrt(stuck.sum() * grid.cell_area_mm2 / np.pi)
    assert radius_stuck == pytest.approx(ball.radius_mm * (1 - shear / friction / ball.load_n) ** (1 / 3), rel=0.06)


@settings(max_examples=12, deadline=None)
@given(st.floats(0.1, 1.5), st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.floats(-0.5, 0.5))
def test_coulombs_law_holds_everywhere(friction, by_x, by_y, twist):
    before = pressed(model(friction=friction, settings=FINE), DOWN)
    after = model(friction=friction, settings=FINE).step(before, BALL, Pose(by_x, by_y, 1.0, twist))
    limit, shear = friction * after.pressure_mpa, np.hypot(*after.shear_mpa)
    assert np.all(shear <= limit * (1 + 1e-6))
    assert not shear[after.pressure_mpa == 0].any()
    assert after.residual_mm <= 1.1e-4


def test_what_sticks_has_moved_with_the_object_and_what_slips_has_slipped_against_its_shear():
    before, after = model(friction=0.4, settings=FINE).follow(BALL, [DOWN, Pose(x_mm=0.25, depth_mm=1.0)])
    slip = after.tangential_mm - before.tangential_mm - np.array([0.25, 0])[:, None, None]
    both = (before.pressure_mpa > 0) & (after.pressure_mpa > 0)
    sticks, slips = after.stick_mask & both, ~after.stick_mask & both
    assert sticks.sum() > 30
    assert slips.sum() > 30
    assert np.abs(slip[:, sticks]).max() < 2e-4
    along = (slip * after.shear_mpa).sum(axis=0)[slips]
    assert np.all(along <= 2e-4 * np.hypot(*after.shear_mpa)[slips])
    across = (slip[0] * after.shear_mpa[1] - slip[1] * after.shear_mpa[0])[slips]
    assert np.all(np.abs(across) <= 4e-4 * np.hypot(*after.shear_mpa)[slips])


def test_a_drag_there_and_back_is_remembered():
    there_and_back = pressed(model(friction=0.5), DOWN, Pose(x_mm=0.6, depth_mm=1.0), DOWN)
    assert shear_n(there_and_back)[0] < -0.03 * -there_and_back.wrench().force_n[2]
    assert np.abs(shear_n(pressed(model(friction=0.5), DOWN, DOWN))).max() < 1e-7


def test_without_friction_nothing_is_sheared_or_remembered():
    dragged = pressed(model(friction=0.0), DOWN, Pose(0.5, 0.2, 1.0, 0.3))
    assert not dragged.shear_mpa.any()
    np.testing.assert_allclose(dragged.height_mm, pressed(model(friction=0.0), DOWN).height_mm, atol=1e-6)


def test_a_long_drag_slips_all_over_and_its_shear_is_friction_times_load():
    contact = pressed(model(friction=0.3, settings=FINE), DOWN, *(Pose(x, 0.75 * x, 1.0) for x in (0.4, 0.8, 1.2, 1.6)))
    assert not contact.stick_mask.any()
    load = -contact.wrench().force_n[2]
    assert np.hypot(*shear_n(contact)) == pytest.approx(0.3 * load, rel=0.01)
    assert shear_n(contact)[1] == pytest.approx(0.75 * shear_n(contact)[0], rel=0.02)


def test_one_step_or_ten_make_the_same_shear_as_long_as_nothing_slips():
    one = shear_n(pressed(model(friction=50.0), DOWN, Pose(0.3, 0.1, 1.0)))
    ten = shear_n(pressed(model(friction=50.0), DOWN, *(Pose(0.03 * n, 0.01 * n, 1.0) for n in range(1, 11))))
    np.testing.assert_allclose(one, ten, rtol=0.03)


def test_the_skin_is_raised_before_a_dragged_ball_and_sunk_behind_it():
    contact = pressed(model(), DOWN, Pose(x_mm=0.5, depth_mm=1.0))
    middle, beside = SMALL.rows // 2, round(3.5 / SMALL.pitch_mm)
    front, back = (contact.height_mm[middle, SMALL.cols // 2 + side] for side in (beside, -beside))
    still = pressed(model(), DOWN).height_mm[middle, SMALL.cols // 2 + beside]
    assert front > still + 0.02
    assert back < still - 0.02


def test_a_mirrored_drag_mirrors_everything():
    right, left = (pressed(model(), DOWN, Pose(sign * 0.4, 0.1, 1.0, sign * 0.2)) for sign in (1, -1))
    np.testing.assert_allclose(left.height_mm, right.height_mm[:, ::-1], atol=1e-6)
    np.testing.assert_allclose(left.pressure_mpa, right.pressure_mpa[:, ::-1], atol=1e-6)
    np.testing.assert_allclose(left.shear_mpa[0], -right.shear_mpa[0][:, ::-1], atol=1e-6)
    np.testing.assert_allclose(left.shear_mpa[1], right.shear_mpa[1][:, ::-1], atol=1e-6)


def test_a_first_guess_saves_iterations_and_leads_to_the_same_contact() -> None:
    """Friction remembers the last contact; the guess gives only the tractions from which the search starts."""
    skin = model(settings=FINE)
    before, dragged = pressed(skin, DOWN), Pose(0.4, -0.2, 1.0)
    near = skin.step(before, BALL, Pose(0.42, -0.2, 1.01))
    alone, guided = skin.step(before, BALL, dragged), skin.step(before, BALL, dragged, near)
    assert guided.iterations < alone.iterations
    np.testing.assert_allclose(guided.height_mm, alone.height_mm, atol=5e-4)
    np.testing.assert_allclose(shear_n(guided), shear_n(alone), rtol=2e-3)
    assert np.abs(shear_n(near) - shear_n(alone)).max() > 0.02 * np.abs(shear_n(alone)).max()

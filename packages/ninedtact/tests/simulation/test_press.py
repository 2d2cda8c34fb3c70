"""A press from above the skin to its end, what is refused, and the gauges that calibrate a twin."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from small_press_simulation import TWIN

from ninedtact.design import PinBoard
from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.calibration_press_models import pin_board_indenter
from ninedtact.simulation.ground_truth import (
    true_height_map,
    true_height_map_like,
    true_pressure_map_mpa,
    true_shear_map_mpa,
)
from ninedtact.simulation.hand_moved_object import HandTarget, SimulatedHand
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import LOAD_TOLERANCE, ContactLeavesGel, PoseOutOfView


def test_it_ends_where_it_was_sent() -> None:
    contact = ScriptedPress(1.0, at_mm=(1.0, -2.0), drag_mm=(0.5, 0.5), twist_rad=radians(12)).simulate(TWIN, Ball(4.0))
    pose = contact.pose
    assert (pose.x_mm, pose.y_mm, pose.depth_mm, np.degrees(pose.twist_rad)) == pytest.approx((1.5, -1.5, 1.0, 12))
    force, torque = contact.wrench().force_n, contact.wrench(np.array([1.5, -1.5, 0.0])).torque_nm
    assert force[2] < -2 and force[0] == pytest.approx(force[1], rel=0.05) and force[0] > 0.2 and torque[2] > 0


@pytest.mark.parametrize("load_n", [0.3, 3.0, 12.0])
def test_a_load_is_that_of_the_gel_as_it_acts_at_finite_strain(load_n: float) -> None:
    twin, ball = TWIN, Ball(4.0)
    pressed = ScriptedPress(load_n=load_n, drag_mm=(0.3, 0.0)).simulate(twin, ball)
    assert -pressed.wrench().force_n[2] == pytest.approx(load_n, rel=LOAD_TOLERANCE)
    linear = ScriptedPress(load_n=load_n).simulate(replace(TWIN, gel=replace(TWIN.gel, finite_strain=0.0)), ball)
    assert pressed.pose.depth_mm < linear.pose.depth_mm or load_n < 1  # the gel stiffens
    hand = SimulatedHand()
    hand.aim(HandTarget(Pose(0.0, 0.0), load_n=load_n))
    press = twin.press(None, ball, Pose(depth_mm=0.05))
    for _ in range(60):
        press = hand.step(twin, press, ball)
    assert press.load_n == pytest.approx(load_n, rel=LOAD_TOLERANCE)


def test_a_load_is_held_all_the_way() -> None:
    contact = ScriptedPress(load_n=4.0, drag_mm=(0.6, 0.0)).simulate(TWIN, Ball(4.0))
    assert contact.wrench().force_n[2] == pytest.approx(-4.0, rel=LOAD_TOLERANCE) and 0.5 < contact.pose.depth_mm < 1.5


@pytest.mark.parametrize(
    ("press", "said"),
    [
        (lambda: ScriptedPress(), "expected a depth or a load, got neither"),
        (lambda: ScriptedPress(1.0, 2.0), "expected a depth or a load, got both"),
        (lambda: ScriptedPress(-1.0), "above zero, got -1 mm deep"),
        (lambda: ScriptedPress(load_n=-3.0), "above zero, got -3 N"),
        (lambda: ScriptedPress(float("nan")), "above zero, got nan"),
    ],
)
def test_a_press_that_is_none_is_refused(press: type[ScriptedPress], said: str) -> None:
    with pytest.raises(InputError, match=said):
        press()


def test_what_a_twin_cannot_answer_for_is_refused() -> None:
    for beside in ((15.0, 0.0), (0.0, -11.0)):
        with pytest.raises(PoseOutOfView, match=r"expected the object over the skin .*; press nearer to the centre"):
            ScriptedPress(1.0, at_mm=beside).simulate(TWIN, Ball(4.0))
    with pytest.raises(InputError, match=r"the gel allows, 3.125 mm, got 3.2 mm"):
        ScriptedPress(3.2).simulate(TWIN, Ball(4.0))
    with pytest.raises(InvalidPose, match=r"the gel allows, 3.125 mm, got 3.19"):
        TWIN.press(None, Ball(4.0), Pose(depth_mm=3.2))
    for large, at in ((FlatPunch(18.0), (0.0, 0.0)), (FlatPunch(13.0), (0.0, 0.0)), (Ball(4.0), (13.5, 0.0))):
        with pytest.raises(ContactLeavesGel, match=r"touch no more than the gel of 29.5 x 22.5 mm, .* smaller object"):
            ScriptedPress(1.0, at_mm=at).simulate(TWIN, large)


def test_the_truth_is_given_on_the_grids_on_which_a_sensor_answers() -> None:
    contact = ScriptedPress(1.0, at_mm=(2.0, 1.0), drag_mm=(0.5, 0.0)).simulate(TWIN, Ball(4.0))
    place = true_height_map(contact, (345, 460), 0.05)
    pressure, shear = true_pressure_map_mpa(contact, (345, 460), 0.05), true_shear_map_mpa(contact, (345, 460), 0.05)
    deepest = np.unravel_index(place.z_mm.argmin(), place.z_mm.shape)
    assert (place.axes_mm[0][deepest[1]], place.axes_mm[1][deepest[0]]) == pytest.approx((2.5, 1.0), abs=0.11)
    force = contact.wrench().force_n
    assert [shear[..., 0].sum(), -pressure.sum()] == pytest.approx([force[0] / 0.05**2, force[2] / 0.05**2], rel=0.01)
    stamped = replace(place, stamp_ns=7)
    assert true_height_map_like(contact, stamped, 0.0).stamp_ns == 7


def test_the_board_is_the_designed_one() -> None:
    board = pin_board_indenter(PinBoard())
    tips = np.array([[x * 2.5, y * 2.5] for x in range(-4, 5) for y in range(-3, 4)], float)
    assert board.underside_mm(*tips.T[:, None]) == pytest.approx(0, abs=1e-3)
    side = board.underside_mm(tips[:, :1].T + 0.5, tips[:, 1:].T)
    assert side == pytest.approx(0.6 - np.sqrt(0.6**2 - 0.5**2), abs=0.02)
    assert board.underside_mm(tips[:, :1].T + 1.2, tips[:, 1:].T) == pytest.approx(1.5)


def test_gauge_images_are_those_that_a_calibration_asks_for() -> None:
    images = simulate_calibration_images(TWIN)
    assert np.abs(images.board_reference.astype(int) - images.ball_reference).max() < 8
    assert not np.array_equal(images.board_reference, images.ball_reference)  # each with its own noise
    ball, board = (
        after.astype(int) - before
        for after, before in ((images.ball, images.ball_reference), (images.board, images.board_reference))
    )
    assert ball.min() < -35 < -4 > board.min() > -35

"""A press from above the skin to its end, what is refused, and the gauges that calibrate a twin."""

from dataclasses import replace

import numpy as np
import pytest
from small_press_simulation import TWIN

from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.hand_moved_object import HandTarget, SimulatedHand
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import LOAD_TOLERANCE, ContactLeavesGel, PoseOutOfView


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


@pytest.mark.parametrize(
    ("press", "said"),
    [
        (lambda: ScriptedPress(), "expected a depth or a load, got neither"),
        (lambda: ScriptedPress(1.0, 2.0), "expected a depth or a load, got both"),
        (lambda: ScriptedPress(-1.0), "depth_mm above 0, got -1"),
        (lambda: ScriptedPress(load_n=-3.0), "load_n above 0, got -3"),
        (lambda: ScriptedPress(float("nan")), "depth_mm above 0, got nan"),
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


def test_gauge_images_are_those_that_a_calibration_asks_for() -> None:
    images = simulate_calibration_images(TWIN)
    assert np.abs(images.board_reference.astype(int) - images.ball_reference).max() < 8
    assert not np.array_equal(images.board_reference, images.ball_reference)  # each with its own noise
    ball, board = (
        after.astype(int) - before
        for after, before in ((images.ball, images.ball_reference), (images.board, images.board_reference))
    )
    assert ball.min() < -35 < -4 > board.min() > -35

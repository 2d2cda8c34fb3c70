"""One motion for everybody who watches: solved once, in order, the same every time, and never late."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from small_press_simulation import PRESSED, small_press_simulation

from ninedtact.errors import SimulationError
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.press_sequence import KEPT_PRESSES
from ninedtact.simulation.trajectory import Trajectory


def test_every_step_is_solved_once_and_the_same_every_time() -> None:
    one, other = small_press_simulation(), small_press_simulation()
    first = [one.contact(number) for number in range(12)]
    assert all(one.contact(number) is contact for number, contact in enumerate(first))
    assert np.array_equal(other.contact(11).shear_mpa, first[11].shear_mpa)  # asked for at once, the way is the same


def test_many_threads_see_the_same() -> None:
    stage = small_press_simulation()
    with ThreadPoolExecutor(4) as pool:
        contacts = list(pool.map(lambda _: stage.contact(9), range(8)))
    assert all(contact is contacts[0] for contact in contacts) and list(stage.presses) == list(range(10))


def test_what_is_long_ago_is_refused_and_not_made_up() -> None:
    stage = small_press_simulation(hz=30.0)
    stage.contact(KEPT_PRESSES + 3)
    with pytest.raises(SimulationError, match=r"from 4 on, got 3, .* open all sources together"):
        stage.contact(3)
    assert np.isfinite(stage.wrench_six_at(0.0)).all()  # wrenches are small and are kept for longer


def test_in_real_time_steps_are_skipped_and_not_made_up_for() -> None:
    stage = small_press_simulation(real_time=True)
    stage.contact(0)
    late = stage.contact(12)
    assert list(stage.presses) == [0, 12] and late.touches
    assert stage.contact(11) is late and stage.contact(2) is stage.contact(0)  # the nearest that there is
    between = stage.wrench_six_at(0.6)
    assert between == pytest.approx((stage.wrenches[0] + stage.wrenches[12]) / 2)


def test_while_a_hand_holds_an_object_in_real_time_no_step_is_solved_ahead() -> None:
    stage = small_press_simulation(real_time=True)
    stage.contact(0)
    stage.hand.take(Ball(4.0))
    assert stage.wrench_six_at(0.05) == pytest.approx(stage.wrenches[0])
    assert list(stage.presses) == [0]
    stage.hand.release()
    stage.wrench_six_at(0.05)
    assert list(stage.presses) == [0, 1]


def test_acts_follow_each_other_on_untouched_skin_round_after_round() -> None:
    stage = small_press_simulation(acts=2)
    length = PRESSED.trajectory.duration_s
    assert stage.round_s == pytest.approx(2 * length)
    assert [stage.trajectory_at(at)[0] for at in (0, 0.9 * length, 1.1 * length, 2.1 * length)] == [0, 0, 1, 2]
    one, again = (stage.contact(round(start * 10) + 9) for start in (0, 2 * stage.round_s))
    assert np.allclose(one.wrench().six, again.wrench().six, atol=0.05)


def test_a_touch_comes_down_drags_twists_and_lifts() -> None:
    motion = PRESSED.trajectory
    ends_in_skin = [end for end, one in zip(motion.ends_s, motion.segments, strict=True) if one.to.depth_mm > 0]
    pressed = motion.pose_at(ends_in_skin[-1])
    assert (pressed.x_mm, pressed.depth_mm) == pytest.approx((1.5, 1.0))
    assert np.degrees(pressed.twist_rad) == pytest.approx(10)
    assert motion.pose_at(0).depth_mm < 0 and motion.pose_at(motion.duration_s + 1).depth_mm < 0
    depths = np.array([motion.pose_at(number / 100).depth_mm for number in range(int(100 * motion.duration_s) + 1)])
    assert np.abs(np.diff(depths)).max() < 0.06  # nothing jumps
    assert Trajectory(Pose(), ()).pose_at(1) == Pose()

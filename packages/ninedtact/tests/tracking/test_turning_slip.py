"""Slip of what turns about the normal: from the rim inwards, later under more load or friction, and undone by turning back."""

import numpy as np
import pytest

from ninedtact.tracking.turning_slip import TurningSlip, probability_below

AREA_MM2, LOAD_N, SEEN_RAD = 40.0, 5.0, 0.01
NONE = float("nan")


def shares(turn_rad: np.ndarray, load_n: float = LOAD_N, friction: float = NONE) -> list[float]:
    turning = TurningSlip()
    return [turning.update(float(yaw), SEEN_RAD, AREA_MM2, load_n, friction) for yaw in turn_rad]


def test_less_sticks_the_farther_it_turns_and_more_under_more_load_or_friction() -> None:
    turn_rad = np.linspace(0, 1, 60)
    found = shares(turn_rad)
    assert found[0] == 1 and np.diff(found).max() < 0 and 0 < found[-1] < 0.2
    assert shares(turn_rad, 2 * LOAD_N) == pytest.approx(shares(turn_rad, LOAD_N, friction=1.0))
    assert shares(turn_rad, 2 * LOAD_N)[-1] > found[-1]
    assert shares(-turn_rad) == pytest.approx(found)
    there_and_back = shares(np.concatenate([turn_rad[:20], turn_rad[:19][::-1]]))
    assert there_and_back[-1] == pytest.approx(1, abs=0.02)


def test_a_turn_that_is_not_seen_says_nothing_and_unknown_friction_makes_it_less_sure() -> None:
    turning = TurningSlip()
    assert np.isnan(turning.update(0.5, 2.0, AREA_MM2, LOAD_N, NONE))
    assert turning.update(0.7, SEEN_RAD, AREA_MM2, LOAD_N, NONE) == 1, "it is counted from when it is seen"
    assert turning.update(0.9, SEEN_RAD, AREA_MM2, LOAD_N, NONE) < 0.6
    turning.release()
    assert turning.update(0.9, SEEN_RAD, AREA_MM2, LOAD_N, NONE) == 1
    assert probability_below(0.7, 0.7, is_friction_known=False) == pytest.approx(0.5)
    assert 0.5 < probability_below(0.5, 0.7, False) < probability_below(0.5, 0.7, True) < 1

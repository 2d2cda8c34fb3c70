"""Motions over a twin and their true slip: who sticks moves the skin, who slides moves over it, and a turn slides at the rim."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.object_motions import HZ, MOTION_KINDS, MotionSettings, MotionStep, play_motion
from ninedtact.simulation.twin import Twin, default_twin

FRICTION, SPEED_MM_S = 0.6, 6.0
SETTINGS = MotionSettings(Pose(-1.5, -0.4, 0.6), SPEED_MM_S, FRICTION)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return replace(default_twin(), pitch_mm=0.5, friction=FRICTION)


def play(twin: Twin, kind: str, settings: MotionSettings = SETTINGS) -> list[MotionStep]:
    return list(play_motion(twin, Ball(5.0), settings.motion(kind)))


def states(steps: Sequence[MotionStep]) -> str:
    """The first letters of all states, repeated ones once."""
    letters = [step.slip.state[0] for step in steps]
    return "".join(one for one, before in zip(letters, ["", *letters], strict=False) if one != before)


@pytest.mark.parametrize("direction_rad", [0.0, 2.0])
def test_a_dragged_ball_sticks_slips_slides_and_rests_at_the_limit_of_friction(
    twin: Twin, direction_rad: float
) -> None:
    steps = play(twin, "slide", replace(SETTINGS, direction_rad=direction_rad))
    assert states(steps) == "sigi"
    sliding = [step for step in steps if step.slip.state == "gross"]
    assert sliding[-1].slip.speed_mm_s == pytest.approx(np.hypot(1, 0.3) * SPEED_MM_S, rel=0.05)
    for step in (sliding[-1], steps[-1]):
        force_n = step.press.wrench.force_n
        assert np.hypot(*force_n[:2]) == pytest.approx(-FRICTION * force_n[2], rel=0.01)
    along = sliding[-1].press.wrench.force_n[:2]
    assert np.arctan2(along[1], along[0]) == pytest.approx(np.arctan2(0.3, 1) + direction_rad, abs=0.05)


def test_every_motion_has_the_states_of_its_name(twin: Twin) -> None:
    found = {kind: play(twin, kind) for kind in MOTION_KINDS[1:] if kind != "tighten"}
    assert states(found["roll"]) == "s" and states(found["twist"]) == "si"
    assert states(found["regrasp"]).count("u") == 1 and states(found["hang"])[-1] == "g"
    assert states(found["stick_slip"]).count("g") >= 2 and states(found["reverse"]).count("g") == 2
    weights_n = [step.press.wrench.force_n[0] for step in found["hang"] if step.slip.state != "gross"][40:]
    assert np.ptp(weights_n) < 0.1 * max(weights_n), "the skin bears its weight until it slides"
    twisted = found["twist"][-1]
    assert 0 < twisted.slip.sticking_share < 0.1 and twisted.slip.speed_mm_s == 0
    assert sum(step.press.memory is not None for step in found["roll"]) == len(found["roll"]) - 1, 1 / HZ

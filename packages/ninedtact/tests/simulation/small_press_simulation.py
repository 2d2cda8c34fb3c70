"""A twin and a short motion for tests: a ball pressed, dragged along +x and twisted."""

from math import radians

from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.press_sequence import ObjectTrajectory, PressSequence
from ninedtact.simulation.trajectory import press_trajectory
from ninedtact.simulation.twin import default_twin

TWIN = default_twin()
PRESSED = ObjectTrajectory(
    Ball(4.0), press_trajectory(Pose(0.5, -0.5, 1.0), (1.0, 0.0), radians(10), pause_s=0.2, speed=2.0)
)


def small_press_simulation(
    *, hz: float = 10.0, real_time: bool = False, rounds: int | None = None, acts: int = 1
) -> PressSequence:
    """Two and a half seconds for each act."""
    return PressSequence(TWIN, [PRESSED] * acts, hz, real_time, rounds)

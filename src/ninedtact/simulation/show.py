"""What a twin is shown with: a few objects in turn, each pressed, dragged, twisted, tilted and lifted."""

from math import radians

from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.motion import touch
from ninedtact.simulation.objects.named import object_for
from ninedtact.simulation.stage import Act


def show() -> list[Act]:
    """About half a minute."""
    return [
        Act(object_for("ball:4"), touch(Pose(0.0, 0.0, 1.4), (1.5, 0.8))),
        Act(object_for("gear_07"), touch(Pose(-1.0, 0.5, 0.4), (0.3, 0.0), radians(15))),
        Act(object_for("cylinder:3,11"), touch(Pose(2.0, -1.0, 1.0, radians(30)), (-0.5, 1.2), 0.0, (0.0, radians(5)))),
        Act(object_for("letter_03"), touch(Pose(0.0, 0.0, 0.7), (0.8, -0.6), radians(-12))),
        Act(object_for("ring_02"), touch(Pose(-2.0, 1.0, 0.6), (0.0, -0.6), radians(15))),
        Act(object_for("key_01"), touch(Pose(1.0, 0.0, 0.8), (-0.6, 0.4), radians(10))),
    ]

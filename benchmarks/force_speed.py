"""Reading → wrench by physics, and raw image → shape and wrench, on one thread.

A ball is held, as in a stream: physics starts from the last image. What must be reached is held against the thread's own times
(median), which other programs on the machine do not change; the least wall times stand beside them.
"""

import tyro
from figures import Figure, answer, at_most
from real_images import real_sensor
from turns import Tasks, Times, in_turns

from ninedtact import Frame
from ninedtact.design import Gel
from ninedtact.force.estimator_loading import build_estimator
from ninedtact.reading import Reading

PHYSICS, ALL = "reading → wrench by physics", "frame → shape and wrench by physics"
REQUIRED_MS = {PHYSICS: 4.0, ALL: 8.0}


def force_speed(rounds: int = 60, quick: bool = False, json: bool = False) -> None:
    """Measure, and print what it must reach."""
    times = in_turns({"held ball": tasks}, rounds, quick)
    answer("Speed of the force estimate, one thread", [figure(*name, found) for name, found in times.items()], json)


def figure(reading: str, task: str, found: Times) -> Figure:
    what = f"{reading}: {task}, ms"
    if task in REQUIRED_MS:
        return at_most(what, found.median_cpu_ms, REQUIRED_MS[task], "ms", f"least wall {found.least_ms:.2f}")
    return Figure(what, found.median_cpu_ms, peer=f"least wall {found.least_ms:.2f}")


def tasks() -> Tasks:
    """Return what is timed, on the real sensor A."""
    images, shape = real_sensor("sensor_a")
    depth, frame = shape.depth_reader(Frame(images["ball_reference"])), Frame(images["ball"])
    physics = build_estimator("physics", shape, Gel())

    def read() -> Reading:
        rectified = shape.rectify(frame)
        return Reading(frame, rectified, depth(rectified), reference=depth.reference)

    held = read()
    return {
        PHYSICS: lambda _: physics.estimate(held),
        "frame → shape": lambda _: read(),
        ALL: lambda _: physics.estimate(read()),
    }


if __name__ == "__main__":
    tyro.cli(force_speed)

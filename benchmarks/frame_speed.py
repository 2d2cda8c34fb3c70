"""Raw 640x480 image → height, and → points with normals, on one thread, beside the original's way (`original.py`); and → wrench.

All read the same real images in turns. The ratio is of the thread's own times (median), which other programs on the
machine do not change; the least wall times stand beside them. Forces are those of a ball that is held: physics starts from the last
image, as in a stream, or from none.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import tyro
from figures import Figure, answer, at_least, at_most
from original import Original
from real_images import calibrated, real_sensor, sensor_folder
from turns import Tasks, Times, in_turns

from ninedtact import Frame, SensorFolder, point_cloud, read_image
from ninedtact.design import Gel
from ninedtact.force.estimator_loading import build_estimator
from ninedtact.reading import read_frame

Taken = dict[tuple[str, str], Times]
"""By whom and task."""
TO_HEIGHT, TO_POINTS = "frame → height", "frame → points"
REQUIRED = {TO_HEIGHT: 15, TO_POINTS: 10}
PRESSED = ("ball", "board", "ball_reference")
RATIO = "ratio"
READINGS = "physics", RATIO
"""Ours: the default, and the older method."""
FORCE = "held ball"
REQUIRED_MS = {
    "reading → wrench by physics": 4.0,
    "frame → shape and wrench by physics": 8.0,
    "reading alone → wrench by physics": 25.0,
    "reading alone of I → wrench by physics": 25.0,
}


def frame_speed(rounds: int = 100, quick: bool = False, json: bool = False) -> None:
    """Measure, and print what it must reach."""
    ours = {reading: partial(our_tasks, reading) for reading in READINGS}
    times = in_turns({"original": original_tasks, **ours, FORCE: force_tasks}, rounds, quick)
    figures = [ratio(reading, task, times) for reading in READINGS for task in REQUIRED]
    figures += [cost(who, task, times) for who, task in times if who in READINGS]
    figures += [cost(who, task, times) for who, task in times if who == "original" and task not in REQUIRED]
    figures += [force_cost(task, limit_ms, times[FORCE, task]) for task, limit_ms in REQUIRED_MS.items()]
    answer("Speed of one frame, one thread", figures, json)


def original_tasks() -> Tasks:
    folder = sensor_folder("sensor_a")
    original = Original(folder / "upstream_layout" / "sensor_1", read_image(folder / "ball_reference.png"))
    raw = [read_image(folder / f"{name}.png") for name in PRESSED]
    return {
        TO_HEIGHT: lambda call: original.height(raw[call % 3]),
        TO_POINTS: lambda call: original.points(raw[call % 3]),
        "of it: index gather": lambda call: original.rectified(raw[call % 3]),
    }


def our_tasks(reading: str) -> Tasks:
    images, shape = real_sensor("sensor_a", "ratio" if reading == RATIO else "physics")
    rectify, reader = shape.rectify, shape.depth_reader(Frame(images["ball_reference"]))
    frames = [Frame(images[name]) for name in PRESSED]
    rectified = [rectify(frame) for frame in frames]
    heights = [reader(image) for image in rectified]
    return {
        TO_HEIGHT: lambda call: reader(rectify(frames[call % 3])),
        TO_POINTS: lambda call: point_cloud(reader(rectify(frames[call % 3]))),
        "of it: rectify": lambda call: rectify(frames[call % 3]),
        "of it: depth": lambda call: reader(rectified[call % 3]),
        "of it: point cloud": lambda call: point_cloud(heights[call % 3]),
    }


def force_tasks() -> Tasks:
    images, shape = real_sensor("sensor_a")
    depth, frame = shape.depth_reader(Frame(images["ball_reference"])), Frame(images["ball"])
    physics = build_estimator("physics", shape, Gel())
    held = read_frame(frame, shape, depth)
    of_a, of_i = (estimate_of_ball_alone(name) for name in ("sensor_a", "sensor_i"))
    calls = (lambda _: physics.estimate(held), lambda _: physics.estimate(read_frame(frame, shape, depth)), of_a, of_i)
    return dict(zip(REQUIRED_MS, calls, strict=True))


def estimate_of_ball_alone(sensor: str) -> Callable[[int], object]:
    """Return the estimate of a real sensor's ball image with its own gel, from that image alone."""
    images, shape = real_sensor(sensor)
    reading = read_frame(Frame(images["ball"]), shape, shape.depth_reader(Frame(images["ball_reference"])))
    physics = SensorFolder(Path(), calibrated(sensor, "physics").record).estimator("physics")

    def estimate(_: int) -> object:
        physics.forget()
        return physics.estimate(reading)

    return estimate


def force_cost(task: str, limit_ms: float, found: Times) -> Figure:
    return at_most(f"{FORCE}: {task}, ms", found.median_cpu_ms, limit_ms, "ms", f"least wall {found.least_ms:.2f}")


def ratio(reading: str, task: str, times: Taken) -> Figure:
    faster = times["original", task].median_cpu_ms / times[reading, task].median_cpu_ms
    return at_least(f"{reading}: {task}, times faster", faster, REQUIRED[task])


def cost(who: str, task: str, times: Taken) -> Figure:
    figure, measured, peer = f"{who}: {task}, ms", in_words(times[who, task]), times.get(("original", task))
    if who == "original":
        return Figure(figure, "", peer=measured)
    return Figure(figure, measured, peer=in_words(peer) if peer else "")


def in_words(times: Times) -> str:
    return f"{times.median_cpu_ms:.2f} (least {times.least_ms:.2f})"


if __name__ == "__main__":
    tyro.cli(frame_speed)

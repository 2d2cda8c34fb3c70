"""Raw 640x480 picture → height, and → points with normals, on one thread, beside the original's way (`original.py`).

Both read the same real pictures in turns. The ratio is of the thread's own times (median), which other programs on the
machine do not change; the least wall times stand beside them.
"""

import tyro
from figures import Figure, answer, at_least
from original import Original
from real_pictures import sensor_folder
from real_sensor import real_sensor
from turns import Tasks, Times, in_turns

from ninedtact import Frame, point_cloud, read_picture

TO_HEIGHT, TO_POINTS = "frame → height", "frame → points"
REQUIRED = {TO_HEIGHT: 15, TO_POINTS: 10}
PRESSED = ("ball", "board", "ball_reference")


def frame_speed(rounds: int = 100, json: bool = False) -> None:
    """Measure, and print what it must reach."""
    times = in_turns({"original": original_tasks, "ours": our_tasks}, rounds)
    figures = [ratio(task, times["ours", task], times["original", task]) for task in REQUIRED]
    figures += [cost(task, times, "ours") for who, task in times if who == "ours"]
    figures += [cost(task, times, "original") for who, task in times if who == "original" and task not in REQUIRED]
    answer("Speed of one frame, one thread", figures, json)


def original_tasks() -> Tasks:
    folder = sensor_folder("sensor_a")
    original = Original(folder / "upstream_layout" / "sensor_1", read_picture(folder / "ball_reference.png"))
    raw = [read_picture(folder / f"{name}.png") for name in PRESSED]
    return {
        TO_HEIGHT: lambda call: original.height(raw[call % 3]),
        TO_POINTS: lambda call: original.points(raw[call % 3]),
        "of it: index gather": lambda call: original.rectified(raw[call % 3]),
    }


def our_tasks() -> Tasks:
    pictures, shape = real_sensor("sensor_a")
    rectify, reader = shape.rectify, shape.depth_reader(Frame(pictures["ball_reference"]))
    frames = [Frame(pictures[name]) for name in PRESSED]
    rectified = [rectify(frame) for frame in frames]
    heights = [reader(picture) for picture in rectified]
    return {
        TO_HEIGHT: lambda call: reader(rectify(frames[call % 3])),
        TO_POINTS: lambda call: point_cloud(reader(rectify(frames[call % 3]))),
        "of it: rectify": lambda call: rectify(frames[call % 3]),
        "of it: depth": lambda call: reader(rectified[call % 3]),
        "of it: point cloud": lambda call: point_cloud(heights[call % 3]),
    }


def ratio(task: str, ours: Times, original: Times) -> Figure:
    return at_least(f"{task}, times faster", original.median_cpu_ms / ours.median_cpu_ms, REQUIRED[task])


def cost(task: str, times: dict[tuple[str, str], Times], who: str) -> Figure:
    peer = times.get(("original", task))
    measured = in_words(times[who, task])
    if who == "original":
        return Figure(f"{task}, ms", "", peer=measured)
    return Figure(f"{task}, ms", measured, peer=in_words(peer) if peer else "")


def in_words(times: Times) -> str:
    return f"{times.median_cpu_ms:.2f} (least {times.least_ms:.2f})"


if __name__ == "__main__":
    tyro.cli(frame_speed)

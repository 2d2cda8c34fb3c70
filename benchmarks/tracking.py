"""Objects that are pressed on a real sensor's own twin, dragged and turned, and followed: motion against the key frame, its error,
and whether what cannot be seen is claimed.

Each object is pressed 0.5 mm deep and moved in steps of (0.1, 0.05) mm, turned by 2° and tilted by 0.1° a step. Errors are those of
the point in the middle of the first contact. The turn of balls and flat round faces cannot be seen. Heads of screws are also turned
once around in steps of 10°. The sensors are twins of six real fits: A and I as calibrated from their real images, the others
calibrated from images of their own twins.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
import tyro
from figures import Figure, answer, at_least, at_most, holds
from force_on_real_fits import calibrated_sensor

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import read_frame
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.tracking import ContactTracker, ObjectTracker, RigidMotion

SENSORS = "sensor_a", "sensor_i", "L", "P", "Q", "R"
TEXTURED = "key_05", "key_11", "letter_03", "letter_17", "gear_07", "spanner_02", "cross_03", "text_02"
FEATURELESS = "ball:4", "ball:8", "punch"
TURNED, TURN_DEPTH_MM, TURN_STEP_DEG = ("cross_02", "cross_03", "cross_05", "spline_01", "letter_03"), 0.35, 10
DEPTH_MM, STEPS = 0.5, 14
WITHIN_ONE, WITHIN_TWO = (0.60, 0.78), (0.90, 0.98)
CLAIMED_DEG, CLAIMED_MM = 45.0, 1.0
"""Standard deviations of a turn and of a displacement below which it counts as claimed."""


@dataclass(frozen=True)
class Followed:
    """One object on one sensor: errors and standard deviations of every step, mm and rad."""

    errors: np.ndarray
    std: np.ndarray
    ms: float
    turned_deg: np.ndarray
    """Turn about z since the image before, and the true one."""


def tracking(out: Path = Path("out/own_twin_presses"), quick: bool = False, json: bool = False) -> None:
    """Follow every object on every sensor."""
    figures: list[Figure] = []
    for name in SENSORS[: 1 if quick else None]:
        figures += measure(name, calibrated_sensor(name, out), quick)
    answer("Objects followed on a sensor's own twin", [*figures, *summary_figures(figures)], json)


def measure(name: str, sensor: SensorFolder, quick: bool) -> list[Figure]:
    """Return the figures of one sensor."""
    steps, around = 2 if quick else STEPS, range(0, 21 if quick else 361, TURN_STEP_DEG)
    textured = [follow(sensor, item, drag_and_turn(steps)) for item in TEXTURED[: 1 if quick else None]]
    plain = [follow(sensor, item, drag_and_turn(steps)) for item in FEATURELESS[: 1 if quick else None]]
    turned = [follow(sensor, item, turn_around(around)) for item in TURNED[: 1 if quick else None]]
    return [
        *figures_of(name, textured, plain),
        *figures_of_turns(name, textured, turned),
        at_least(f"{name}: images per second with force, contacts and slip", rate_with_force(sensor, steps), 60),
    ]


def summary_figures(figures: list[Figure]) -> Iterator[Figure]:
    """Yield mean, least and largest over the sensors of what was measured on each; names of figures begin with the sensor's."""
    of_all: dict[str, list[float]] = {}
    for figure in figures:
        if isinstance(figure.measured, int | float):
            of_all.setdefault(figure.figure.partition(": ")[2], []).append(figure.measured)
    for what, values in of_all.items():
        numbers = f"{np.mean(values):.3g}; {min(values):.3g} to {max(values):.3g}"
        yield Figure(f"mean; least to largest of {len(values)} sensors: {what}", numbers)


def rate_with_force(sensor: SensorFolder, steps: int) -> float:
    """Return the images per second of processor time with heights, force, contacts, motion and slip."""
    twin, shape, tracker, estimator = sensor.twin(), sensor.shape, ContactTracker(), sensor.estimator("physics")
    reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(8)))
    indenter, last, spent = indenter_from_name(TEXTURED[0]), None, 0.0
    for step, pose in enumerate(drag_and_turn(steps)):
        last = twin.press(last, indenter, pose)
        frame = Frame(twin.renderer(last.corrected, step), (step + 1) * 16_666_667, step)
        began = process_time()
        tracker.update(estimator.add_force(read_frame(frame, shape, reader)))
        spent += process_time() - began
    return (steps + 1) / spent


def drag_and_turn(steps: int) -> list[Pose]:
    """Return the poses of an object that is dragged, turned and tilted."""
    return [
        Pose(-0.4 + 0.1 * step, -0.3 + 0.05 * step, DEPTH_MM, np.radians(2.0 * step), np.radians(0.1 * step))
        for step in range(steps + 1)
    ]


def turn_around(angles_deg: Iterable[int]) -> list[Pose]:
    """Return the poses of an object that is turned in place."""
    return [Pose(0.1, -0.1, TURN_DEPTH_MM, np.radians(angle_deg)) for angle_deg in angles_deg]


def follow(sensor: SensorFolder, item: str, poses: list[Pose]) -> Followed:
    """Return how an object was followed."""
    twin, shape, tracker = sensor.twin(), sensor.shape, ObjectTracker()
    reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(8)))
    indenter, last, first, spent = indenter_from_name(item), None, None, 0.0
    errors, std, turned_deg, before = [], [], [], None
    for step, pose in enumerate(poses):
        last = twin.press(last, indenter, pose)
        frame = Frame(twin.renderer(last.corrected, step))
        began = process_time()
        found = tracker.update(read_frame(frame, shape, reader))
        spent += process_time() - began
        at = RigidMotion(np.asarray(pose.rotation), np.asarray(pose.origin_mm))
        if first is None:
            first, point_mm = at, found.position_mm
        elif found.is_known:
            if before is not None and np.degrees([before[0].std[5], found.std[5]]).max() < CLAIMED_DEG:
                steps_rad = (found.motion.after(before[0].motion.inverse).yaw_rad, at.after(before[1].inverse).yaw_rad)
                turned_deg.append(np.degrees(steps_rad))
            errors.append(found.motion.difference(at.after(first.inverse), point_mm))
            std.append(found.std)
        else:
            print(f"{item}: {found.state} ({found.reason}) at step {step}")
        before = (found, at) if found.is_known else None
    numbers = (np.array(part).reshape(-1, width) for part, width in ((errors, 6), (std, 6), (turned_deg, 2)))
    errors_of_all, std_of_all, turned = numbers
    return Followed(errors_of_all, std_of_all, 1e3 * spent / len(poses), turned)


def figures_of(name: str, textured: list[Followed], plain: list[Followed]) -> list[Figure]:
    """The median and largest errors, how often the truth is within the stated ones, and claims of what cannot be seen."""
    errors, std = (np.concatenate([getattr(one, part) for one in textured]) for part in ("errors", "std"))
    shift_mm, turn_deg = np.linalg.norm(errors[:, :3], axis=1), np.degrees(np.linalg.norm(errors[:, 3:], axis=1))
    is_seen = np.degrees(std[:, 5]) < CLAIMED_DEG
    yaw_deg = np.degrees(np.abs(errors[is_seen, 5]))
    deviation = np.abs(errors / std)
    claims = sum(int((np.degrees(one.std[:, 5]) < CLAIMED_DEG).sum()) for one in plain)
    off_mm = np.concatenate([np.linalg.norm(one.errors[:, :2], axis=1) for one in plain])
    off_std_mm = np.concatenate([one.std[:, :2].max(axis=1) for one in plain])
    false_mm = int(((off_std_mm < CLAIMED_MM) & (off_mm > np.maximum(3 * off_std_mm, 0.1))).sum())
    return [
        at_most(f"{name}: translation, median, mm", float(np.median(shift_mm)), 0.05, "mm"),
        Figure(f"{name}: translation, largest, mm", float(shift_mm.max())),
        at_most(f"{name}: rotation where the turn is seen, median, °", float(np.median(turn_deg[is_seen])), 0.5, "°"),
        Figure(
            f"{name}: turn about z where it is seen, median and largest, °",
            f"{np.median(yaw_deg):.2f}, {yaw_deg.max():.2f}",
        ),
        Figure(f"{name}: images of textured objects whose turn is seen", f"{is_seen.sum()} of {len(is_seen)}"),
        *(
            holds(f"{name}: truth within {times} σ", share, f"{low:g} to {high:g}", low <= share <= high)
            for times, (low, high) in ((1, WITHIN_ONE), (2, WITHIN_TWO))
            for share in [float((deviation < times).mean())]
        ),
        at_most(f"{name}: images of balls and round punches on which a turn is claimed", claims, 0),
        at_most(f"{name}: images of these on which a displacement is claimed that is wrong by 3 σ", false_mm, 0),
        at_least(
            f"{name}: images per second of processor time, heights included",
            1e3 / float(np.mean([one.ms for one in textured])),
            100,
        ),
    ]


def figures_of_turns(name: str, textured: list[Followed], turned: list[Followed]) -> list[Figure]:
    """The error after one turn about z, and how often the sense of a step of rotation is right."""
    ends_deg = [
        float(np.degrees(one.errors[-1, 5])) if np.degrees(one.std[-1, 5]) < CLAIMED_DEG else None for one in turned
    ]
    seen_deg = [abs(end) for end in ends_deg if end is not None]
    of_each = ", ".join(
        f"{item} {'not seen' if end is None else f'{end:+.1f}'}" for item, end in zip(TURNED, ends_deg, strict=False)
    )
    steps = np.concatenate([one.turned_deg for one in (*textured, *turned)])
    right = float((np.sign(steps[:, 0]) == np.sign(steps[:, 1])).mean())
    return [
        at_most(
            f"{name}: drift after one turn in steps of {TURN_STEP_DEG}°, median where it is seen, °",
            float(np.median(seen_deg)) if seen_deg else float("nan"),
            1.0,
            "°",
        ),
        Figure(f"{name}: drift of each, °", of_each),
        at_least(f"{name}: sense of rotation right", right, 0.99),
        Figure(f"{name}: steps of rotation", len(steps)),
    ]


if __name__ == "__main__":
    tyro.cli(tracking)

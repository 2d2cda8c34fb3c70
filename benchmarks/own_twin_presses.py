"""Presses on a real sensor's own twin, read with its own calibration: how much of each load physics finds, by object and depth.

Nothing is wrong with the calibration here: what is seen is the error of the inversion and of the light alone. Balls must be read to
5 % from 0.3 N up to the largest load that is in range (`force.traction.estimator`).
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro
from figures import Figure, answer, at_most
from real_images import calibrated

from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import EstimateWarning, Frame
from ninedtact.reading import read_frame
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.twin import ContactLeavesGel

SENSORS = "sensor_a", "sensor_i"
BALLS = "ball:2", "ball:4", "ball:8"
OTHERS = "punch", "letter_03", "key_05", "gear_07", "ridges_03"
DEPTHS_MM = 0.3, 0.6, 0.9, 1.2, 1.5, 1.8
LEAST_N = 0.3
"""Load from which relative errors count."""
PLACE_MM = 0.7, -0.4
STREAMS = "key_05", "ball:4", "letter_03"
MOTION = (
    *(Pose(*PLACE_MM, depth_mm) for depth_mm in np.arange(0.2, 0.85, 0.1)),
    *(Pose(PLACE_MM[0] + drag_mm, PLACE_MM[1], 0.8) for drag_mm in np.arange(0.1, 0.55, 0.1)),
    *(Pose(PLACE_MM[0] + 0.5, PLACE_MM[1], 0.8, np.radians(twist_deg)) for twist_deg in (3, 6, 9, 12)),
)
"""A stream of presses: deeper, then dragged, then twisted."""
REFERENCES = 8


def own_twin_presses(out: Path = Path("out/own_twin_presses"), quick: bool = False, json: bool = False) -> None:
    """Print the estimated over the true load of every press, and the worst of the balls in range."""
    figures: list[Figure] = []
    for name in SENSORS[: 1 if quick else None]:
        if not (out / name).is_dir():
            save_sensor(out / name, calibrated(name, "physics"))
        figures += figures_of(load_sensor(out / name), name, quick)
    answer("Loads of presses on a sensor's own twin", figures, json)


def figures_of(sensor: SensorFolder, name: str, quick: bool) -> Iterator[Figure]:
    """Yield the loads of every object, and the worst ball."""
    worst = 0.0
    for item in (BALLS if not quick else BALLS[1:2]) + (() if quick else OTHERS):
        found = list(presses_of(sensor, item, DEPTHS_MM[: 2 if quick else None]))
        text = ", ".join(f"{load_n:.1f}: {ratio:.2f}{'' if in_range else '*'}" for load_n, ratio, in_range in found)
        yield Figure(f"{name}, {item}: load over true load, by true load in N (*: out of range)", text)
        if item in BALLS:
            counted = [abs(ratio - 1) for load_n, ratio, in_range in found if in_range and load_n > LEAST_N]
            worst = max([worst, *counted])
    yield at_most(f"{name}: worst ball in range, %", 100 * worst, 5.0, "%")
    differences = [difference_in_stream(sensor, item) for item in STREAMS[: 1 if quick else None]]
    yield at_most(
        f"{name}: force in a stream beside that of the image alone, largest % of Fz", max(differences), 1.0, "%"
    )


def difference_in_stream(sensor: SensorFolder, item: str) -> float:
    """Return the largest difference of a force component from that of the image alone, in percent of F_z, while an object is
    pressed, dragged and twisted."""
    twin, shape = sensor.twin(), sensor.shape
    stream, alone = (sensor.estimator("physics", with_force_scale=False) for _ in range(2))
    depth_reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(REFERENCES)))
    indenter, last, largest = indenter_from_name(item), None, 0.0
    for number, pose in enumerate(MOTION):
        last = twin.press(last, indenter, pose)
        reading = read_frame(Frame(twin.renderer(last.corrected, number)), shape, depth_reader)
        alone.forget()
        followed, single = (each.estimate(reading).wrench.force_n for each in (stream, alone))
        if -single[2] > LEAST_N:
            largest = max(largest, 100 * float(np.abs(followed - single).max() / -single[2]))
    return largest


def presses_of(sensor: SensorFolder, item: str, depths_mm: tuple[float, ...]) -> Iterator[tuple[float, float, bool]]:
    """Yield the true load, the estimated over the true load, and whether the estimate is in range, as deep as the gel allows."""
    twin, shape = sensor.twin(), sensor.shape
    estimator = sensor.estimator("physics", with_force_scale=False)
    depth_reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(REFERENCES)))
    indenter, last = indenter_from_name(item), None
    for depth_mm in depths_mm:
        try:
            last = twin.press(last, indenter, Pose(*PLACE_MM, depth_mm))
        except ContactLeavesGel:
            return
        estimator.forget()
        found = estimator.estimate(read_frame(Frame(twin.renderer(last.corrected, 1)), shape, depth_reader))
        if found.touching:  # else the image is refused
            ratio = float(found.wrench.six[2] / last.wrench.six[2])
            yield float(last.load_n), ratio, EstimateWarning.OUT_OF_RANGE not in found.warnings


if __name__ == "__main__":
    tyro.cli(own_twin_presses)

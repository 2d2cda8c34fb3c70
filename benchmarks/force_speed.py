"""Height map → wrench by the small network, and raw image → shape and wrench, on one thread.

Without a model one is trained for a moment: how long an answer takes does not depend on its weights. What must be reached
is held against the thread's own times (median), which other programs on the machine do not change; the least wall times
stand beside them.
"""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tyro
from figures import Figure, answer, at_most
from real_sensor import real_sensor
from turns import Tasks, Times, in_turns

from ninedtact import Frame
from ninedtact.design import Gel
from ninedtact.force.estimator_loading import build_estimator
from ninedtact.force.network_force import NetworkForce, prediction_warnings
from ninedtact.force.network_input import sensor_features_of
from ninedtact.force.onnx_model import read_force_model
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import CalibratedShape

ESTIMATE, BOTH = "height → wrench", "frame → height and wrench"
REQUIRED_MS = {ESTIMATE: 5.0, BOTH: 8.0}
PRESSED = ("ball", "board", "ball")
READINGS = ("fine", "fast")
"""With the point-spread undone, and as it is."""


def force_speed(model: Path | None = None, rounds: int = 60, json: bool = False) -> None:
    """Measure, and print what it must reach."""
    with TemporaryDirectory() as folder:
        path = model or trained_for_a_moment(Path(folder))
        times = in_turns({reading: partial(tasks, path, reading) for reading in READINGS}, rounds)
    answer("Speed of the force estimate, one thread", [figure(*name, found) for name, found in times.items()], json)


def figure(reading: str, task: str, found: Times) -> Figure:
    what = f"{reading}: {task}, ms"
    if task in REQUIRED_MS:
        return at_most(what, found.median_cpu_ms, REQUIRED_MS[task], "ms", f"least wall {found.least_ms:.2f}")
    return Figure(what, found.median_cpu_ms, peer=f"least wall {found.least_ms:.2f}")


def tasks(path: Path, reading: str) -> Tasks:
    images, shape = real_sensor("sensor_a")
    shape = shape if reading == "fine" else shape.fast()
    rectify, depth = shape.rectify, shape.depth_reader(Frame(images["ball_reference"]))
    estimator = NetworkForce(read_force_model(path), features=sensor_features_of(shape, Gel()))
    frames = [Frame(images[name]) for name in PRESSED]

    def read(frame: Frame) -> Reading:
        rectified = rectify(frame)
        return Reading(frame, rectified, depth(rectified), reference=depth.reference)

    readings = [read(frame) for frame in frames]
    shown = [estimator.input(one) for one in readings]
    six = estimator.model(shown[0][None]).wrench[0]
    return {
        ESTIMATE: lambda call: estimator.estimate(readings[call % 3]),
        "of it: gate": lambda call: estimator.contact_test(readings[call % 3]),
        "of it: input": lambda call: estimator.input(readings[call % 3]),
        "of it: network": lambda call: estimator.model(shown[call % 3][None]),
        "of it: warnings": lambda call: list(prediction_warnings(shown[call % 3], six, estimator.model.card)),
        "frame → height": lambda call: read(frames[call % 3]),
        BOTH: lambda call: estimator.estimate(read(frames[call % 3])),
        **(by_both(shape, readings[0]) if reading == "fine" else {}),
    }


def by_both(shape: CalibratedShape, held: Reading) -> Tasks:
    """Network and physics on a ball that is held; physics undoes the light itself, so it has no fast reading."""
    together = build_estimator("both", shape, Gel())
    return {"height → wrench by network and physics": lambda _: together.estimate(held)}


def trained_for_a_moment(folder: Path) -> Path:
    from dataclasses import replace

    from ninedtact.force.dataset_split import SplitRows
    from ninedtact.force.training.examples import TrainingExamples
    from ninedtact.force.training.settings import DEFAULT_TRAINING, ComputeSettings
    from ninedtact.force.training.train import train_network

    rng, names = np.random.default_rng(0), ["any"] * 80
    heights = rng.normal(0, 0.1, (80, DEFAULT_TRAINING.input.rows, DEFAULT_TRAINING.input.cols))
    examples = TrainingExamples(heights, rng.normal(0, 1, (80, 6)).astype(np.float32), names, names)
    rows, settings = SplitRows(np.arange(64), np.arange(64, 80)), replace(DEFAULT_TRAINING, epochs=1)
    trained = train_network(examples, rows, settings, folder / "model", machine=ComputeSettings(accelerator="cpu"))
    assert trained is not None
    return trained.path


if __name__ == "__main__":
    tyro.cli(force_speed)

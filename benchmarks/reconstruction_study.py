"""The paper's protocol on twins: 20 presses of another ball at various places, on ten sensors of the population.

Each sensor is calibrated from its own four images, lens and all, by each method; every press has its own place, load,
drag and noise. Errors are of single pixels where the ball has pressed the skin in, against the skin that was drawn. The
published figures are of a real sensor, with the depth told by the rule of the disc's edge: not the same test.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from statistics import median

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_most

from ninedtact import CalibrationImages, CalibrationSettings, Frame, Rectified, calibrate
from ninedtact.calibration.ball.ball_fit import fit_ball
from ninedtact.calibration.procedure import Calibration
from ninedtact.mechanics.indenter import Ball
from ninedtact.shape.calibrated_shape import DepthReader, mean_rectified_image
from ninedtact.shape.depth import DepthMethod, Smoothing
from ninedtact.simulation.calibration_images import GUIDED_FRAMES, GUIDED_PRESSES, simulate_calibration_images
from ninedtact.simulation.ground_truth import true_height_map_like
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact_train.population.mechanics_shares import MechanicsShares
from ninedtact_train.population.sensor_population import SampledSensor, sample_sensor

METHODS: tuple[DepthMethod, ...] = ("physics", "ratio", "table")
READINGS = ("physics", "physics, fast", "ratio", "table")
OTHER_BALL = Ball(5.0)
DEEPER_THAN_MM = 0.05
LIMIT_MM = 0.020
PUBLISHED = {"MAE": 0.0462, "Std": 0.0304}
KINDS: dict[str, MechanicsShares] = {
    "base that yields": MechanicsShares(rigid_base=0.0, linear=0.0),
    "rigid base": MechanicsShares(rigid_base=1.0, linear=0.0),
    "linear gel": MechanicsShares(rigid_base=0.0, linear=1.0),
}


@dataclass(frozen=True)
class Errors:
    """Of one sensor by one reading, mm."""

    mae: float
    std: float
    peak: float
    """Mean absolute error of the deepest point."""


def reconstruction_study(
    sensors: int = 10, presses: int = 20, seed: int = 0, quick: bool = False, json: bool = False
) -> None:
    """Study each kind of member: those whose mechanics the estimator assumes, and those of other mechanics."""
    cv2.setNumThreads(1)
    sensors, presses, kinds_tried = (1, 1, ("base that yields",)) if quick else (sensors, presses, tuple(KINDS))
    method: DepthMethod = "ratio" if quick else "physics"
    figures: list[Figure] = []
    for kind in kinds_tried:
        count = sensors if kind.startswith("as") else max(sensors // 3, 1)
        found = [
            sensor_errors(sample_sensor(number, seed, KINDS[kind]), presses, seed + number, method)
            for number in range(count)
        ]
        figures += list(summary(kind, found))
    answer(f"Reconstruction of a ball of radius {OTHER_BALL.radius_mm:g} mm on twins", figures, json)


def summary(kind: str, found: list[dict[str, Errors]]) -> Iterator[Figure]:
    """Medians over the sensors of one kind."""
    for reading in [name for name in READINGS if name in found[0]]:
        for name, value in (("MAE", "mae"), ("Std", "std"), ("deepest point, MAE", "peak")):
            middle = median(getattr(errors[reading], value) for errors in found)
            figure, peer = f"{kind}, {reading}: {name} (mm)", PUBLISHED.get(name, "")
            required = reading == "physics" and kind.startswith("as") and name in PUBLISHED
            yield at_most(figure, middle, LIMIT_MM, "mm", peer) if required else Figure(figure, middle, peer=peer)


def sensor_errors(who: SampledSensor, presses: int, seed: int, method: DepthMethod) -> dict[str, Errors]:
    """One sensor, calibrated and pressed."""
    twin = who.twin()
    made = calibrate(
        CalibrationImages(**vars(simulate_calibration_images(twin, presses=GUIDED_PRESSES, frames=GUIDED_FRAMES))),
        settings=CalibrationSettings(method=method),
    )
    untouched = mean_rectified_image([made.rectify(Frame(twin.renderer(None, 100 + number))) for number in range(10)])
    readers, rng = dict(readings(made, untouched, method)), np.random.default_rng(seed)
    pressed = [press_errors(who, made, readers, rng, 200 + number) for number in range(presses)]
    return {name: Errors(*np.mean([errors[name] for errors in pressed], axis=0)) for name in pressed[0]}


def readings(made: Calibration, untouched: Rectified, method: DepthMethod) -> Iterator[tuple[str, DepthReader]]:
    """A reader by each method, from the same images."""
    images, design = made.images, made.record.design
    for name in METHODS:
        if name == method:
            fit = made.ball
        elif name == "physics":
            continue
        else:
            fit = fit_ball(made.rectify, images.ball_reference, images.ball, design, name)
        reader = fit.reader(untouched, made.rectify.height_source)
        yield name, reader
        if name == "physics":
            yield "physics, fast", replace(reader, deblurring=None, smoothing=Smoothing())


def press_errors(
    who: SampledSensor, made: Calibration, readers: dict[str, DepthReader], rng: np.random.Generator, number: int
) -> dict[str, tuple[float, float, float]]:
    """One press somewhere: mean and scatter of the pixels' absolute errors, and that of the deepest point."""
    place = rng.uniform((-7, -4.5), (7, 4.5))
    drag = rng.uniform(-0.25, 0.25, 2)
    press = ScriptedPress(float(rng.uniform(0.5, 1.6)), at_mm=(place[0], place[1]), drag_mm=(drag[0], drag[1]))
    contact = press.simulate(who.twin(), OTHER_BALL)
    image = made.rectify(Frame(who.twin().renderer(contact, number)))
    found = {}
    for name, reader in readers.items():
        read = reader(image)
        true_mm = true_height_map_like(contact, read, who.light.inverse_distance_per_mm).indentation_mm
        off_mm = np.abs(read.indentation_mm - true_mm)[true_mm > DEEPER_THAN_MM]
        deepest = abs(float(np.percentile(read.indentation_mm, 99.95)) - float(np.percentile(true_mm, 99.95)))
        found[name] = (float(off_mm.mean()), float(off_mm.std()), deepest)
    return found


if __name__ == "__main__":
    tyro.cli(reconstruction_study)

"""Force without training on twins that were never seen: skill of every axis, light touches, no contact, error bars, time.

Every sensor is calibrated from its own board and ball images (kept in `folders`), and its gel's modulus is told by one known
weight: its ball pressed with 200 g. Images and wrenches are a data set's (`ninedtact simulate dataset`).
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import cv2
import numpy as np
import pyarrow.parquet as pq
import tyro

from ninedtact import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.design import PUBLISHED_MM_PER_PX, rectified_mm_per_px
from ninedtact.errors import NinedtactError
from ninedtact.force.traction.estimator import TractionForce, build_traction_force
from ninedtact.force.traction.traction_from_brightness import SolverSettings
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import EstimateWarning, Frame, HeightSource, Rectified, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.depth import FINE_SMOOTHING, DepthReader
from ninedtact.simulation.calibration_images import CalibrationPressSettings, simulate_calibration_images
from ninedtact.simulation.objects.catalogue import PAPER_COUNT, generated_object_names
from ninedtact_train.dataset.generation.generate import generate_dataset
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact_train.population.rectified_renderer import rectified_renderer
from ninedtact_train.population.sensor_population import SampledSensor, sampled_sensor_from_json

FAMILIES = {
    "cells",
    "dial",
    "saddle",
    "profile_bar",
    "pyramid",
    "foam",
    "spring",
    "ring",
    "punch",
    "letter",
    "puzzle",
    "molar",
    "blob",
    "ball",
    "caltrop",
    "cylinder",
    "dots",
    "spiral",
}
BELOW_SKIN_MM = np.array([0.0, 0.0, -35.0])
WEIGHT_N = 1.96
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
BOARD_MM, GUIDED_FRAMES = 0.85, 8


@dataclass(frozen=True)
class Judged:
    """One image."""

    sensor: str
    mechanics: str
    kind: str
    name: str
    true: np.ndarray
    estimate: WrenchEstimate
    ms: float


def traction_skill(
    dataset: Path = Path("out/force_study/pairs"),
    folders: Path = Path("out/force_study/sensors"),
    sensors: tuple[int, int] = (20, 40),
    every: int = 1,
    weight_n: float = WEIGHT_N,
    effort: SolverSettings = SolverSettings(),
) -> None:
    """Judge sensors from the first to before the second; of their images, each `every`th of the ordinary ones."""
    cv2.setNumThreads(1)
    make_if_missing(dataset)
    found = list(judged(dataset, folders, sensors, every, weight_n, effort))
    mechanics = sorted({one.mechanics for one in found})
    for kind in ("bonded", "finite_strain", "compliant_base"):
        show(kind, [one for one in found if one.kind == "rule" and one.mechanics == kind])
    show("all", [one for one in found if one.kind == "rule"])
    whole = [one for one in found if one.kind == "rule" and EstimateWarning.PART_UNSEEN not in one.estimate.warnings]
    show("all, wholly in view", whole)
    show("bonded, wholly in view", [one for one in whole if one.mechanics == "bonded"])
    show_light(found)
    print(
        f"mechanics: {', '.join(mechanics)}; mean {np.mean([one.ms for one in found]):.0f} ms of processor an image, cold"
    )


def make_if_missing(dataset: Path) -> None:
    """4,000 pairs of 40 sensors and objects of 18 families."""
    if not (dataset / "README.md").is_file():
        names = tuple(name for name in generated_object_names(PAPER_COUNT) if name.rsplit("_", 1)[0] in FAMILIES)
        generate_dataset(
            dataset, GenerationSettings(pairs=4000, sensors=40, seed=1, size=(240, 180), object_names=names), workers=2
        )


def judged(
    dataset: Path, folders: Path, sensors: tuple[int, int], every: int, weight_n: float, effort: SolverSettings
) -> Iterator[Judged]:
    """All images of these sensors, in the data set's order."""
    members = {
        one.name: one
        for one in map(sampled_sensor_from_json, json.loads((dataset / "members/sensors.json").read_text()))
    }
    chosen = list(members)[sensors[0] : sensors[1]]
    references = {row["sensor"]: row for row in pq.read_table(dataset / "references.parquet").to_pylist()}
    benches: dict[str, Bench | None] = {}
    count = 0
    for path in sorted((dataset / "data").glob("*.parquet")):
        for row in pq.read_table(path).to_pylist():
            if row["sensor"] not in chosen:
                continue
            count += row["kind"] == "rule"
            if row["kind"] == "rule" and count % every:
                continue
            if row["sensor"] not in benches:
                benches[row["sensor"]] = bench(
                    members[row["sensor"]], decoded(references[row["sensor"]]), folders, weight_n, effort
                )
            if (set_up := benches[row["sensor"]]) is not None:
                yield judge(row, members[row["sensor"]], set_up)


@dataclass(frozen=True)
class Bench:
    """A sensor set up for images of the data set's size."""

    reader: DepthReader
    estimator: TractionForce

    def reading(self, grey: np.ndarray) -> Reading:
        """Of one image."""
        image = Rectified(grey.astype(np.float32), self.reader.reference.mm_per_px)
        return Reading(Frame(np.zeros((1, 1, 3), np.uint8)), image, self.reader(image), reference=self.reader.reference)


def bench(
    who: SampledSensor, reference: np.ndarray, folders: Path, weight_n: float, effort: SolverSettings
) -> Bench | None:
    """Calibrated from its own images, weighed with one weight; none where the calibration is refused."""
    folder = folders / who.name
    if not (folder / "sensor.toml").is_file():
        try:
            images = simulate_calibration_images(
                who.twin(), presses=CalibrationPressSettings(BOARD_MM), frames=GUIDED_FRAMES
            )
            save_sensor(folder, calibrate(CalibrationImages(**vars(images))))
        except NinedtactError as trouble:
            print(f"{who.name} left out: {trouble}")
            return None
    sensor = load_sensor(folder)
    assert sensor.record.twin is not None
    estimator = build_traction_force(sensor.shape, sensor.record.twin.gel)
    set_up = Bench(reader(sensor.shape, reference), replace(estimator, solver=effort))
    return weighed(set_up, who, weight_n)


def reader(shape: CalibratedShape, reference: np.ndarray) -> DepthReader:
    """For images of the data set's size: the same filters in millimetres."""
    size = reference.shape[::-1]
    pitch = rectified_mm_per_px(size)
    smaller = PUBLISHED_MM_PER_PX / pitch
    smoothing = replace(
        FINE_SMOOTHING, first_px=FINE_SMOOTHING.first_px * smaller, second_px=FINE_SMOOTHING.second_px * smaller
    )
    everywhere = np.full(reference.shape, HeightSource.MEASURED, np.uint8)
    before = Rectified(reference.astype(np.float32), pitch)
    return DepthReader(
        shape.curve,
        before,
        everywhere,
        smoothing,
        shape.noise_mm,
        shape.camera_distance_mm,
        shape.loss,
        shape.deblurring,
    )


def weighed(set_up: Bench, who: SampledSensor, weight_n: float) -> Bench:
    """With the modulus that makes the known weight read right, mean of three places."""
    twin, rng, ratios = who.twin(), np.random.default_rng(7), []
    eye = rectified_renderer(who, set_up.reader.reference.grey.shape[::-1])
    for x, y in ((0.0, 0.0), (2.0, 1.0), (-2.0, -1.0)):
        contact = twin.press(None, Ball(4.0), Pose(x, y, 0.8), weight_n).corrected
        set_up.estimator.forget()
        read = set_up.estimator.estimate(set_up.reading(eye.render(contact, rng)))
        ratios.append(contact.wrench().force_n[2] / read.wrench.force_n[2])
    gel = set_up.estimator.gel
    told = replace(gel, shear_modulus_mpa=gel.shear_modulus_mpa * float(np.mean(ratios)))
    return Bench(set_up.reader, replace(set_up.estimator, gel=told))


def judge(row: dict, who: SampledSensor, set_up: Bench) -> Judged:
    """One image, from a cold start: the data set's images do not follow on each other."""
    reading = set_up.reading(decoded(row))
    set_up.estimator.forget()
    start = process_time()
    estimate = set_up.estimator.estimate(reading)
    ms = (process_time() - start) * 1e3
    return Judged(who.name, who.kind, row["kind"], row["object"], np.array(row["wrench"], float), estimate, ms)


def decoded(row: dict) -> np.ndarray:
    """An image as it is stored."""
    return cv2.imdecode(np.frombuffer(row["image"]["bytes"], np.uint8), cv2.IMREAD_GRAYSCALE)


def show(title: str, found: list[Judged]) -> None:
    """Skill, slope, mean absolute error and coverage of every axis, torques about 35 mm below the skin and its centre."""
    if len(found) < 10:
        return
    true = np.array([one.true for one in found])
    read = np.array([one.estimate.wrench.six for one in found])
    error = np.array([one.estimate.std for one in found])
    print(f"{title}, {len(found)} images")
    line("covered by 2 deviations", (np.abs(true - read) < 2 * error).mean(axis=0))
    line("skill, torques about the skin's centre", skill(true, read))
    true, read = below(true), below(read)
    line("skill, torques 35 mm below", skill(true, read))
    line("slope", [np.polyfit(t, r, 1)[0] for t, r in zip(true.T, read.T, strict=True)])
    line("MAE (N, mN m)", np.abs(true - read).mean(axis=0) * (1, 1, 1, 1e3, 1e3, 1e3))


def below(six: np.ndarray) -> np.ndarray:
    """The same wrenches about a point 35 mm below the skin."""
    return np.concatenate([six[:, :3], six[:, 3:] + np.cross(-BELOW_SKIN_MM / 1e3, six[:, :3])], axis=1)


def skill(true: np.ndarray, read: np.ndarray) -> np.ndarray:
    """One less the mean absolute error over that of always answering the median."""
    return 1 - np.abs(true - read).mean(axis=0) / np.abs(true - np.median(true, axis=0)).mean(axis=0)


def line(name: str, values: np.ndarray | list[float]) -> None:
    """One row."""
    print(f"  {name:40s}" + "".join(f"{axis} {value:6.3f}  " for axis, value in zip(AXES, values, strict=True)))


def show_light(found: list[Judged]) -> None:
    """No contact, light touches, and how warnings are shared out."""
    empty = [one.estimate for one in found if one.kind == "no_contact"]
    light = [one for one in found if one.kind != "no_contact" and one.true[2] > -1]
    print(f"no contact: {sum(one.touching for one in empty)} of {len(empty)} read as touched")
    for low, high in ((0.0, 0.05), (0.05, 0.1), (0.1, 0.3), (0.3, 1.0)):
        some = [one for one in light if low <= -one.true[2] < high]
        if some:
            off = np.mean([abs(one.true[2] - one.estimate.wrench.force_n[2]) for one in some])
            seen = np.mean([one.estimate.touching for one in some])
            print(f"{low:g} to {high:g} N: {len(some)} images, {seen:.0%} found, MAE of Fz {off:.3f} N")
    off = np.mean([abs(one.true[2] - one.estimate.wrench.force_n[2]) for one in light])
    print(f"below 1 N: MAE of Fz {off:.3f} N")
    for warning in EstimateWarning:
        part = np.mean([warning in one.estimate.warnings for one in found])
        print(f"{warning.value}: {part:.1%}")


if __name__ == "__main__":
    tyro.cli(traction_skill)

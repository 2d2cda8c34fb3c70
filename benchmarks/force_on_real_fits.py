"""Force on the twins of six real sensors, each calibrated from its own four images, each image estimated alone.

300 presses on each sensor: objects of all families, 0.3 to 12 N, dragged, twisted and tilted. The modulus is known. Skill is one
less the mean absolute error over that of always answering the median. A second table calibrates each sensor with its base known,
a third reads it with light and gel as they are. Errors are those of the image alone; the last table adds the error of the base, as
`estimate` does. Run it with `make benchmarks/force_on_real_fits`; the presses are kept in
out/force_on_real_fits and made once.

`--wrong` shows what a mistake does to the calibration: a board of 3.1 mm pitch stated as 2.5 mm, a ball of 5 mm stated as 4 mm, a
gel 20 % thinner or thicker than stated, a compliant substrate (`--base-stiffness`), a linear gel. It also prints the warnings and
checks of the certificate.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Literal

import cv2
import numpy as np
import tyro
from real_images import calibrated
from real_sensor_twins import twins_of_real_fits

from ninedtact.calibration.ball.ball_fit import depth_curve_of_brightness_model
from ninedtact.calibration.certificate.checks import compute_certificate_checks
from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder, load_sensor
from ninedtact.calibration.sensor_with_other_base import sensor_with_other_base
from ninedtact.calibration.twin.gel_base import KnownBase
from ninedtact.design import SensorDesign
from ninedtact.errors import CalibrationError
from ninedtact.force.estimator_and_scale import ForceEstimator, force_error_of_base
from ninedtact.force.estimator_loading import PHYSICS, build_estimator
from ninedtact.force.traction.estimator import MODELLED_THINNING, TractionForce
from ninedtact.force.traction.observation import BrightnessObservationModel
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.parallel_jobs import run_jobs
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.depth import GlobalDimmingModel
from ninedtact.shape.image_plausibility import ImageImplausible, require_plausible_image
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.objects.catalogue import PAPER_COUNT, generate_object, generated_object_names
from ninedtact_train.batched.session_requests import SimulatedSetup, run_session_on_cpu
from ninedtact_train.dataset.generation.press_session import PressSettings, RandomPress
from ninedtact_train.evaluation import WrenchPredictions, evaluate_predictions
from ninedtact_train.population.sensor_population import SampledSensor, rectified_renderer

Wrong = Literal["nothing", "pitch", "radius", "thinner", "thicker", "yielding_base", "linear"]
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
LOADS_N = 0.3, 12.0
BELOW_SKIN_MM = (0.0, 0.0, -35.0)
REFERENCES = 10
REFUSAL_FILE = "refusal.txt"


@dataclass(frozen=True)
class Setup:
    """One twin, its calibration and its presses."""

    member: SampledSensor
    folder: Path
    presses: Path

    @property
    def refusal(self) -> str:
        """Why its calibration was refused; empty where it was not."""
        file = self.folder / REFUSAL_FILE
        return file.read_text() if file.is_file() else ""

    def stored(self) -> tuple[list[np.ndarray], np.ndarray, list[np.ndarray], list[str]]:
        """Return reference images, wrenches, images and objects of the presses."""
        with np.load(self.presses) as stored:
            wrenches, objects = stored["wrenches"], json.loads(str(stored["objects"]))
            references = [decoded(stored[f"reference_{number}"]) for number in range(REFERENCES)]
            return (
                references,
                wrenches,
                [decoded(stored[f"image_{number}"]) for number in range(len(wrenches))],
                objects,
            )


@dataclass(frozen=True)
class Judged:
    """The estimates of one estimator on one sensor."""

    predictions: WrenchPredictions
    warned: np.ndarray
    ms: float
    with_true_base: WrenchPredictions
    """Estimates of the sensor calibrated from the same images with its base known."""
    with_true_light: WrenchPredictions
    """Estimates with light and gel as they are: what the inversion alone loses."""
    base_error: float
    """Relative error that `estimate` adds for the base."""


def force_on_real_fits(
    presses: int = 300,
    out: Path = Path("out/force_on_real_fits"),
    sensors: tuple[str, ...] = ("A", "I", "L", "P", "Q", "R"),
    wrong: Wrong = "nothing",
    base_stiffness: float = 10.0,
    workers: int = 2,
    quick: bool = False,
) -> None:
    """Print a table for each sensor, and the mean and worst of all.

    presses: number on each sensor. base_stiffness: modulus of a base that yields over that of the gel.
    """
    cv2.setNumThreads(1)
    presses, sensors, workers = (2, ("A",), 1) if quick else (presses, sensors, workers)
    out = out if wrong == "nothing" else out / (f"{wrong}_{base_stiffness:g}" if wrong == "yielding_base" else wrong)
    setups = [
        Setup(mistaken(twin, wrong, base_stiffness), out / f"sensor_{name}", out / f"{name}_{presses}.npz")
        for name, twin in twins_of_real_fits().items()
        if name in sensors
    ]
    new = [(one.member, one.presses, presses) for one in setups if not one.presses.is_file()]
    uncalibrated = [(one.member, one.folder, wrong) for one in setups if not (one.folder / SENSOR_FILE).is_file()]
    if quick:
        uncalibrated = []
        save_sensor(setups[0].folder, calibrated("sensor_a", "physics"))  # it is another sensor, but calibrated sooner
    for work, jobs in ((make_presses, new), (calibrate_twin, uncalibrated)):
        list(run_jobs(work, jobs, workers))
    for one in setups:
        if one.refusal:
            print(f"{one.member.name}: refused: {one.refusal}")
    setups = [one for one in setups if not one.refusal]
    for one in setups:
        certificate = load_sensor(one.folder).record.certificate
        lines = [line.text for line in compute_certificate_checks(certificate) if line.level != "pass"]
        for said in (*certificate.warnings, *lines):
            print(f"{one.member.name}: {said}")
    results = dict(run_jobs(judge, [(one,) for one in setups], workers))
    print_scores({one.member.name: results[number] for number, one in enumerate(setups)})
    if wrong == "nothing":
        show_images_without_press(setups, untouched=2 if quick else 50)


def make_presses(member: SampledSensor, file: Path, presses: int) -> None:
    """Press objects on the twin and store one image of each press with its wrench."""
    twin = replace(member.twin(), solver_settings=SolverSettings(tolerance=5e-3))
    setup = SimulatedSetup(member, twin, rectified_renderer(member, (92, 69)))
    rng = np.random.default_rng([11, *map(ord, member.name)])
    names = generated_object_names(PAPER_COUNT)
    images, wrenches, objects = [], [], []
    while len(images) < presses:
        name = str(rng.choice(names))
        load_n = float(np.exp(rng.uniform(*np.log(LOADS_N))))
        settings = PressSettings(load_n=(load_n, 0.0), load_range_n=LOADS_N, targets=(2, 2))
        press = RandomPress(setup, generate_object(name), settings, rng)
        last = None
        for target in press.targets():
            contact = run_session_on_cpu(press.step_towards(target))
            if contact is None:
                break
            last = contact
        if last is None or not -last.wrench.force_n[2] >= LOADS_N[0]:
            continue
        images.append(encoded(twin.renderer(last.corrected, len(images))))
        wrenches.append(last.wrench.six)
        objects.append(name)
    references = [encoded(twin.renderer(None, -1 - number)) for number in range(REFERENCES)]
    file.parent.mkdir(parents=True, exist_ok=True)
    packed = {
        f"{kind}_{number}": image
        for kind, some in (("image", images), ("reference", references))
        for number, image in enumerate(some)
    }
    np.savez(file, wrenches=np.array(wrenches), objects=json.dumps(objects), **packed)


def mistaken(member: SampledSensor, wrong: Wrong, base_stiffness: float) -> SampledSensor:
    """Return the twin of which something is stated wrongly, or assumed that does not hold."""
    design, gel = member.design, member.gel
    if wrong == "pitch":
        return replace(member, design=replace(design, pin_board=replace(design.pin_board, pitch_mm=3.1)))
    if wrong == "radius":
        return replace(member, design=replace(design, ball=replace(design.ball, radius_mm=5.0)))
    if wrong == "yielding_base":
        return replace(member, gel=replace(gel, gel_to_base_modulus_ratio=1 / base_stiffness))
    return replace(member, gel=replace(gel, finite_strain=0.0)) if wrong == "linear" else member


def stated_design(member: SampledSensor, wrong: Wrong) -> SensorDesign:
    """Return the design that a person states: the published one, with the board's own pitch unless that is the mistake."""
    usual = SensorDesign()
    if wrong == "pitch":
        return usual
    thicker = {"thinner": 1.2, "thicker": 0.8}.get(wrong, 1.0)
    gel = replace(usual.gel, thickness_mm=usual.gel.thickness_mm * thicker)
    return replace(usual, pin_board=member.design.pin_board, gel=gel)


def calibrate_twin(member: SampledSensor, folder: Path, wrong: Wrong = "nothing") -> None:
    """Calibrate the twin from single images of its own presses, as a person would; write the reason where that is refused."""
    images = simulate_calibration_images(member.twin(), member.design, presses=member.presses)
    design = stated_design(member, wrong)
    try:
        save_sensor(folder, calibrate(CalibrationImages(**vars(images)), design, sensor_id=member.name))
    except CalibrationError as refusal:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / REFUSAL_FILE).write_text(str(refusal))


def calibrated_sensor(name: str, out: Path) -> SensorFolder:
    """Return a sensor that is calibrated once into a folder: a real one from its images, a twin of a real fit from its own."""
    if not (out / name).is_dir():
        if name.startswith("sensor_"):
            save_sensor(out / name, calibrated(name, "physics"))
        else:
            calibrate_twin(twins_of_real_fits()[name], out / name)
    return load_sensor(out / name)


def judge(setup: Setup) -> Judged:
    """Estimate every image alone, with the calibration, with that of a known base, and with light and gel as they are."""
    sensor, member = load_sensor(setup.folder), setup.member
    with_true_base, *_ = estimate_images(
        setup, *physics_of(sensor_with_other_base(sensor, KnownBase(member.gel.gel_to_base_modulus_ratio)), member)
    )
    with_true_light, *_ = estimate_images(setup, sensor.shape, physics_of_true_light(sensor.shape, member))
    base_error = force_error_of_base(sensor.require_twin().modulus_ratio_std)
    return Judged(*estimate_images(setup, *physics_of(sensor, member)), with_true_base, with_true_light, base_error)


def physics_of(sensor: SensorFolder, member: SampledSensor) -> tuple[CalibratedShape, ForceEstimator]:
    """Return shape and force of a calibration; the modulus is known."""
    gel = replace(sensor.gel, shear_modulus_mpa=member.gel.shear_modulus_mpa)
    return sensor.shape, build_estimator(PHYSICS, sensor.shape, gel)


def physics_of_true_light(shape: CalibratedShape, member: SampledSensor) -> ForceEstimator:
    """Return force by physics with light and gel as they are; the stated error of the light stays that of the calibration."""
    light = member.twin().renderer.light
    deepest_mm = MODELLED_THINNING * min(member.gel.thickness_mm, light.thickness_mm)
    curve = depth_curve_of_brightness_model(light, deepest_mm)
    curve = replace(curve, error_mm=(float(np.mean(shape.curve.error_mm)),) * len(curve.error_mm))
    model = BrightnessObservationModel(curve, GlobalDimmingModel(light.global_dimming), light.point_spread_mm)
    return TractionForce(model, member.gel, calibration_checksum=shape.calibration_checksum)


def estimate_images(
    setup: Setup, shape: CalibratedShape, estimator: ForceEstimator
) -> tuple[WrenchPredictions, np.ndarray, float]:
    """Return the estimates of every image alone, which of them are warned of, and the milliseconds of one."""
    member = setup.member
    references, wrenches, images, objects = setup.stored()
    depth_reader = shape.depth_reader(*map(Frame, references))
    read, std, warned, ms = [], [], [], []
    for image in images:
        reading = read_frame(Frame(image), shape, depth_reader)
        estimator.forget()
        start = process_time()
        estimate = estimator.estimate(reading)
        ms.append((process_time() - start) * 1e3)
        read.append(estimate.wrench.six)
        std.append(estimate.std)
        warned.append(bool(estimate.warnings))
    names, centre = [member.name] * len(objects), (0.0, 0.0, 0.0)
    predictions = WrenchPredictions(
        wrenches, np.array(read), np.array(std), objects=objects, sensors=names, about_mm=centre
    )
    return predictions, np.array(warned), float(np.median(ms))


def print_scores(found: dict[str, Judged]) -> None:
    """Print skill, slope and coverage of every sensor, mean and worst; then the same with true base and true light."""
    print(
        "\nskill about the skin's centre | of Tx, Ty 35 mm below | slope of the line fitted to Fz | within 1σ, 2σ | warned | ms"
    )
    print_rows(
        {name: score_row(one.predictions) for name, one in found.items()},
        {name: f"  {one.warned.mean():4.0%}  {one.ms:4.1f}" for name, one in found.items()},
    )
    print("the same, calibrated with the true base: the difference is what the calibration cannot know")
    print_rows({name: score_row(one.with_true_base) for name, one in found.items()}, {})
    print("the same with light and gel as they are: the rest is what the inversion loses")
    print_rows({name: score_row(one.with_true_light) for name, one in found.items()}, {})
    for title, adds_base in (("", False), (", with the error of the base", True)):
        print(f"truth within 1σ and within 2σ{title}, {' '.join(AXES)}, all")
        for name, one in found.items():
            predictions = one.predictions
            std = np.hypot(predictions.std, adds_base * one.base_error * np.abs(predictions.predicted))
            off = np.abs(predictions.error) / std
            within = ([*(off < limit).mean(axis=0), (off < limit).mean()] for limit in (1, 2))
            print(
                f"  {name:6s}" + "  |  ".join("  ".join(f"{share:.2f}" for share in one) for one in within), flush=True
            )


def print_rows(rows: dict[str, np.ndarray], ends: dict[str, str]) -> None:
    """Print a row of numbers for each sensor, with its end, and their mean and worst."""
    table = np.array(list(rows.values()))
    for name, row in {**rows, "mean": table.mean(axis=0), "worst": table.min(axis=0)}.items():
        print(f"  {name:6s}" + format_row(row) + ends.get(name, ""))


def score_row(predictions: WrenchPredictions) -> np.ndarray:
    """Return six skills, two 35 mm below, the slope of F_z, and two coverages."""
    centre = evaluate_predictions(predictions).scores
    below = evaluate_predictions(predictions.about(BELOW_SKIN_MM)).scores
    off = np.abs(predictions.error) / predictions.std
    return np.array([*centre.skill, *below.skill[3:5], centre.slope_with_offset[2], (off < 1).mean(), (off < 2).mean()])


def format_row(row: np.ndarray) -> str:
    """Format one row."""
    skill, below, slope, one, two = row[:6], row[6:8], *row[8:]
    texts = (" ".join(f"{value:.2f}" for value in some) for some in (skill, below, (slope,), (one, two)))
    return "  |  ".join(texts)


def show_images_without_press(setups: list[Setup], untouched: int) -> None:
    """Print how many images are answered well that are no presses of the sensor, and how many of its own presses.

    Without contact the wrench must be exactly zero, a press must be accepted, and all others must be refused, as `estimate` and
    `reconstruct` refuse them.
    """
    print("\nanswered well of all: images that are no presses, and the sensor's own presses")
    presses = {setup.member.name: setup.stored() for setup in setups}
    for setup in setups:
        sensor, member = load_sensor(setup.folder), setup.member
        estimator = build_estimator(PHYSICS, sensor.shape, sensor.gel)
        references, _, own, _ = presses[member.name]
        depth_reader = sensor.shape.depth_reader(*map(Frame, references))
        kinds = {
            "no contact": [member.twin().renderer(None, 1000 + number) for number in range(untouched)],
            "black, white, uniform": [np.full_like(references[0], level) for level in (0, 3, 120, 255)],
            "other sensors": [one for name, other in presses.items() if name != member.name for one in other[2][:40:4]],
            "own presses": own,
        }
        texts = []
        for kind, images in kinds.items():
            well = 0
            for image in images:
                reading = read_frame(Frame(image), sensor.shape, depth_reader)
                accepted = is_plausible(reading)
                if kind == "no contact":
                    estimator.forget()
                    well += accepted and not estimator.estimate(reading).wrench.six.any()
                else:
                    well += accepted is (kind == "own presses")
            texts.append(f"{kind} {well} of {len(images)}")
        print(f"  {member.name:6s}" + "; ".join(texts), flush=True)


def is_plausible(reading: Reading) -> bool:
    """Return whether `estimate` accepts the image of a reading."""
    try:
        require_plausible_image("image", reading.rectified, reading.reference, reading.height)
    except ImageImplausible:
        return False
    return True


def encoded(image: np.ndarray) -> np.ndarray:
    """Return an image as the bytes of a PNG file."""
    return cv2.imencode(".png", image)[1]


def decoded(content: np.ndarray) -> np.ndarray:
    """Return the image in the bytes of a PNG file."""
    return cv2.imdecode(content, cv2.IMREAD_COLOR)


if __name__ == "__main__":
    tyro.cli(force_on_real_fits)

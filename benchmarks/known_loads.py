"""Force on twins of real sensors, on bases from rigid to three times as stiff as the gel, before and after known loads.

Each twin is calibrated from its own four images; neither base nor modulus is stated. The modulus is drawn about the design's with a
quarter of spread. Known loads are presses of a ball of 5 mm: one of 2 N, or four of 0.5 to 8 N. Skill, slope and coverage are those
of F_z of presses of objects of all families, 0.3 to 12 N, as in `force_on_real_fits`; `punch` is the mean error of a flat punch of
3 mm; `base` the error of the modulus of the gel over that of the base, in its stated standard deviations.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tyro
from force_on_real_fits import REFERENCES, SENSOR_FILE, calibrate_twin, decoded, encoded, make_presses
from real_images import calibrated
from real_sensor_twins import twins_of_real_fits

from ninedtact.calibration.force_calibration import STANDARD_GRAVITY, KnownLoadCalibration, PressImage
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.force.estimator_and_scale import MODULUS_KNOWN, ForceEstimator, ScaledForceEstimator
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.mechanics.pose import Pose
from ninedtact.parallel_jobs import run_jobs
from ninedtact.quantities import Frame
from ninedtact.reading import read_frame
from ninedtact_train.evaluation import WrenchPredictions, evaluate_predictions
from ninedtact_train.population.sensor_population import SampledSensor

WEIGHED_N = (0.5, 1.0, 2.0, 4.0, 8.0)
ONE, FOUR = (2,), (0, 1, 3, 4)
PUNCH_N = (2.0, 5.0)
BEFORE, MODULUS = "before", "modulus known"
CASES = {BEFORE: (), MODULUS: (), "1 load": ONE, "4 loads": FOUR}
_PITCH_MM = 0.3
_START = Pose(0.0, 0.0, 0.5)
_MODULUS_STD = 0.25


@dataclass(frozen=True)
class TwinOnBase:
    """One twin, and the files of its calibration and presses."""

    member: SampledSensor
    folder: Path
    presses: Path
    weighed: Path

    @property
    def modulus_factor(self) -> float:
        """True over assumed modulus, by which all loads of the images are multiplied."""
        seed = [*map(ord, self.folder.name)]
        return float(np.exp(_MODULUS_STD * np.random.default_rng(seed).standard_normal()))


def known_loads(
    sensors: tuple[str, ...] = ("A", "L", "P", "Q"),
    ratios: tuple[float, ...] = (0.0, 0.04, 0.1, 0.2, 0.3333),
    presses: int = 16,
    out: Path = Path("out/known_loads"),
    workers: int = 2,
    quick: bool = False,
) -> None:
    """Print a table for each base, and one for all. ratios: modulus of the gel over that of the base. presses: on each twin."""
    cv2.setNumThreads(1)
    if quick:
        sensors, ratios, presses, workers = ("A",), (0.1,), 2, 1
    twins = [twin_on_base(name, ratio, presses, out) for ratio in ratios for name in sensors]
    if quick:
        save_sensor(twins[0].folder, calibrated("sensor_a", "physics"))  # it is another sensor, but calibrated sooner
    cases = (MODULUS, "1 load") if quick else tuple(CASES)
    results = dict(run_jobs(judge, [(twin, cases) for twin in twins], workers))
    twins = [twin for n, twin in enumerate(twins) if results[n]]  # the others cannot be calibrated
    results = [row for _, row in sorted(results.items()) if row]
    print(f"{'base':>14s} {'case':14s}  skill mean worst | slope from to | within 1σ 2σ | punch | base")
    for ratio in (*ratios, None):
        rows = [
            results[n] for n, twin in enumerate(twins) if ratio in (None, twin.member.gel.gel_to_base_modulus_ratio)
        ]
        name = "all" if ratio is None else "rigid" if ratio == 0 else f"gel / {ratio:.2f}"
        for case in cases:
            print(f"{name:>14s} {case:14s}  {line([row[case] for row in rows])}")


def twin_on_base(name: str, ratio: float, presses: int, out: Path) -> TwinOnBase:
    """Return a twin of a real sensor on another base."""
    member = twins_of_real_fits()[name]
    member = replace(member, gel=replace(member.gel, gel_to_base_modulus_ratio=ratio))
    stem = f"{name}_{ratio:g}"
    return TwinOnBase(member, out / f"sensor_{stem}", out / f"{stem}_{presses}.npz", out / f"{stem}_weighed.npz")


def judge(twin: TwinOnBase, cases: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """Return the row of each case, none where the calibration is refused; calibrations and presses are made where their files are
    missing."""
    if not (twin.folder / SENSOR_FILE).is_file():
        calibrate_twin(twin.member, twin.folder)
    if not (twin.folder / SENSOR_FILE).is_file():
        return {}
    for file, make in ((twin.presses, make_random_presses), (twin.weighed, make_weighed_presses)):
        if not file.is_file():
            make(twin, file)
    found = twin.folder / f"known_loads_{twin.presses.stem}.json"
    if not found.is_file():
        found.write_text(json.dumps(judge_cases(twin, cases)))
    return json.loads(found.read_text())


def make_random_presses(twin: TwinOnBase, file: Path) -> None:
    """Press objects of all families."""
    make_presses(twin.member, file, int(file.stem.rsplit("_")[-1]))


def make_weighed_presses(twin: TwinOnBase, file: Path) -> None:
    """Press the ball that is weighed, then the punch that is predicted, and store images and loads."""
    pressed = replace(twin.member.twin(_PITCH_MM), solver_settings=SolverSettings(tolerance=5e-3))
    objects = [*((Ball(5.0), load_n) for load_n in WEIGHED_N), *((FlatPunch(3.0), load_n) for load_n in PUNCH_N)]
    contacts = [pressed.press(None, body, _START, load_n) for body, load_n in objects]
    images = {f"image_{n}": encoded(pressed.renderer(one.corrected, 500 + n)) for n, one in enumerate(contacts)}
    np.savez(file, loads=[float(one.load_n) for one in contacts], **images)


def judge_cases(twin: TwinOnBase, cases: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """Estimate all presses before and after known loads: skill and slope of F_z, shares of errors within 1 σ and 2 σ, error of the
    punch, and error of the base in stated standard deviations, which is not-a-number before loads are known."""
    factor = twin.modulus_factor
    with np.load(twin.presses) as stored, np.load(twin.weighed) as weighed:
        references = tuple(Frame(decoded(stored[f"reference_{number}"])) for number in range(REFERENCES))
        wrenches = factor * stored["wrenches"]
        images = [Frame(decoded(stored[f"image_{number}"])) for number in range(len(wrenches))]
        loads_n = factor * weighed["loads"]
        pressed = [Frame(decoded(weighed[f"image_{number}"])) for number in range(len(loads_n))]
    calibration = KnownLoadCalibration(load_sensor(twin.folder))
    balls = [
        PressImage(f"ball of {load_n:.1f} N", pressed[n], references)
        for n, load_n in enumerate(loads_n[: len(WEIGHED_N)])
    ]
    known = [
        calibration.estimate(ball, load_n / STANDARD_GRAVITY * 1e3)
        for ball, load_n in zip(balls, loads_n[: len(balls)], strict=True)
    ]
    rows = {}
    for case in cases:
        chosen, sensor, base = CASES[case], calibration.sensor, float("nan")
        estimator = sensor.estimator()
        if case == MODULUS:
            estimator = ScaledForceEstimator(
                sensor.estimator(with_force_scale=False), replace(MODULUS_KNOWN, factor=factor)
            )
        if chosen:
            fit = calibration.fit([known[n] for n in chosen])
            sensor = calibration.adapted_sensor(fit, [known[n] for n in chosen], [balls[n] for n in chosen])
            estimator = sensor.estimator()
            base = (fit.ratio - twin.member.gel.gel_to_base_modulus_ratio) / fit.ratio_std
        estimates, std = estimated(sensor, estimator, references, images)
        punches, _ = estimated(sensor, estimator, references, pressed[len(balls) :])
        off = np.abs(estimates - wrenches)[:, 2] / std[:, 2]
        scores = evaluate_predictions(WrenchPredictions(wrenches, estimates)).scores
        punch = np.mean(-punches[:, 2] / loads_n[len(balls) :] - 1)
        skill, slope, within = scores.skill[2], scores.slope_with_offset[2], [(off < most).mean() for most in (1, 2)]
        rows[case] = tuple(map(float, (skill, slope, *within, punch, base)))
    return rows


def estimated(
    sensor: SensorFolder, estimator: ForceEstimator, references: tuple[Frame, ...], images: list[Frame]
) -> tuple[np.ndarray, np.ndarray]:
    """Return wrenches and standard deviations of images, each estimated alone."""
    depth_reader = sensor.shape.depth_reader(*references)
    found = []
    for image in images:
        estimator.forget()
        found.append(estimator.estimate(read_frame(image, sensor.shape, depth_reader)))
    return np.array([one.wrench.six for one in found]), np.array([one.std for one in found])


def line(rows: list[tuple[float, ...]]) -> str:
    """Format the mean and worst of several twins."""
    skill, slope, one, two, punch, base = np.array(rows).T
    bases = " ".join(f"{each:+.1f}" for each in base if np.isfinite(each))
    of_skill = f"{skill.mean():10.2f} {skill.min():5.2f} | {slope.min():5.2f} {slope.max():5.2f}"
    return f"{of_skill}   | {one.mean():8.2f} {two.mean():4.2f} | {np.abs(punch).mean():5.0%} | {bases}"


if __name__ == "__main__":
    tyro.cli(known_loads)

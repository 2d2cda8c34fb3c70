"""What `ninedtact adapt --recording` gains: twins of real sensors, pressed freely on a force/torque sensor that is not aligned.

Each twin is calibrated from its own four images; neither base nor modulus is stated. Its gel is stiffer or softer than the design's
by a quarter, and feels shear stronger or weaker by a fifth than the estimator says. The force/torque sensor is turned, beside its
place, delayed, and has bias, drift and noise. Skill of all six components, and coverage of F_z, before and after are those of
contacts of another recording of the same twin, each image estimated alone. The second table compares what was found with what is
true.
"""

from dataclasses import dataclass, replace
from math import radians
from pathlib import Path

import cv2
import numpy as np
import tyro
from force_on_real_fits import SENSOR_FILE, calibrate_twin
from known_loads import TwinOnBase, twin_on_base
from real_images import calibrated
from scipy.spatial.transform import Rotation

from ninedtact.calibration.force_calibration import ForceCalibration, calibrate_force
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.capture.force_torque.wrench_source_from_address import mount_rotation
from ninedtact.design import ForceTorqueMount
from ninedtact.force.estimator_and_scale import SHEAR_COMPONENTS
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.pose import Pose
from ninedtact.parallel_jobs import run_jobs
from ninedtact.quantities import Frame, Wrench
from ninedtact.reading import read_frame
from ninedtact.recording import RecordingMetadata, RecordingWriter, Topic
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.recorded_pressing import RecordedPressing
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press_sequence import ObjectTrajectory, PressSequence
from ninedtact.simulation.trajectory import press_trajectory
from ninedtact.simulation.twin import Twin
from ninedtact_train.evaluation import WrenchPredictions, evaluate_predictions

OBJECTS = ("ball:4", "ball:6", "cylinder:3,11", "ball:8", "gear_07", "letter_03", "ring_02", "ball:5", "punch:3")
IMAGES_HZ, SAMPLES_HZ = 10.0, 200.0
REFERENCES, EVERY, LEAST_N = 10, 3, 0.2
NOISE = np.array([0.02, 0.02, 0.03, 5e-4, 5e-4, 3e-4])
_PITCH_MM, _DEEPEST, _DRAG_MM = 0.3, 0.42, 0.5


@dataclass(frozen=True)
class Truth:
    """What differs from the calibration and from the design's force/torque sensor."""

    modulus: float
    shear: float
    mount: ForceTorqueMount
    delay_s: float
    bias: np.ndarray
    drift: np.ndarray
    """Over the whole recording."""

    @property
    def factors(self) -> np.ndarray:
        """True over simulated wrench."""
        return self.modulus * np.where(SHEAR_COMPONENTS, self.shear, 1.0)


@dataclass(frozen=True)
class Pressed:
    """Images of a twin, the first ones without contact, and wrenches on the skin."""

    images: list[np.ndarray]
    wrenches: np.ndarray


def free_pressing(
    sensors: tuple[str, ...] = ("A", "L"),
    ratios: tuple[float, ...] = (0.0, 0.1),
    contacts: int = 18,
    kept_out: int = 9,
    out: Path = Path("out/free_pressing"),
    workers: int = 2,
    quick: bool = False,
) -> None:
    """Print both tables. ratios: modulus of the gel over that of the base. contacts: in the recording that teaches."""
    cv2.setNumThreads(1)
    if quick:
        sensors, ratios, contacts, kept_out, workers = ("A",), (0.1,), 3, 1, 1
    twins = [twin_on_base(name, ratio, contacts, out) for ratio in ratios for name in sensors]
    if quick:
        save_sensor(
            twins[0].folder, calibrated("sensor_a", "physics")
        )  # its own twin is pressed, because it is calibrated sooner
    jobs = [(twin, contacts, kept_out, quick) for twin in twins]
    found = dict(run_jobs(judge, jobs, workers))
    print(f"{'twin':10s} {'case':10s}   Fx   Fy   Fz   Tx   Ty   Tz | Fz within 1σ 2σ")
    for number, twin in enumerate(twins):
        for case, row in found[number][0].items():
            print(
                f"{name_of(twin):10s} {case:10s} "
                + " ".join(f"{each:4.2f}" for each in row[:6])
                + f" | {row[6]:9.2f} {row[7]:4.2f}"
            )
    print(f"\n{'twin':10s} {'parameter':32s} {'true':>8s} {'found':>8s} {'±':>7s}")
    for number, twin in enumerate(twins):
        for name, true, value, std in found[number][1]:
            print(f"{name_of(twin):10s} {name:32s} {true:8.3f} {value:8.3f} {std:7.3f}")


def name_of(twin: TwinOnBase) -> str:
    """Return the sensor and the modulus of its gel over that of the base."""
    return twin.folder.name.removeprefix("sensor_").replace("_", " / ")


def judge(
    twin: TwinOnBase, contacts: int, kept_out: int, quick: bool
) -> tuple[dict[str, list[float]], list[tuple[str, float, float, float]]]:
    """Return skill and coverage of each case, and each parameter with its true and found value and its ±."""
    if not (twin.folder / SENSOR_FILE).is_file():
        calibrate_twin(twin.member, twin.folder)
    folder = load_sensor(twin.folder)
    pressed_twin = (
        folder.twin() if quick else replace(twin.member.twin(_PITCH_MM), solver_settings=SolverSettings(tolerance=5e-3))
    )
    truth = sample_truth(twin)
    file = twin.folder.parent / f"{twin.folder.name}_{contacts}.mcap"
    file.unlink(missing_ok=True)
    write_recording(file, folder, press(pressed_twin, contacts, seed=0), truth)
    judged = press(pressed_twin, kept_out, seed=1)
    with RecordedPressing(file, folder) as pressing:
        found = calibrate_force(folder, save=False, pressing=pressing)
    file.unlink()
    cases = {"before": folder, "after": found.sensor}
    return {case: score(sensor, judged, truth) for case, sensor in cases.items()}, compare(found, truth, pressed_twin)


def sample_truth(twin: TwinOnBase) -> Truth:
    """Return what differs for a twin."""
    rng = np.random.default_rng([*map(ord, twin.folder.name)])
    upside_down, reaction = rng.random(2) < 0.5
    x_deg, y_deg, about_deg = (*rng.normal(0, 3, 2), rng.uniform(-180, 180))
    x, y, z = np.array(ForceTorqueMount().origin_mm) + rng.normal(0, 5, 3)
    turned = (x_deg + 180 * bool(upside_down), y_deg, about_deg)
    return Truth(
        modulus=twin.modulus_factor,
        shear=float(np.exp(rng.normal(0, 0.2))),
        mount=ForceTorqueMount((x, y, z), turned, -1 if reaction else 1),
        delay_s=float(rng.uniform(-0.4, 0.4)),
        bias=rng.normal(0, 1, 6) * [1, 1, 2, 0.02, 0.02, 0.01],
        drift=rng.normal(0, 1, 6) * [0.2, 0.2, 0.4, 4e-3, 4e-3, 2e-3],
    )


def press(twin: Twin, contacts: int, seed: int) -> Pressed:
    """Press objects one after the other, dragged and twisted, at different depths and places."""
    rng, trajectories = np.random.default_rng(seed), []
    for number in range(contacts):
        name = OBJECTS[(number + 4 * seed) % len(OBJECTS)]
        depth_mm = rng.uniform(0.25, 1) * _DEEPEST * twin.gel.thickness_mm * (1.0 if name.startswith("ball") else 0.7)
        pose = Pose(rng.uniform(-2.5, 2.5), rng.uniform(-1.8, 1.8), depth_mm, rng.uniform(0, np.pi))
        drag_mm = tuple(_DRAG_MM * rng.uniform(-1, 1, 2))
        trajectory = press_trajectory(pose, drag_mm, radians(rng.uniform(-12, 12)), speed=1.2)
        trajectories.append(ObjectTrajectory(indenter_from_name(name), trajectory))
    sequence = PressSequence(twin, trajectories, IMAGES_HZ, real_time=False, rounds=1)
    sequence.join()
    images, wrenches = [twin.renderer(None, -1 - each) for each in range(REFERENCES)], [np.zeros(6)] * REFERENCES
    for step in range(int(sequence.round_s * IMAGES_HZ)):
        pressed = sequence.press(step)
        images.append(twin.renderer(pressed.corrected, step))
        wrenches.append(pressed.wrench.six)
    return Pressed(images, np.array(wrenches))


def write_recording(file: Path, folder: SensorFolder, pressed: Pressed, truth: Truth) -> None:
    """Write images, and the samples as `ninedtact record` turns them by the mount of the design."""
    at_s, rng, began_ns = np.arange(len(pressed.images)) / IMAGES_HZ, np.random.default_rng(1), 10**12
    samples_s = np.arange(-1.0, at_s[-1] + 1, 1 / SAMPLES_HZ)
    true = truth.factors * np.stack([np.interp(samples_s - truth.delay_s, at_s, one) for one in pressed.wrenches.T], 1)
    design, turn = folder.record.design.force_torque, truth.mount.sign * mount_rotation(truth.mount)
    origin_m = np.array(truth.mount.origin_mm) / 1e3
    six = np.hstack([true[:, :3] @ turn, (true[:, 3:] - np.cross(origin_m, true[:, :3])) @ turn]) + truth.bias
    six += np.outer((samples_s - samples_s[0]) / np.ptp(samples_s), truth.drift) + NOISE * rng.standard_normal(
        six.shape
    )
    metadata, attached = RecordingMetadata(folder.id), sensor_folder_attachments(folder.path)
    with RecordingWriter(file, metadata, (Topic.IMAGES, Topic.MEASURED), attached) as writer:
        for number, image in enumerate(pressed.images):
            writer.write_image(Frame(image, began_ns + int(at_s[number] * 1e9), number))
        for sample_s, one in zip(samples_s, six, strict=True):
            wrench = Wrench(one[:3], one[3:], np.array(design.origin_mm), began_ns + int(sample_s * 1e9))
            writer.write_measured(wrench.about(np.zeros(3)))


def score(sensor: SensorFolder, judged: Pressed, truth: Truth) -> list[float]:
    """Return the skill of the six components, and the share of F_z within one and two standard deviations."""
    depth_reader, estimator = sensor.shape.depth_reader(*map(Frame, judged.images[:REFERENCES])), sensor.estimator()
    wanted, found, std = [], [], []
    for image, six in list(zip(judged.images, truth.factors * judged.wrenches, strict=True))[::EVERY]:
        if -six[2] < LEAST_N:
            continue
        estimator.forget()
        estimate = estimator.estimate(read_frame(Frame(image), sensor.shape, depth_reader))
        wanted.append(six)
        found.append(estimate.wrench.six)
        std.append(estimate.std)
    true, estimated = np.array(wanted), np.array(found)
    off = np.abs(estimated - true)[:, 2] / np.array(std)[:, 2]
    skill = evaluate_predictions(WrenchPredictions(true, estimated)).scores.skill
    return [*map(float, skill), float((off < 1).mean()), float((off < 2).mean())]


def compare(found: ForceCalibration, truth: Truth, twin: Twin) -> list[tuple[str, float, float, float]]:
    """Return name, true and found value and standard deviation of each parameter."""
    known, gel, pressing = found.sensor.record.known_loads, found.sensor.gel, found.pressing
    assert known is not None and pressing is not None
    alignment, std = pressing.alignment, pressing.alignment.std
    stiffness = gel.shear_modulus_mpa / twin.gel.shear_modulus_mpa
    rows = [
        ("modulus over the design's", truth.modulus, stiffness, stiffness * known.modulus_std),
        ("gel over base", twin.gel.gel_to_base_modulus_ratio, gel.gel_to_base_modulus_ratio, known.modulus_ratio_std),
        ("shear factor, estimator exact", truth.shear, known.shear_factor, known.shear_factor * known.shear_std),
        ("delay, s", truth.delay_s, alignment.delay_s, float(std[0])),
    ]
    off = np.degrees(Rotation.from_matrix(mount_rotation(truth.mount) @ alignment.rotation).as_rotvec())
    for axis, name in enumerate("xyz"):
        rows.append((f"error of rotation about {name}, °", 0.0, float(off[axis]), float(np.degrees(std[6 + axis]))))
    for axis, name in enumerate("xyz"):
        rows.append(
            (
                f"origin {name}, mm",
                truth.mount.origin_mm[axis],
                float(alignment.origin_mm[axis]),
                float(1e3 * std[3 + axis]),
            )
        )
    rows.append(("sign", truth.mount.sign, alignment.sign, 0.0))
    rows.append(("drift of Fz, N", truth.drift[2], float(alignment.drift[2]), float(NOISE[2])))
    return rows


if __name__ == "__main__":
    tyro.cli(free_pressing)

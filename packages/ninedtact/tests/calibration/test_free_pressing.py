"""Free pressing with a force/torque sensor: laws of the alignment, what is refused, and the command on a recording of the twin."""

import json
import shutil
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ninedtact.calibration.force_calibration import CALIBRATION_BALL, STANDARD_GRAVITY
from ninedtact.calibration.free_pressing.force_torque_alignment import (
    EstimatedMoments,
    fit_alignment,
)
from ninedtact.calibration.free_pressing.pressing import ForceTorqueSamples, PressingUnusable, find_stuck_samples
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.calibration.sensor_with_other_base import load_on_calibration_ball_n
from ninedtact.capture.force_torque.wrench_source_from_address import mount_rotation
from ninedtact.cli import main
from ninedtact.design import ForceTorqueMount
from ninedtact.force.estimator_and_scale import SHEAR_COMPONENTS
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, Wrench
from ninedtact.reading import read_frame
from ninedtact.recording import RecordingMetadata, RecordingWriter, Topic
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press_sequence import ObjectTrajectory, PressSequence
from ninedtact.simulation.trajectory import press_trajectory
from ninedtact.simulation.twin import default_twin

NOISE = np.array([0.02, 0.02, 0.03, 5e-4, 5e-4, 3e-4])
BIAS, DRIFT = np.array([0.4, -0.3, 1.5, 0.01, -0.02, 0.005]), np.array([0.2, 0.1, -0.5, 0.004, 0.002, 0.0])
MODULUS, SHEAR = 1.2, 1.3
SAMPLES_HZ, IMAGES_HZ = 200.0, 10.0


def measure(
    at_s: np.ndarray, six: np.ndarray, mount: ForceTorqueMount, delay_s: float = 0.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Times and samples of a device with bias, drift and noise under wrenches on the skin, in the frame of the device."""
    samples_s = np.arange(at_s[0] - 1, at_s[-1] + 1, 1 / SAMPLES_HZ)
    force_n, torque_nm = np.split(np.stack([np.interp(samples_s - delay_s, at_s, one) for one in six.T], 1), 2, axis=1)
    torque_nm = torque_nm - np.cross(np.array(mount.origin_mm) / 1e3, force_n)
    turn = mount.sign * mount_rotation(mount)
    drift = np.outer((samples_s - samples_s[0]) / np.ptp(samples_s), DRIFT)
    noise = NOISE * np.random.default_rng(seed).standard_normal((len(samples_s), 6))
    return samples_s, np.hstack([force_n @ turn, torque_nm @ turn]) + BIAS + drift + noise


def pressing(drag: float = 0.3) -> tuple[np.ndarray, np.ndarray, EstimatedMoments]:
    """Times, true wrenches of fifteen contacts, and estimates of them with an error of 8 % for each contact and 3 % besides."""
    rng, wrenches, groups, gains = np.random.default_rng(1), [], [], []
    for contact in range(15):
        load_n, along, at_m = rng.uniform(1, 8), drag * rng.uniform(-1, 1, 2), rng.uniform(-3e-3, 3e-3, 2)
        gain = np.exp(rng.normal(0, 0.08))
        for step in range(-6, 17):
            pressed = max(0.0, min(step / 6, 1, (17 - step) / 3)) * load_n
            force_n = np.array([*(along * min(max(step - 6, 0) / 5, 1) * pressed), -pressed])
            wrenches.append([*force_n, *np.cross([*at_m, 0.0], force_n)])
            groups.append(contact if step > 0 else -1 - contact)
            gains.append(gain)
    true = np.array(wrenches)
    scale = 0.03 * np.abs(true[:, [2]]) * [1, 1, 1, 5e-3, 5e-3, 5e-3]
    estimated = true * np.array(gains)[:, None] + scale * rng.standard_normal(true.shape)
    std = scale + 0.08 * np.abs(estimated) + [0.01, 0.01, 0.03, 2e-4, 2e-4, 5e-5]
    at_s = np.arange(len(true)) / 8.0
    moments = EstimatedMoments(at_s, np.array(groups), estimated, std[:, :, None] ** 2 * np.eye(6))
    return at_s, MODULUS * true * np.where(SHEAR_COMPONENTS, SHEAR, 1.0), moments


MOUNTS = {
    "as designed": ForceTorqueMount(),
    "turned and lower": ForceTorqueMount((4.0, -3.0, -50.0), (3.0, -2.0, 130.0)),
    "upside down": ForceTorqueMount((2.0, 1.0, -30.0), (178.0, 3.0, 10.0)),
    "on its side, reporting the reaction": ForceTorqueMount((0.0, 10.0, -20.0), (80.0, 2.0, 30.0), -1),
}


@pytest.mark.parametrize(
    ("mount", "delay_s"), list(zip(MOUNTS.values(), (0.0, 0.12, -0.5, 0.5), strict=True)), ids=MOUNTS
)
def test_an_alignment_is_found_within_its_errors(mount: ForceTorqueMount, delay_s: float) -> None:
    at_s, true, moments = pressing()
    samples_s, six = measure(at_s, true, mount, delay_s)
    samples = ForceTorqueSamples(samples_s, six, np.ones(len(six), bool))
    found = fit_alignment(moments, samples, ForceTorqueMount())
    assert found.sign == mount.sign and abs(found.delay_s - delay_s) < 0.01
    turn = Rotation.from_matrix(mount_rotation(mount) @ found.rotation).as_rotvec()
    assert (np.abs(turn) < 4 * found.std[6:]).all() and np.degrees(np.linalg.norm(turn)) < 4
    assert (np.abs(found.origin_mm - mount.origin_mm) < 4e3 * found.std[3:6]).all()
    for factor, wanted, std in ((found.factor, MODULUS, found.std[1]), (found.shear_factor, SHEAR, found.std[2])):
        assert abs(np.log(factor / wanted)) < 4 * std < 0.4
    assert found.drift == pytest.approx(DRIFT * np.ptp(at_s) / np.ptp(samples_s), abs=0.1)
    off = found.wrench_on_skin(at_s, samples) - true
    assert np.abs(off[:, :3]).mean() < 0.06 and np.abs(off[:, 3:]).mean() < 1e-3
    upside_down = mount is MOUNTS["upside down"]
    assert found.is_upside_down(ForceTorqueMount()) == upside_down
    assert found.turned_from_deg(mount) < 4


@pytest.mark.parametrize(("mount", "drag"), [("as designed", 0.0), ("upside down", 0.3)])
def test_a_camera_that_mirrors_its_images_is_told_by_shear(mount: str, drag: float) -> None:
    """However the device is mounted; straight presses do not tell it."""
    at_s, true, moments = pressing(drag)
    samples_s, six = measure(at_s, true, MOUNTS[mount])
    samples = ForceTorqueSamples(samples_s, six, np.ones(len(six), bool))
    with pytest.raises(PressingUnusable, match="--camera-mirrored") if drag else nullcontext():
        fit_alignment(moments.mirrored, samples, ForceTorqueMount())


def test_what_straight_presses_do_not_tell_keeps_its_prior() -> None:
    at_s, true, moments = pressing(drag=0.0)
    samples_s, six = measure(at_s, true, ForceTorqueMount())
    found = fit_alignment(moments, ForceTorqueSamples(samples_s, six, np.ones(len(six), bool)), ForceTorqueMount())
    assert found.std[2] > 0.15 and abs(np.log(found.shear_factor)) < 0.3
    assert abs(np.log(found.factor / MODULUS)) < 4 * found.std[1] < 0.2


def test_samples_of_another_time_or_place_are_refused() -> None:
    at_s, true, moments = pressing()
    samples_s, six = measure(at_s, true, ForceTorqueMount(), delay_s=0.8)
    usable = np.ones(len(six), bool)
    with pytest.raises(PressingUnusable, match=r"agree within 0\.6 s, got samples 0\.80 s after the images"):
        fit_alignment(moments, ForceTorqueSamples(samples_s, six, usable), ForceTorqueMount())
    noise = BIAS + NOISE * np.random.default_rng(0).standard_normal(six.shape)
    with pytest.raises(PressingUnusable, match="rise and fall"):
        fit_alignment(moments, ForceTorqueSamples(samples_s, noise, usable), ForceTorqueMount())


def test_stuck_axes_are_named_and_left_out() -> None:
    at_s, true, _ = pressing()
    samples_s, six = measure(at_s, true, ForceTorqueMount())
    assert find_stuck_samples(samples_s, six)[0].all()
    clipped = six.copy()
    clipped[:, 2] = np.maximum(clipped[:, 2], -4.0)
    usable, (notice,) = find_stuck_samples(samples_s, clipped)
    assert notice.startswith("Fz was saturated at -4 N for ") and (six[~usable, 2] <= -4).all() and not usable.all()
    held = six.copy()
    held[1000:1100] = held[1000]
    usable, notices = find_stuck_samples(samples_s, held)
    assert len(notices) == 6 and all("was frozen" in notice for notice in notices)
    assert not usable[1000:1100].any() and usable.sum() == len(six) - 100
    held[:, 0] = 1.0
    with pytest.raises(PressingUnusable, match="Fx frozen at 1 N all the time"):
        find_stuck_samples(samples_s, held)
    with pytest.raises(PressingUnusable, match="10 samples of the force/torque sensor a second"):
        find_stuck_samples(samples_s[::50], six[::50])


OBJECTS = ("ball:4", "cylinder:3,11", "ball:6", "punch:3", "ball:5", "ball:4", "ball:3")
CONTRADICTING = 4


def press_twin(seed: int, contacts: int) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Images of a twin, the first ten without contact, true wrenches, and the object of each image."""
    rng, twin = np.random.default_rng(seed), default_twin()
    trajectories = []
    for name in OBJECTS[:contacts]:
        pose = Pose(*rng.uniform(-2, 2, 2), rng.uniform(0.4, 0.9), rng.uniform(0, 3))
        trajectory = press_trajectory(pose, tuple(rng.uniform(-0.4, 0.4, 2)), speed=1.5)
        trajectories.append(ObjectTrajectory(indenter_from_name(name), trajectory))
    sequence = PressSequence(twin, trajectories, IMAGES_HZ, real_time=False, rounds=1)
    sequence.join()
    steps = range(int(sequence.round_s * IMAGES_HZ))
    pressed = [sequence.press(step) for step in steps]
    images = [twin.renderer(None, -1 - number) for number in range(10)]
    images += [twin.renderer(press.corrected, step) for step, press in zip(steps, pressed, strict=True)]
    six = np.concatenate([np.zeros((10, 6)), [press.wrench.six for press in pressed]])
    objects = [-1] * 10 + [sequence.trajectory_at(step / IMAGES_HZ)[0] for step in steps]
    return images, six, np.array(objects)


def write_recording(
    path: Path,
    sensor: SensorFolder,
    images: list[np.ndarray],
    samples: tuple[np.ndarray, np.ndarray] | None,
    sensor_id: str = "",
) -> Path:
    """Write a recording as `ninedtact record` does: samples as the mount of the design turns them."""
    mount, began_ns = sensor.record.design.force_torque, 10**12
    topics = (Topic.IMAGES, *((Topic.MEASURED,) if samples else ()))
    attached = {} if sensor_id else sensor_folder_attachments(sensor.path)
    with RecordingWriter(path, RecordingMetadata(sensor_id or sensor.id), topics, attached) as writer:
        for number, image in enumerate(images):
            writer.write_image(Frame(image, began_ns + int(number / IMAGES_HZ * 1e9), number))
        for at_s, six in zip(*samples, strict=True) if samples else ():
            wrench = Wrench(six[:3], six[3:], np.array(mount.origin_mm), began_ns + int(at_s * 1e9))
            writer.write_measured(wrench.about(np.zeros(3)))
    return path


@pytest.fixture(scope="module")
def pressed() -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    return press_twin(0, len(OBJECTS))


def true_samples(
    pressed: tuple[list[np.ndarray], np.ndarray, np.ndarray], mount: ForceTorqueMount, delay_s: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Samples under a gel that is stiffer, in shear even more, than the sensor assumes; a hand holds most of one contact."""
    _, six, objects = pressed
    true = MODULUS * six * np.where(SHEAR_COMPONENTS, SHEAR, 1.0)
    true[objects == CONTRADICTING] *= 0.35
    return measure(np.arange(len(six)) / IMAGES_HZ, true, mount, delay_s)


def test_a_recording_teaches_a_sensor_its_forces(
    physical_sensor: SensorFolder,
    pressed: tuple[list[np.ndarray], np.ndarray, np.ndarray],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    sensor = shutil.copytree(physical_sensor.path, tmp_path / "sensor")
    mount = ForceTorqueMount((1.0, -2.0, -30.0), (181.0, 4.0, 20.0))
    path = write_recording(tmp_path / "press.mcap", load_sensor(sensor), pressed[0], true_samples(pressed, mount, 0.15))
    words = ["adapt", "--sensor", str(sensor), "--recording", str(path)]
    ball_g = MODULUS * load_on_calibration_ball_n(physical_sensor) / STANDARD_GRAVITY * 1e3
    assert main([*words, "--ball-grams", f"{ball_g:.0f}", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    device = told["force_torque"]
    assert device["delay_s"] == pytest.approx(0.15, abs=0.02) and device["sign"] == 1
    assert Rotation.from_euler("xyz", device["rotation_deg"], degrees=True).as_matrix() == pytest.approx(
        mount_rotation(mount), abs=0.06
    )
    assert device["origin_mm"] == pytest.approx(mount.origin_mm, abs=3) and told["contacts"] == len(OBJECTS)
    (named,) = told["notices"]
    contact_s = (np.flatnonzero(pressed[2] == CONTRADICTING) / IMAGES_HZ)[[0, -1]]
    begin_s, end_s = (float(word) for word in named.split()[3:6:2])
    assert contact_s[0] < begin_s < end_s < contact_s[1] + 0.1 and "is left out" in named
    folder = load_sensor(sensor)
    known, gel, twin = folder.record.known_loads, folder.gel, default_twin()
    assert known is not None and not folder.is_edited and known.presses == len(told["presses"])
    assert told["presses"][0]["name"] == CALIBRATION_BALL and len(told["presses"]) > 10
    assert abs(np.log(gel.shear_modulus_mpa / MODULUS / twin.gel.shear_modulus_mpa)) < 2 * known.modulus_std
    assert known.shear_std < 0.15 and known.shear_factor > 1.1
    better = np.array(told["kept_out"]["skill_after"]) - told["kept_out"]["skill_before"]
    assert (better[:3] > 0.05).all()
    images, six, _ = press_twin(1, 3)
    true = MODULUS * six * np.where(SHEAR_COMPONENTS, SHEAR, 1.0)
    before, after = (np.abs(estimate(each, images) - true).mean(axis=0) for each in (physical_sensor, folder))
    assert (after[:3] < 0.7 * before[:3]).all(), "contacts of another day are estimated better"


def estimate(sensor: SensorFolder, images: list[np.ndarray]) -> np.ndarray:
    estimator = sensor.estimator()
    depth_reader = sensor.shape.depth_reader(*map(Frame, images[:10]))
    return np.array(
        [estimator.estimate(read_frame(Frame(image), sensor.shape, depth_reader)).wrench.six for image in images]
    )


def test_recordings_that_teach_nothing_are_refused_in_one_sentence(
    physical_sensor: SensorFolder,
    pressed: tuple[list[np.ndarray], np.ndarray, np.ndarray],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    images, samples = pressed[0], true_samples(pressed, ForceTorqueMount())
    other = (images[0][::-1].copy(),) * 30
    cases = {
        "samples of a force/torque sensor in": write_recording(tmp_path / "a.mcap", physical_sensor, images[:20], None),
        "a recording of sensor my_sensor": write_recording(
            tmp_path / "b.mcap", physical_sensor, images[:20], samples, "another"
        ),
        "at least 3 contacts": write_recording(tmp_path / "c.mcap", physical_sensor, images[:12], samples),
        "to show sensor my_sensor without contact": write_recording(
            tmp_path / "d.mcap", physical_sensor, list(other), samples
        ),
    }
    for expected, path in cases.items():
        before = (physical_sensor.path / "sensor.toml").read_bytes()
        assert main(["adapt", "--sensor", str(physical_sensor.path), "--recording", str(path)]) == 1
        (sentence,) = capsys.readouterr().err.splitlines()
        assert sentence.startswith("ninedtact: expected") and expected in sentence
        assert (physical_sensor.path / "sensor.toml").read_bytes() == before

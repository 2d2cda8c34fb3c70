"""One press gives one image and one wrench by every entry point: the gel is pressed, and its contact corrected, in one place."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.cli import main
from ninedtact.design import read_design_file
from ninedtact.force.estimator_and_scale import NoForceEstimator, WrenchEstimate
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.indenter import Ball, FlatPunch, Indenter, LyingCylinder
from ninedtact.mechanics.pose import Pose
from ninedtact.reading import Reading
from ninedtact.simulation.press import Press
from ninedtact.simulation.press_sequence import ObjectTrajectory, PressSequence
from ninedtact.simulation.simulated_sources import NO_FORCE_TORQUE_ERRORS, SimulatedCamera, SimulatedForceTorque
from ninedtact.simulation.trajectory import PRESS_SOLVER_SETTINGS, ScriptedPress, Trajectory, TrajectorySegment
from ninedtact.simulation.twin import LOAD_TOLERANCE, Twin, twin_from_design
from ninedtact_train.batched.executor import BatchExecutor
from ninedtact_train.batched.session_requests import Device, RenderRequest, SimulatedSetup, StepRequest
from ninedtact_train.population.sensor_population import (
    MechanicsShares,
    SampledSensor,
    rectified_renderer,
    sample_sensor,
)
from ninedtact_train.workflows.dataset_evaluation import calibrate_on_simulated_loads

BALL, AT = Ball(4.0), Pose(0.6, -0.4, 0.45)
KINDS = {
    "yielding base": MechanicsShares(0, 0),
    "linear gel": MechanicsShares(0, 1),
    "rigid base": MechanicsShares(1, 0),
}


@pytest.fixture(scope="module", params=KINDS)
def sensor(request: pytest.FixtureRequest) -> SampledSensor:
    return sample_sensor(3, kinds=KINDS[request.param])


@pytest.fixture(scope="module")
def twin(sensor: SampledSensor) -> Twin:
    return sensor.twin(0.3)


@pytest.fixture(scope="module")
def pressed(twin: Twin) -> Press:
    """The press that all others must equal."""
    return twin.press(None, BALL, AT)


def resting(pose: Pose, indenter: Indenter = BALL) -> ObjectTrajectory:
    return ObjectTrajectory(indenter, Trajectory(pose, (TrajectorySegment(pose, 1.0),)))


def test_a_demo_shows_and_measures_it(twin: Twin, pressed: Press) -> None:
    stage = PressSequence(twin, [resting(AT)], real_time=False)
    with SimulatedCamera(stage) as camera, SimulatedForceTorque(stage, 30.0, NO_FORCE_TORQUE_ERRORS) as sensor:
        assert np.array_equal(camera.read().image, twin.renderer(pressed.corrected, 0))
        assert sensor.read().about(np.zeros(3)).six == pytest.approx(pressed.wrench.six)
    on_page = stage.press_at(stage.clock.start_ns)
    assert on_page is not None and np.array_equal(on_page.corrected.height_mm, pressed.corrected.height_mm)


def test_a_scripted_press_is_it(twin: Twin, pressed: Press) -> None:
    contact = ScriptedPress(AT.depth_mm, at_mm=(AT.x_mm, AT.y_mm)).simulate(twin, BALL, None)
    assert np.array_equal(contact.height_mm, pressed.corrected.height_mm)
    assert contact.wrench().six == pytest.approx(pressed.wrench.six)


@pytest.mark.parametrize("finite_strain", [0.0, 1.0])
def test_the_command_writes_it(finite_strain: float, tmp_path: Path) -> None:
    design = tmp_path / "design.toml"
    design.write_text(f"[gel]\nfinite_strain = {finite_strain}\n")
    words = f"simulate press --object ball:4 --depth-mm {AT.depth_mm} --at-mm {AT.x_mm} {AT.y_mm} --json"
    assert main([*words.split(), "--design", str(design), "--out", str(tmp_path / "out")]) == 0
    twin = replace(twin_from_design(read_design_file(design)), solver_settings=PRESS_SOLVER_SETTINGS)
    press = twin.press(None, BALL, AT)
    assert (press.corrected is press.solved) == (finite_strain == 0)
    assert np.array_equal(cv2.imread(str(tmp_path / "out/image.png")), twin.renderer(press.corrected, 1))
    written = json.loads((tmp_path / "out/wrench.json").read_text())["wrench"]
    assert [*written["force_n"], *written["torque_nm"]] == pytest.approx(press.wrench.six)


@pytest.mark.parametrize("device", ["cpu", "torch-cpu"])
def test_a_data_set_holds_it(sensor: SampledSensor, twin: Twin, pressed: Press, device: str) -> None:
    setup = SimulatedSetup(sensor, twin, rectified_renderer(sensor, (120, 90)))
    other = StepRequest(setup, None, LyingCylinder(3.0, 8.0), Pose(-1.0, 0.5, 0.4))
    requests = [StepRequest(setup, None, BALL, AT), other]
    if device == "cpu":
        one, beside = (request.respond() for request in requests)
        image = RenderRequest(setup, one.corrected).respond()
    else:
        executor = BatchExecutor({3: setup}, Device(device), 4, print)
        one, beside = executor.execute(requests)
        (image,) = executor.execute([RenderRequest(setup, one.corrected)])
    assert np.asarray(one.corrected.height_mm) == pytest.approx(pressed.corrected.height_mm, abs=2e-5)
    assert one.wrench.six == pytest.approx(pressed.wrench.six, rel=1e-4, abs=1e-5)
    assert image == pytest.approx(setup.renderer.brightness_factor(pressed.corrected), abs=4e-3)
    assert beside.wrench.six == pytest.approx(
        twin.press(None, other.indenter, other.pose).wrench.six, rel=1e-3, abs=1e-4
    )


def test_a_press_in_mujoco_is_it(twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mujoco = pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    from ninedtact.interop.mujoco import TactileSensor
    from ninedtact_train.environments.mujoco_batch import TactileSensorBatch

    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where it runs
    gel = '<geom name="gel" type="box" pos="0 0 -0.0025" size="0.01475 0.01125 0.0025" solref="0.01 1"/>'
    ball = f'<geom type="sphere" size="{BALL.radius_mm / 1e3}" mass="0.02"/>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="sensor">{gel}</body>
        <body pos="0 0 0.004"><joint type="slide" axis="0 0 1" damping="5"/>{ball}</body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qfrc_applied[:] = -3.0
    mujoco.mj_step(model, data, 200)
    sensor = TactileSensor(model, data, "sensor", twin, twin.pitch_mm)
    (batched,) = TactileSensorBatch([(model, data)], "sensor", twin, pitch_mm=twin.pitch_mm).step()
    for reading in (sensor.step(), batched):
        contact = reading.contact
        assert contact is not None
        load_n, pose = -reading.scene_wrench.force_n[2], contact.pose
        same = replace(twin, friction=float(contact.friction)).press(
            None, BALL, Pose(pose.x_mm, pose.y_mm, 0.3), load_n
        )
        assert reading.wrench.force_n[2] == pytest.approx(-load_n, rel=LOAD_TOLERANCE)
        assert contact.height_mm == pytest.approx(same.corrected.height_mm, abs=1.5e-3)
        assert reading.wrench.six == pytest.approx(same.wrench.six, rel=LOAD_TOLERANCE, abs=0.01)
        image, other = (twin.renderer.render_without_noise(one) for one in (contact, same.corrected))
        assert image == pytest.approx(other, abs=0.3), "grey levels"


class _ImageKeeper(NoForceEstimator):
    """An estimator that keeps the images that it is shown."""

    def __init__(self) -> None:
        self.images: list[np.ndarray] = []

    def estimate(self, reading: Reading) -> WrenchEstimate:
        self.images.append(reading.frame.image)
        return super().estimate(reading)


def test_a_force_calibration_shows_it(sensor: SampledSensor, twin: Twin, twin_sensor: SensorFolder) -> None:
    keeper = _ImageKeeper()
    assert calibrate_on_simulated_loads(keeper, sensor, twin_sensor.shape) is keeper, "it detects no contact"
    press = twin.press(None, Ball(5.0), Pose(0.0, 0.0, 0.8), 1.0)
    assert np.array_equal(keeper.images[0], twin.renderer(press.corrected, 0))
    assert press.load_n == pytest.approx(1.0, rel=2 * LOAD_TOLERANCE)


def mixed_indenters() -> Iterator[tuple[Indenter, Pose]]:
    yield Ball(4.0), Pose(0.5, 0.0, 1.2)
    yield FlatPunch(3.0), Pose(-1.0, 0.5, 0.6)
    yield Ball(6.0), Pose(0.0, -0.5, 0.8)


@pytest.mark.parametrize("like", ["numpy", "torch"])
def test_a_batch_of_presses_is_each_alone(twin: Twin, like: str) -> None:
    """By depth, and to loads that need a search of their own each."""
    zero = np.zeros((), np.float32) if like == "numpy" else torch.zeros(())
    twin = replace(twin, solver_settings=SolverSettings(tolerance=1e-3))
    batched = replace(twin, like=zero)
    poses = [Pose(0.5, 0.0, 0.5), Pose(-1.0, 0.5, 0.3), Pose(0.0, 0.0, 0.2)]
    for loads in (None, [2.0, 6.0, 0.5]):
        batch = batched.press(None, BALL, Pose.stack(poses), None if loads is None else np.array(loads))
        for index, one in enumerate(batch.unstack([BALL] * len(poses))):
            alone = twin.press(None, BALL, poses[index], None if loads is None else loads[index])
            assert one.wrench.six == pytest.approx(alone.wrench.six, rel=2e-3, abs=1e-3)
            assert np.asarray(one.corrected.height_mm) == pytest.approx(alone.corrected.height_mm, abs=2e-4)
            if loads is not None and twin.gel.finite_strain:
                assert one.load_n == pytest.approx(loads[index], rel=LOAD_TOLERANCE)


def test_a_correction_of_different_objects_is_that_of_each(twin: Twin) -> None:
    each = [twin.press(None, indenter, pose).solved for indenter, pose in mixed_indenters()]
    corrected = correct_for_finite_strain(Contact.stack(each)).unstack()
    for contact, found in zip(each, corrected, strict=True):
        alone = correct_for_finite_strain(contact)
        assert found.height_mm == pytest.approx(alone.height_mm, abs=1e-6)
        assert found.wrench().six == pytest.approx(alone.wrench().six, rel=1e-5, abs=1e-6)

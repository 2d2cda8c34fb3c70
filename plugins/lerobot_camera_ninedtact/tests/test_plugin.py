"""The plugin in the real LeRobot: it is found, its cameras serve images, and its wrenches end up in a recorded data set."""

import subprocess
import sys
import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.robots.config import RobotConfig
from lerobot.robots.robot import Robot
from lerobot.scripts import lerobot_record
from lerobot.teleoperators.config import TeleoperatorConfig
from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import lerobot_camera_ninedtact
import ninedtact
from lerobot_camera_ninedtact import cameras, sensor_stream, wrench_robot
from lerobot_camera_ninedtact.tracking_features import TRACKING_NAMES, UNKNOWN

JOINT = "joint.pos"


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait longer than a person would: the machine may be busy."""
    for module, name in ((wrench_robot, "MAX_AGE_S"), (wrench_robot, "FIRST_READING_S"), (cameras, "FIRST_READING_S")):
        monkeypatch.setattr(module, name, 60.0)
    monkeypatch.setattr(cameras, "READ_TIMEOUT_S", 60.0)


def test_lerobot_finds_the_plugin_by_its_name() -> None:
    # A process of its own, in which nothing has imported the plugin; its torchvision need not load.
    program = """
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.cameras.configs import CameraConfig
assert "ninedtact_height" not in CameraConfig.get_known_choices()
register_third_party_plugins()
from lerobot.robots.config import RobotConfig
assert {"ninedtact_height", "ninedtact_rectified"} <= set(CameraConfig.get_known_choices())
assert "ninedtact_wrench" in RobotConfig.get_known_choices()
"""
    shim = (Path(__file__).parent / "conftest.py").read_text()
    subprocess.run([sys.executable, "-c", shim + program], check=True, timeout=300)


def test_cameras_of_one_sensor_show_the_same_readings_over_one_connection(sensor_folder: str) -> None:
    known = CameraConfig.get_known_choices()
    configs = {
        "height": known["ninedtact_height"](sensor_folder=sensor_folder, source="sim"),
        "grey": known["ninedtact_rectified"](sensor_folder=sensor_folder, source="sim", width=92, height=69, fps=30),
    }
    made = make_cameras_from_configs(configs)
    height, grey = made["height"], made["grey"]
    with pytest.raises(DeviceNotConnectedError, match="not connected"):
        height.read()
    height.connect()
    grey.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        grey.connect()
    assert len(sensor_stream._streams) == 1
    (stream,) = sensor_stream._streams.values()
    assert (height.width, height.height) == stream.latest.reading.height.z_mm.shape[::-1]
    first = height.read()
    assert first.shape == (height.height, height.width, 3) and first.dtype == np.uint8
    assert grey.async_read(60_000).shape == (69, 92, 3)
    deadline = time.monotonic() + 60
    while height.read().min() > 150 and time.monotonic() < deadline:  # until something presses half a mm in
        pass
    image, reading = height.read_latest(), stream.latest.reading
    while not np.array_equal(image, height._to_lerobot(stream.latest)):
        image, reading = height.read_latest(), stream.latest.reading
    seen = np.where(reading.height.in_view, reading.height.z_mm, 0.0)
    levels = np.clip((seen + 3) * 255 / 4, 0, 255)
    assert np.abs(image[..., 0] - levels).max() <= 0.51 and levels.min() < 160
    one = height.async_read(60_000)
    one[:] = 0
    assert height.read_latest().any()
    height.disconnect()
    assert grey.read().any() and len(sensor_stream._streams) == 1
    grey.disconnect()
    assert not sensor_stream._streams and not stream._thread.is_alive() and not grey.is_connected


def test_what_cannot_be_opened_is_refused_in_one_sentence(sensor_folder: str, tmp_path: Path) -> None:
    plugin = lerobot_camera_ninedtact
    absent = plugin.NinedtactHeightCamera(plugin.NinedtactHeightCameraConfig(sensor_folder=str(tmp_path / "none")))
    with pytest.raises(ConnectionError, match="expected"):
        absent.connect()
    lost = plugin.NinedtactHeightCameraConfig(sensor_folder=sensor_folder, source=str(tmp_path / "none.mp4"))
    with pytest.raises(ConnectionError, match="expected"):
        plugin.NinedtactHeightCamera(lost).connect()
    assert not sensor_stream._streams
    with pytest.raises(ValueError, match="expected lowest_mm < 0 < highest_mm, got 1 and 2"):
        plugin.NinedtactHeightCameraConfig(sensor_folder="x", lowest_mm=1, highest_mm=2)
    with pytest.raises(ValueError, match="width and height, got 10 and None"):
        plugin.NinedtactRectifiedCameraConfig(sensor_folder="x", width=10)
    with pytest.raises(ValueError, match="at least one sensor"):
        plugin.NinedtactWrenchRobotConfig(arm={"type": "one_joint"})
    with pytest.raises(ValueError, match="the robot that moves, got"):
        plugin.NinedtactWrenchRobotConfig(arm={}, sensors={"finger": plugin.WrenchSensor(sensor_folder="x")})


@RobotConfig.register_subclass("one_joint")
@dataclass(kw_only=True)
class OneJointConfig(RobotConfig):
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class OneJoint(Robot):
    """A joint that is where it was sent, with the cameras of its configuration."""

    config_class, name = OneJointConfig, "one_joint"
    is_calibrated = True
    action_features = {JOINT: float}  # noqa: RUF012

    def __init__(self, config: OneJointConfig) -> None:
        super().__init__(config)
        self.cameras, self.at, self.is_connected_ = make_cameras_from_configs(config.cameras), 0.0, False

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        return {JOINT: float} | {name: (one.height, one.width, 3) for name, one in self.cameras.items()}

    @property
    def is_connected(self) -> bool:
        return self.is_connected_

    def connect(self, calibrate: bool = True) -> None:
        for camera in self.cameras.values():
            camera.connect()
        self.is_connected_ = True

    def calibrate(self) -> None: ...
    def configure(self) -> None: ...

    def get_observation(self) -> dict[str, Any]:
        return {JOINT: self.at} | {name: camera.async_read(60_000) for name, camera in self.cameras.items()}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        self.at = action[JOINT]
        return action

    def disconnect(self) -> None:
        for camera in self.cameras.values():
            camera.disconnect()
        self.is_connected_ = False


@TeleoperatorConfig.register_subclass("ramp")
@dataclass(kw_only=True)
class RampConfig(TeleoperatorConfig): ...


class Ramp(Teleoperator):
    """Asks the joint to move on by 0.1 each time."""

    config_class, name = RampConfig, "ramp"
    is_connected = is_calibrated = True
    action_features, feedback_features = {JOINT: float}, {}
    asked = 0.0

    def connect(self, calibrate: bool = True) -> None: ...
    def calibrate(self) -> None: ...
    def configure(self) -> None: ...
    def send_feedback(self, feedback: dict[str, Any]) -> None: ...
    def disconnect(self) -> None: ...

    def get_action(self) -> dict[str, float]:
        self.asked += 0.1
        return {JOINT: self.asked}


def test_a_data_set_recorded_by_lerobot_holds_images_and_wrenches(
    sensor_folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[ninedtact.Reading] = []
    original = sensor_stream.SensorStream.wait_for

    def remembered(self: Any, *arguments: Any) -> Any:
        found = original(self, *arguments)
        seen.append(found.reading)
        return found

    monkeypatch.setattr(sensor_stream.SensorStream, "wait_for", remembered)
    camera = f"{{type: ninedtact_height, sensor_folder: {sensor_folder}, source: sim, width: 96, height: 72, fps: 30}}"
    arguments = [
        "--robot.type=ninedtact_wrench",
        "--robot.id=tactile",
        f"--robot.calibration_dir={tmp_path / 'calibration'}",
        f"--robot.sensors={{finger: {{sensor_folder: {sensor_folder}, source: sim, tracking: true}}}}",
        f"--robot.arm={{type: one_joint, calibration_dir: {tmp_path / 'calibration'}, cameras: {{finger: {camera}}}}}",
        "--teleop.type=ramp",
        "--dataset.repo_id=local/press",
        f"--dataset.root={tmp_path / 'set'}",
        "--dataset.single_task=press",
        "--dataset.fps=10",
        "--dataset.episode_time_s=10",
        "--dataset.reset_time_s=0",
        "--dataset.num_episodes=1",
        "--dataset.vcodec=h264",
        "--dataset.push_to_hub=false",
        "--play_sounds=false",
    ]
    monkeypatch.setattr(sys, "argv", ["lerobot-record", *arguments])
    lerobot_record.main()
    recorded = LeRobotDataset("local/press", root=tmp_path / "set")
    names = recorded.meta.features["observation.state"]["names"]
    assert names == [JOINT, *(f"finger.{part}" for part in ("fx", "fy", "fz", "tx", "ty", "tz", *TRACKING_NAMES))]
    rows = recorded.hf_dataset.with_format("numpy")  # without decoding the video, for which torchvision would be needed
    assert len(rows) > 5
    wrenches = np.array([row["observation.state"][1:7] for row in rows])
    tracking = dict(zip(TRACKING_NAMES, np.array([row["observation.state"][7:] for row in rows]).T, strict=True))
    touches = tracking["contacts"] > 0
    assert touches.any() and not touches.all() and (tracking["sticking_share"][~touches] == UNKNOWN).all()
    assert np.abs(wrenches[~touches]).max() < np.abs(wrenches[touches]).max()
    known = np.array([reading.wrench.six for reading in seen if reading.wrench is not None], np.float32)
    assert all((known == wrench).all(axis=1).any() for wrench in wrenches)
    assert wrenches[:, 2].min() < -0.5  # the twin is pressed
    pressed, free = wrenches[:, 2].argmin(), wrenches[:, 2].argmax()
    video = cv2.VideoCapture(str(recorded.root / recorded.meta.get_video_file_path(0, "observation.images.finger")))
    images = [image for found, image in iter(video.read, (False, None))]
    assert len(images) == len(rows) and images[0].shape == (72, 96, 3)
    assert images[pressed].min() < images[free].min() - 20
    np.testing.assert_allclose(
        [np.ravel(row["action"])[0] for row in rows], 0.1 * np.arange(1, len(rows) + 1), atol=1e-4
    )

"""A robot that wraps another and adds the wrenches of its tactile sensors to the state."""

import logging
import time
from functools import cached_property
from typing import Any

from lerobot.robots.robot import Robot
from lerobot.robots.utils import make_robot_from_config
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_camera_ninedtact.configuration import NinedtactWrenchRobotConfig
from lerobot_camera_ninedtact.sensor_stream import FIRST_READING_S, SensorStream, connect_stream, release_stream
from lerobot_camera_ninedtact.tracking_features import TRACKING_NAMES, tracking_values

MAX_AGE_S = 0.5
"""Age from which a wrench is no longer that of the present observation."""
_AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
_logger = logging.getLogger(__name__)


class NinedtactWrenchRobot(Robot):
    """A robot with the features `NAME.fx` … `NAME.tz` of every sensor: what the object applies to the skin, N and N·m; with
    `tracking` those of `TRACKING_NAMES`, too."""

    config_class = NinedtactWrenchRobotConfig
    name = "ninedtact_wrench"

    def __init__(self, config: NinedtactWrenchRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.arm: Robot = make_robot_from_config(config.arm_config)
        self._streams: dict[str, SensorStream] = {}
        self._warnings: dict[str, tuple[Any, ...]] = {}

    @property
    def cameras(self) -> dict[str, Any]:
        """The cameras of the arm, which LeRobot counts."""
        return getattr(self.arm, "cameras", {})

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """The features of the arm, and those of each sensor."""
        of_sensors = {
            f"{name}.{part}": float
            for name, one in self.config.sensors.items()
            for part in (*_AXES, *(TRACKING_NAMES if one.tracking else ()))
        }
        return {**self.arm.observation_features, **of_sensors}

    @property
    def action_features(self) -> dict[str, Any]:
        """The actions of the arm."""
        return self.arm.action_features

    @property
    def is_connected(self) -> bool:
        """Whether the arm and all sensors are connected."""
        return bool(self._streams) and self.arm.is_connected

    def connect(self, calibrate: bool = True) -> None:
        """Open the sensors, which take their reference images, then the arm; all or nothing. Raises `ConnectionError`."""
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        try:
            for name, one in self.config.sensors.items():
                self._streams[name] = connect_stream(
                    one.sensor_folder, one.source, force=one.force, tracking=one.tracking
                )
                self._streams[name].wait_for(
                    lambda newest, tracking=one.tracking: (
                        newest.reading.wrench is not None and (newest.tracked is not None or not tracking)
                    ),
                    FIRST_READING_S,
                )
            self.arm.connect(calibrate)
        except BaseException:
            self._release_sensors()
            raise

    @property
    def is_calibrated(self) -> bool:
        """Whether the arm is calibrated."""
        return self.arm.is_calibrated

    def calibrate(self) -> None:
        """Calibrate the arm."""
        self.arm.calibrate()

    def configure(self) -> None:
        """Configure the arm."""
        self.arm.configure()

    def get_observation(self) -> dict[str, Any]:
        """Return the arm's observation with the newest wrenches; raises `TimeoutError` where a sensor has none of late."""
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected. Run `.connect()` first.")
        observation = dict(self.arm.get_observation())
        for name, stream in self._streams.items():
            since_s = time.monotonic() - MAX_AGE_S
            newest = stream.wait_for(lambda one, since_s=since_s: one.arrived_s >= since_s, MAX_AGE_S)
            reading, tracked = newest.reading, newest.tracked
            if reading.warnings != self._warnings.get(name, ()):
                self._warnings[name] = reading.warnings
                _logger.warning(
                    "%s: %s", name, ", ".join(one.value for one in reading.warnings) or "no warning any more"
                )
            observation |= {f"{name}.{axis}": float(part) for axis, part in zip(_AXES, reading.wrench.six, strict=True)}
            if self.config.sensors[name].tracking and tracked is not None:
                values = zip(TRACKING_NAMES, tracking_values(tracked), strict=True)
                observation |= {f"{name}.{part}": value for part, value in values}
        return observation

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Pass an action to the arm, and return what it sent."""
        return self.arm.send_action(action)

    def disconnect(self) -> None:
        """Disconnect the arm and give the sensors back."""
        if not self._streams:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        self._release_sensors()
        self.arm.disconnect()

    def _release_sensors(self) -> None:
        for stream in self._streams.values():
            release_stream(stream)
        self._streams = {}

"""Options of the cameras and of the robot, by which LeRobot's command line and its data sets name them."""

from dataclasses import dataclass, field
from typing import Any

import draccus
from lerobot.cameras.configs import CameraConfig
from lerobot.robots.config import RobotConfig


@dataclass(kw_only=True)
class NinedtactCameraConfig(CameraConfig):
    """What both types of camera have: a calibrated sensor, and where its images come from.

    `width` and `height` resize the images; `fps` is set on a camera of this computer.
    """

    sensor_folder: str
    """Folder that `ninedtact calibrate` wrote."""
    source: str = "0"
    """Camera ("0", "usb:1-2"), stream, recording, or "sim" for the sensor's twin."""

    def __post_init__(self) -> None:
        if (self.width is None) != (self.height is None):
            raise ValueError(f"expected width and height, got {self.width} and {self.height}; give both, or neither")


@CameraConfig.register_subclass("ninedtact_rectified")
@dataclass(kw_only=True)
class NinedtactRectifiedCameraConfig(NinedtactCameraConfig):
    """The grey image on the skin's own grid, without lens distortion."""


@CameraConfig.register_subclass("ninedtact_height")
@dataclass(kw_only=True)
class NinedtactHeightCameraConfig(NinedtactCameraConfig):
    """The height of the skin as a grey image."""

    lowest_mm: float = -3.0
    """Height that is black."""
    highest_mm: float = 1.0
    """Height that is white."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.lowest_mm < 0 < self.highest_mm:
            raise ValueError(
                f"expected lowest_mm < 0 < highest_mm, got {self.lowest_mm:g} and {self.highest_mm:g}; heights are negative "
                "where the skin is pressed in"
            )


@dataclass(kw_only=True)
class WrenchSensor:
    """A sensor whose wrench becomes part of the state."""

    sensor_folder: str
    """Folder that `ninedtact calibrate` wrote."""
    source: str = "0"
    """Camera ("0", "usb:1-2"), stream, recording, or "sim" for the sensor's twin."""
    force: str = "physics"
    """Estimator: physics, or a force model (.onnx)."""
    tracking: bool = False
    """Add contacts, motion of the object and slip."""


@RobotConfig.register_subclass("ninedtact_wrench")
@dataclass(kw_only=True)
class NinedtactWrenchRobotConfig(RobotConfig):
    """Another robot with the wrenches of sensors beside its state."""

    arm: dict[str, Any]
    """Options of the robot that moves, with its `type`. They are a mapping, because LeRobot's parser lists all robots for every
    field that is a robot, and would never end with a robot inside itself."""
    sensors: dict[str, WrenchSensor] = field(default_factory=dict)
    """The sensors by the name that begins their features."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if "type" not in self.arm or self.arm["type"] == "ninedtact_wrench":
            raise ValueError(
                f"expected arm={{type: ROBOT, …}} with the robot that moves, got {self.arm}; name its type"
            )
        if not self.sensors:
            raise ValueError(
                "expected at least one sensor, got none; give sensors={NAME: {sensor_folder: …, source: …}}"
            )

    @property
    def arm_config(self) -> RobotConfig:
        """The configuration of the robot that moves; raises what draccus raises for options that it does not have."""
        return draccus.decode(RobotConfig, dict(self.arm))

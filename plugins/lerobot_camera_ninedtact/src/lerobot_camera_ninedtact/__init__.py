"""9DTact tactile sensors in LeRobot: cameras for rectified images and heights, and wrenches as features of a robot.

LeRobot imports this package because its distribution's name begins with `lerobot_camera_`, and finds each device's class here by
the name of its configuration without `Config`.
"""

from lerobot_camera_ninedtact.cameras import NinedtactHeightCamera, NinedtactRectifiedCamera
from lerobot_camera_ninedtact.configuration import (
    NinedtactHeightCameraConfig,
    NinedtactRectifiedCameraConfig,
    NinedtactWrenchRobotConfig,
    WrenchSensor,
)
from lerobot_camera_ninedtact.wrench_robot import NinedtactWrenchRobot

__all__ = [
    "NinedtactHeightCamera",
    "NinedtactHeightCameraConfig",
    "NinedtactRectifiedCamera",
    "NinedtactRectifiedCameraConfig",
    "NinedtactWrenchRobot",
    "NinedtactWrenchRobotConfig",
    "WrenchSensor",
]

"""Launch file for ROS 2: `ros2 launch examples/ros2/ninedtact.launch.py source:=0 sensor:=my_sensor`.

Untried: there was no ROS here.
"""

import sys

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description() -> LaunchDescription:
    """Start `ninedtact ros2` on one sensor."""
    names = {"source": "0", "sensor": "my_sensor", "force": "physics"}
    arguments = [DeclareLaunchArgument(name, default_value=value) for name, value in names.items()]
    options = [part for name in names for part in (f"--{name}", LaunchConfiguration(name))]
    return LaunchDescription([*arguments, ExecuteProcess(cmd=[sys.executable, "-m", "ninedtact", "ros2", *options])])

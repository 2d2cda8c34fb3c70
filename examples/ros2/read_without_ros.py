"""Read heights of `ninedtact ros2 --source sim` and send a command, with Cyclone DDS alone.

pip install 'cyclonedds>=11,<12' numpy; ROS need not be installed.
"""

from dataclasses import dataclass

import numpy as np
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    """std_msgs/String, field by field as in its .msg file."""

    data: str


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """builtin_interfaces/Time."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """std_msgs/Header."""

    stamp: Time
    frame_id: str


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    """sensor_msgs/Image."""

    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


participant = DomainParticipant(0)
reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
heights = DataReader(participant, Topic(participant, "rt/twin/height", Image), qos=reliable)
statuses = DataReader(participant, Topic(participant, "rt/twin/status", String), qos=reliable)
commands = DataWriter(participant, Topic(participant, "rt/twin/command", String), qos=reliable)

image = heights.read_one(timeout=duration(seconds=10))
z_m = np.array(image.data, np.uint8).view(np.float32).reshape(image.height, image.width)
print(image.header.frame_id, z_m.shape, "lowest point:", np.nanmin(z_m), "m")

commands.write(String("take_reference"))
for status in statuses.take_iter(timeout=duration(seconds=10)):
    if '"command"' in status.data:
        print(status.data)
        break

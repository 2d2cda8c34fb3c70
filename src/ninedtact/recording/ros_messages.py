"""The nouns of an episode as ROS 2 messages, and back; rosbags knows their types and their encoding (CDR).

All wrenches are about the skin's centre (frame `skin`); heights are mm, 32FC1. What ROS 2 has no type for is `Pair` and `Event`:
their definitions ride along in the file, so that readers which never heard of them show their fields.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ninedtact.quantities import Wrench

OWN_TYPES = {
    "ninedtact_msgs/msg/Pair": """
std_msgs/Header header         # stamp of its image in /camera/image_raw
uint32 image                 # sequence number of that image
uint32 untouched               # sequence number of its reference in /skin/untouched
string object
string contact
string kind
geometry_msgs/Wrench wrench    # object on skin, about the skin's centre, tare taken off
""",
    "ninedtact_msgs/msg/Event": """
std_msgs/Header header
string kind
string subject
string words
""",
}
NS_PER_S = 1_000_000_000


class Topic(StrEnum):
    """What an episode may hold."""

    IMAGES = "/camera/image_raw"
    UNTOUCHED = "/skin/untouched"
    """Images of the untouched skin; those of one tare share a sequence number."""
    MEASURED = "/wrench/measured"
    """As the force/torque sensor told, nothing taken off."""
    ESTIMATED = "/wrench/estimated"
    HEIGHTS = "/skin/height_mm"
    PAIRS = "/pairs"
    EVENTS = "/events"


TYPES = {
    Topic.IMAGES: "sensor_msgs/msg/Image",
    Topic.UNTOUCHED: "sensor_msgs/msg/Image",
    Topic.MEASURED: "geometry_msgs/msg/WrenchStamped",
    Topic.ESTIMATED: "geometry_msgs/msg/WrenchStamped",
    Topic.HEIGHTS: "sensor_msgs/msg/Image",
    Topic.PAIRS: "ninedtact_msgs/msg/Pair",
    Topic.EVENTS: "ninedtact_msgs/msg/Event",
}


class EventKind(StrEnum):
    """What happened beside images and wrenches."""

    DROPPED = "dropped"
    """Subject: how many images were lost before this moment."""
    TARED = "tared"
    """Subject: sequence number of the reference that begins here; words: what was taken off, N and N·m."""
    OBJECT = "object"
    """Subject: the object from here on."""
    CONTACT_UNDONE = "contact undone"
    """Subject: a contact whose pairs are not to be used."""
    REMARK = "remark"
    """Words: what a person was told."""


@dataclass(frozen=True)
class RecordingEvent:
    """Something that happened."""

    stamp_ns: int
    kind: EventKind
    subject: str = ""
    words: str = ""


@dataclass(frozen=True)
class PairLabel:
    """That an image of the episode was saved as a pair."""

    stamp_ns: int
    image: int
    untouched: int
    object: str
    contact: str
    kind: str
    wrench: Wrench


@cache
def store() -> Any:
    """The types of ROS 2, and ours."""
    types = get_typestore(Stores.ROS2_JAZZY)
    for name, definition in OWN_TYPES.items():
        types.register(get_types_from_msg(definition, name))
    return types


def definition(name: str) -> bytes:
    """A type's definition with all that it consists of, as ROS 2 writes it."""
    text: str = store().generate_msgdef(name, ros_version=2)[0]
    return text.encode()


def camera_image_message(image: UInt8[Array, "rows cols 3"], wall_ns: int) -> bytes:
    """An image, BGR."""
    return image_message(Topic.IMAGES, header(wall_ns, "camera"), image.shape[:2], "bgr8", image)


def height_message(z_mm: Float32[Array, "rows cols"], wall_ns: int) -> bytes:
    """Heights in mm, NaN where nothing is seen."""
    return image_message(Topic.HEIGHTS, header(wall_ns, "skin"), z_mm.shape, "32FC1", z_mm.astype("<f4", copy=False))


def image_message(topic: Topic, heading: Any, shape: tuple[int, ...], encoding: str, values: Array) -> bytes:
    """Pixels row by row, little-endian."""
    rows, cols = shape
    data = np.ascontiguousarray(values).view(np.uint8).reshape(-1)
    about = {"height": rows, "width": cols, "encoding": encoding, "is_bigendian": 0, "step": data.size // rows}
    return encoded(topic, header=heading, data=data, **about)


def wrench_message(wrench: Wrench, wall_ns: int) -> bytes:
    """A wrench, about the skin's centre."""
    return encoded(Topic.MEASURED, header=header(wall_ns, "skin"), wrench=bare_wrench(wrench))


def pair_message(mark: PairLabel, wall_ns: int) -> bytes:
    """The mark of a pair."""
    numbers = {"image": mark.image, "untouched": mark.untouched}
    words = {"object": mark.object, "contact": mark.contact, "kind": mark.kind}
    return encoded(Topic.PAIRS, header=header(wall_ns, "skin"), **numbers, **words, wrench=bare_wrench(mark.wrench))


def event_message(event: RecordingEvent, wall_ns: int) -> bytes:
    """An event."""
    words = {"kind": event.kind.value, "subject": event.subject, "words": event.words}
    return encoded(Topic.EVENTS, header=header(wall_ns, ""), **words)


def image_of(data: bytes) -> UInt8[Array, "rows cols 3"]:
    """The image in a message, in its own memory."""
    message = decoded(Topic.IMAGES, data)
    return message.data.reshape(message.height, message.width, 3).copy()


def height_of(data: bytes) -> Float32[Array, "rows cols"]:
    """The heights in a message, mm."""
    message = decoded(Topic.HEIGHTS, data)
    return message.data.view("<f4").reshape(message.height, message.width).astype(np.float32)


def wrench_of(data: bytes, stamp_ns: int) -> Wrench:
    """The wrench in a message."""
    return with_stamp(decoded(Topic.MEASURED, data).wrench, stamp_ns)


def pair_of(data: bytes, stamp_ns: int) -> PairLabel:
    """The mark in a message."""
    told = decoded(Topic.PAIRS, data)
    wrench = with_stamp(told.wrench, stamp_ns)
    return PairLabel(stamp_ns, told.image, told.untouched, told.object, told.contact, told.kind, wrench)


def event_of(data: bytes, stamp_ns: int) -> RecordingEvent:
    """The event in a message."""
    told = decoded(Topic.EVENTS, data)
    return RecordingEvent(stamp_ns, EventKind(told.kind), told.subject, told.words)


def encoded(topic: Topic, **values: Any) -> bytes:
    """A message of the topic's type."""
    name = TYPES[topic]
    return bytes(store().serialize_cdr(store().types[name](**values), name))


def decoded(topic: Topic, data: bytes) -> Any:
    """A message of the topic's type, read."""
    return store().deserialize_cdr(data, TYPES[topic])


def header(wall_ns: int, frame: str) -> Any:
    """Stamp and frame."""
    types = store().types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(wall_ns, NS_PER_S))
    return types["std_msgs/msg/Header"](stamp, frame)


def bare_wrench(wrench: Wrench) -> Any:
    """The six numbers about the skin's centre, without a stamp."""
    types = store().types
    about_centre = wrench.about(np.zeros(3)) if wrench.about_mm.any() else wrench
    vector = types["geometry_msgs/msg/Vector3"]
    force, torque = vector(*about_centre.force_n.tolist()), vector(*about_centre.torque_nm.tolist())
    return types["geometry_msgs/msg/Wrench"](force, torque)


def with_stamp(told: Any, stamp_ns: int) -> Wrench:
    """Six numbers of a message as a wrench."""
    force, torque = ([part.x, part.y, part.z] for part in (told.force, told.torque))
    return Wrench(np.array(force), np.array(torque), stamp_ns=stamp_ns)

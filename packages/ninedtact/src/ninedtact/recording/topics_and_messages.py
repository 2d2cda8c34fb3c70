"""The topics of a recording, and the conversion between the package's quantities and ROS 2 messages.

All wrenches are about the skin centre (frame `skin`), N and N·m. Heights are in metres (REP 103), signed from the untouched
surface, 32FC1, NaN out of view; in memory they are mm. With 16SC1 they are multiples of the step that the metadata of the recording
states, and −32768 is out of view. `header.stamp` is the wall time of arrival. Labels and events are JSON in
std_msgs/String, so that no program needs a message definition of this package. rosbags provides types and encoding (CDR).
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from math import prod
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from msgspec import Meta, Struct
from numpy import ndarray as Array
from rosbags.typesys import Stores, get_typestore

from ninedtact.capture.strict_image_reading import decode_image_file, encode_png
from ninedtact.errors import printable_text
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate

_NS_PER_S = 1_000_000_000
_MM_PER_M = 1e3
_OUT_OF_VIEW_16_BIT = -(2**15)
_COMPRESSED = "/compressed"
"""End of the name of a topic whose images are compressed one by one, as in image_transport of ROS."""
_COMPRESSED_IMAGE_TYPE = "sensor_msgs/msg/CompressedImage"
Fields = TypeVar("Fields")
_StampNs = Annotated[int, Meta(ge=-(1 << 62), le=1 << 62)]
CAMERA_FRAME, SKIN_FRAME = "camera", "skin"
"""Frames of a recording, that of the camera image and that of heights and wrenches; among several sensors after their name."""
_CHANNELS = {
    "bgr8": (3, [0, 1, 2]),
    "8UC3": (3, [0, 1, 2]),
    "rgb8": (3, [2, 1, 0]),
    "bgra8": (4, [0, 1, 2]),
    "rgba8": (4, [2, 1, 0]),
    "mono8": (1, [0, 0, 0]),
    "8UC1": (1, [0, 0, 0]),
}
"""Encodings of sensor_msgs/Image: number of channels, and which of them are blue, green and red. Ours is the first; other drivers
have the others."""
_WARN = 1
"""Level of a diagnostic_msgs/DiagnosticStatus."""


def ros_name(sensor: str) -> str:
    """Return a sensor's name as ROS allows it: letters, digits and underscores, beginning with a letter."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", sensor)
    return name if name[:1].isalpha() else f"sensor_{name}"


class Topic(StrEnum):
    """The names of a recording's topics, without the sensor's name that precedes them."""

    IMAGES = "image_raw"
    REFERENCE = "reference"
    """Reference images (no contact); those of one tare share a sequence number."""
    MEASURED = "wrench_measured"
    """The wrench as the force/torque sensor reports it, without a tare."""
    ESTIMATED = "wrench_estimated"
    COVARIANCE = "wrench_covariance"
    """Covariance of the estimated wrench, 6 x 6 in the order of `Wrench.six`."""
    WARNINGS = "warnings"
    """Why heights or an estimate should not be trusted; nothing where there is no warning."""
    HEIGHTS = "height"
    LABELS = "labels"
    """Images that were saved as training pairs."""
    EVENTS = "events"
    REFERENCE_GREY = "reference_grey"
    """The rectified reference image (no contact) that heights are computed against from here on; from the live page."""
    SPANS = "spans"
    """Labels of stretches of time, each stamped with its beginning."""

    def path(self, sensor: str, images: str = "zstd") -> str:
        """Return the full name of the topic, such as `/my_sensor/image_raw`; ROS allows letters, digits and underscores.

        images: how the recording stores images (`metadata.ImageStorage`).
        """
        return f"/{ros_name(sensor)}/{self.value}" + (_COMPRESSED if self._is_compressed(images) else "")

    def message_type(self, images: str = "zstd") -> str:
        """Return the type of the topic's messages, where images are stored in this way."""
        return _COMPRESSED_IMAGE_TYPE if self._is_compressed(images) else MESSAGE_TYPES[self]

    def _is_compressed(self, images: str) -> bool:
        return images == "png" and self in (Topic.IMAGES, Topic.REFERENCE)


MESSAGE_TYPES = {
    Topic.IMAGES: "sensor_msgs/msg/Image",
    Topic.REFERENCE: "sensor_msgs/msg/Image",
    Topic.MEASURED: "geometry_msgs/msg/WrenchStamped",
    Topic.ESTIMATED: "geometry_msgs/msg/WrenchStamped",
    Topic.COVARIANCE: "std_msgs/msg/Float64MultiArray",
    Topic.WARNINGS: "diagnostic_msgs/msg/DiagnosticArray",
    Topic.HEIGHTS: "sensor_msgs/msg/Image",
    Topic.LABELS: "std_msgs/msg/String",
    Topic.EVENTS: "std_msgs/msg/String",
    Topic.REFERENCE_GREY: "sensor_msgs/msg/Image",
    Topic.SPANS: "std_msgs/msg/String",
}


ESTIMATE_TOPICS = frozenset({Topic.ESTIMATED, Topic.COVARIANCE, Topic.WARNINGS})
"""Topics of an estimated wrench."""


class RecordingEventKind(StrEnum):
    """What happened beside images and wrenches."""

    DROPPED = "dropped"
    """Subject: how many images were lost before this moment."""
    TARED = "tared"
    """Subject: sequence number of the reference that begins here; text: the wrench that was taken off, N and N·m."""
    OBJECT = "object"
    """Subject: the object from here on."""
    CONTACT_UNDONE = "contact undone"
    """Subject: a contact whose pairs are not to be used."""
    REMARK = "remark"
    """Text: a message that a person saw."""


@dataclass(frozen=True)
class RecordingEvent:
    """An event beside images and wrenches: lost images, a tare, a new object, an undone contact, a remark."""

    stamp_ns: int
    kind: RecordingEventKind
    subject: str = ""
    text: str = ""


@dataclass(frozen=True)
class LabelledSpan:
    """A stretch of time that a person has named."""

    begin_ns: _StampNs
    end_ns: _StampNs
    label: str


@dataclass(frozen=True)
class PairLabel:
    """The label of an image that was saved as a training pair."""

    stamp_ns: int
    """Stamp of the image."""
    image: int
    """Sequence number of the image."""
    reference: int
    """Sequence number of its reference images."""
    object: str
    contact: str
    kind: str
    wrench: Wrench
    """Object on skin, about the skin centre, tare taken off."""


@cache
def type_store() -> Any:
    """Return the message types of ROS 2 and their encoding (CDR)."""
    return get_typestore(Stores.ROS2_JAZZY)


def message_definition(name: str) -> bytes:
    """Return the definition of a message type with all types that it contains, as ROS 2 writes it."""
    text: str = type_store().generate_msgdef(name, ros_version=2)[0]
    return text.encode()


def encode_image(
    image: UInt8[Array, "rows cols 3"], wall_ns: int, images: str = "zstd", frame: str = CAMERA_FRAME
) -> bytes:
    """Return an image message, BGR: as it is, or as a PNG."""
    if images == "png":
        png = np.frombuffer(encode_png(image), np.uint8)
        message = type_store().types[_COMPRESSED_IMAGE_TYPE](
            header=message_header(wall_ns, frame), format="bgr8; png compressed bgr8", data=png
        )
        return bytes(type_store().serialize_cdr(message, _COMPRESSED_IMAGE_TYPE))
    return _encode_pixels(Topic.IMAGES, message_header(wall_ns, frame), image.shape[:2], "bgr8", image)


def encode_height(
    z_mm: Float32[Array, "rows cols"], wall_ns: int, step_mm: float = 0.0, frame: str = SKIN_FRAME
) -> bytes:
    """Return heights as an image message in metres, NaN out of view; with a step, as multiples of it in 16 bits."""
    if step_mm:
        steps = np.clip(np.rint(z_mm / step_mm), _OUT_OF_VIEW_16_BIT + 1, -_OUT_OF_VIEW_16_BIT - 1)
        whole = np.where(np.isnan(z_mm), _OUT_OF_VIEW_16_BIT, steps).astype("<i2")
        return _encode_pixels(Topic.HEIGHTS, message_header(wall_ns, frame), whole.shape, "16SC1", whole)
    z_m = (z_mm.astype(np.float64) / _MM_PER_M).astype("<f4")
    return _encode_pixels(Topic.HEIGHTS, message_header(wall_ns, frame), z_m.shape, "32FC1", z_m)


def encode_wrench(wrench: Wrench, wall_ns: int, frame: str = SKIN_FRAME) -> bytes:
    """Return a wrench message about the skin centre."""
    types = type_store().types
    about_centre = wrench.about_skin_centre()
    vector = types["geometry_msgs/msg/Vector3"]
    force, torque = vector(*about_centre.force_n.tolist()), vector(*about_centre.torque_nm.tolist())
    message = types["geometry_msgs/msg/Wrench"](force, torque)
    return _encode(Topic.MEASURED, header=message_header(wall_ns, frame), wrench=message)


def encode_covariance(covariance: Float64[Array, "6 6"]) -> bytes:
    """Return a covariance message in the order of `Wrench.six`, N and N·m."""
    types = type_store().types
    dimension = types["std_msgs/msg/MultiArrayDimension"]
    layout = types["std_msgs/msg/MultiArrayLayout"]([dimension("rows", 6, 36), dimension("columns", 6, 6)], 0)
    return _encode(Topic.COVARIANCE, layout=layout, data=np.ascontiguousarray(covariance, np.float64).reshape(-1))


def encode_warnings_as_diagnostics(
    warnings: Sequence[str], sensor: str, wall_ns: int, frame: str = SKIN_FRAME
) -> bytes:
    """Return a diagnostic message with one status of level WARN for each warning."""
    status = type_store().types["diagnostic_msgs/msg/DiagnosticStatus"]
    statuses = [
        status(level=_WARN, name=f"{sensor}: force", message=text, hardware_id=sensor, values=[]) for text in warnings
    ]
    return _encode(Topic.WARNINGS, header=message_header(wall_ns, frame), status=statuses)


def encode_pair_label(label: PairLabel) -> bytes:
    """Return the label of a pair as a JSON message."""
    wrench = {"force_n": label.wrench.force_n.tolist(), "torque_nm": label.wrench.torque_nm.tolist()}
    return _encode_json(Topic.LABELS, {**_without_stamp(label), "wrench": wrench})


def encode_labelled_span(span: LabelledSpan) -> bytes:
    """Return a labelled span as a JSON message."""
    return _encode_json(Topic.SPANS, vars(span))


def encode_reference_grey(grey: Float32[Array, "rows cols"], wall_ns: int, frame: str = SKIN_FRAME) -> bytes:
    """Return a message with the grey levels of a rectified reference image."""
    return _encode_pixels(Topic.REFERENCE_GREY, message_header(wall_ns, frame), grey.shape, "32FC1", grey.astype("<f4"))


def encode_event(event: RecordingEvent) -> bytes:
    """Return an event as a JSON message."""
    return _encode_json(Topic.EVENTS, _without_stamp(event))


def decode_image(data: bytes, images: str = "zstd", accepts_jpeg: bool = False) -> UInt8[Array, "rows cols 3"]:
    """Return the image of a message in its own memory; raises `FileFormatError` for what is no PNG of 8 bits, or JPEG."""
    if images == "png":
        file = type_store().deserialize_cdr(data, _COMPRESSED_IMAGE_TYPE).data
        return decode_image_file(file.tobytes(), "PNG", *["JPEG"] * accepts_jpeg)
    return _colour_pixels(_decode(Topic.IMAGES, data))


def decode_height_map(data: bytes, step_mm: float = 0.0) -> Float32[Array, "rows cols"]:
    """Return the heights of a message in mm, NaN out of view; step_mm: that of heights in 16 bits."""
    message = _decode(Topic.HEIGHTS, data)
    if step_mm and message.encoding == "16SC1":
        steps = _pixels(message, "16SC1", np.dtype("<i2"))
        return np.where(steps == _OUT_OF_VIEW_16_BIT, np.nan, steps * step_mm).astype(np.float32)
    z_m = _pixels(message, "32FC1", np.dtype("<f4"))
    return (z_m.astype(np.float64) * _MM_PER_M).astype(np.float32)


def decode_wrench(data: bytes, stamp_ns: int) -> Wrench:
    """Return the wrench of a message."""
    message = _decode(Topic.MEASURED, data).wrench
    force, torque = ([part.x, part.y, part.z] for part in (message.force, message.torque))
    return Wrench(np.array(force), np.array(torque), stamp_ns=stamp_ns)


def decode_estimate_warnings(data: bytes) -> list[str]:
    """Return the warnings of a message."""
    return [status.message for status in _decode(Topic.WARNINGS, data).status]


def decode_wrench_estimate(wrench: Wrench, covariance: bytes | None, warnings: bytes | None) -> WrenchEstimate:
    """Return the estimate of an image from its wrench and two messages; without a covariance, the variances are infinite."""
    matrix = np.diag(np.full(6, np.inf))
    if covariance is not None:
        matrix = np.array(_decode(Topic.COVARIANCE, covariance).data, float).reshape(6, 6)
    texts = [] if warnings is None else decode_estimate_warnings(warnings)
    known = tuple(EstimateWarning(text) for text in texts if text in set(EstimateWarning))
    return WrenchEstimate(wrench, matrix, bool(wrench.six.any()), known)


def decode_pair_label(data: bytes, stamp_ns: int) -> PairLabel:
    """Return the label of a message."""
    label = _decode_json(Topic.LABELS, data, _PairLabelFields)
    wrench = Wrench(np.array(label.wrench.force_n), np.array(label.wrench.torque_nm), stamp_ns=stamp_ns)
    return PairLabel(stamp_ns, label.image, label.reference, label.object, label.contact, label.kind, wrench)


def decode_labelled_span(data: bytes) -> LabelledSpan:
    """Return the labelled span of a message."""
    return _decode_json(Topic.SPANS, data, LabelledSpan)


def decode_label_spans(text: bytes) -> list[LabelledSpan]:
    """Return the labelled spans of an attachment; raises `ValueError` and `RecursionError`."""
    return msgspec.json.decode(text, type=list[LabelledSpan])


def decode_reference_grey(data: bytes) -> Float32[Array, "rows cols"]:
    """Return the grey levels of a rectified reference image."""
    return _pixels(_decode(Topic.REFERENCE_GREY, data), "32FC1", np.dtype("<f4")).copy()


def decode_event(data: bytes, stamp_ns: int) -> RecordingEvent:
    """Return the event of a message."""
    event = _decode_json(Topic.EVENTS, data, _EventFields)
    if event.kind is RecordingEventKind.DROPPED and not re.fullmatch("[0-9]{1,18}", event.subject):
        raise ValueError(f"{event.subject[:20]!r} images lost")
    return RecordingEvent(stamp_ns, event.kind, event.subject, event.text)


class _WrenchFields(Struct):
    force_n: tuple[float, float, float]
    torque_nm: tuple[float, float, float]


class _PairLabelFields(Struct):
    image: int
    reference: int
    object: str
    contact: str
    kind: str
    wrench: _WrenchFields


class _EventFields(Struct):
    kind: RecordingEventKind
    subject: str
    text: str


def encode_message(message_type: str, **fields: Any) -> bytes:
    """Return a message of any type of ROS 2 in CDR."""
    return bytes(type_store().serialize_cdr(type_store().types[message_type](**fields), message_type))


def _encode(topic: Topic, **values: Any) -> bytes:
    return encode_message(MESSAGE_TYPES[topic], **values)


def _decode(topic: Topic, data: bytes) -> Any:
    return type_store().deserialize_cdr(data, MESSAGE_TYPES[topic])


def _decode_json(topic: Topic, data: bytes, kind: type[Fields]) -> Fields:
    return msgspec.json.decode(_decode(topic, data).data, type=kind)


def _encode_json(topic: Topic, fields: dict[str, Any]) -> bytes:
    return _encode(topic, data=printable_text(json.dumps(fields, ensure_ascii=False)))


def _without_stamp(item: RecordingEvent | PairLabel) -> dict[str, Any]:
    return {name: value for name, value in vars(item).items() if name != "stamp_ns"}


def _encode_pixels(topic: Topic, header: Any, shape: tuple[int, ...], encoding: str, values: Array) -> bytes:
    rows, cols = shape
    data = np.ascontiguousarray(values).view(np.uint8).reshape(-1)
    layout = {"height": rows, "width": cols, "encoding": encoding, "is_bigendian": 0, "step": data.size // rows}
    return _encode(topic, header=header, data=data, **layout)


def _colour_pixels(message: Any) -> UInt8[Array, "rows cols 3"]:
    """Return the blue, green and red pixels of an image message; raises `ValueError` for another encoding or size, and none."""
    channels, order = _CHANNELS.get(message.encoding, (0, []))
    rows, used, step = message.height, message.width * channels, message.step
    if rows * used == 0 or step < used or message.data.nbytes != rows * step:
        known = ", ".join(_CHANNELS)
        raise ValueError(f"{message.data.nbytes} bytes of encoding {message.encoding[:20]!r}; {known} are read")
    pixels = message.data.reshape(rows, step)[:, :used].reshape(rows, message.width, channels)
    return np.ascontiguousarray(pixels[..., order])


def _pixels(message: Any, encoding: str, kind: np.dtype[Any]) -> Array:
    """Return the values of an image message of one channel; raises `ValueError` for another encoding or number of bytes."""
    shape = message.height, message.width
    if message.encoding != encoding or message.is_bigendian or message.data.nbytes != prod(shape) * kind.itemsize:
        raise ValueError(f"an image of {message.data.nbytes} bytes and encoding {message.encoding[:20]!r}")
    return message.data.view(kind).reshape(shape)


def message_header(wall_ns: int, frame: str) -> Any:
    """Return the header of a message: wall time, and the frame that its coordinates refer to."""
    types = type_store().types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(wall_ns, _NS_PER_S))
    return types["std_msgs/msg/Header"](stamp, frame)

"""A sensor in Foxglove: its readings as typed messages over Foxglove's WebSocket protocol, and the layout that shows them.

Topics, each after the sensor's name; stamps are the wall time of the image's arrival, lengths in 3D are metres:

    image, camera_info   CompressedImage (JPEG) and CameraCalibration        points    PointCloud: x, y, z, normals, intensity
    height               RawImage, 32FC1: height in mm, NaN out of view      warnings  Log, where the warnings have changed
    wrench, contact      JSON with a schema: wrench with errors; depth and area of the contact, warnings      /tf  FrameTransforms

foxglove-sdk gives the schemas and encodes the messages. Its WebSocket server lets every website on the computer connect, whatever
its `Origin`, so that the protocol is spoken here, on a server behind the guard of the live page (`studio.socket_guard`).
"""

import base64
import json
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from time import monotonic_ns
from typing import Annotated, Any, Literal

import cv2
import foxglove
import msgspec
import numpy as np
from foxglove import messages as fox
from jaxtyping import Float64
from numpy import ndarray as Array
from websockets.asyncio.server import ServerConnection
from websockets.typing import Subprotocol

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.interop.reading_broadcast import BroadcastServer, ReadingQueue, feed_until_closed, port_errors
from ninedtact.interop.ros2_topics_and_messages import POINT_FIELDS, SensorMessages
from ninedtact.reading import Reading
from ninedtact.recording.metadata import wall_time_ns
from ninedtact.studio.sensor_poller import SensorSnapshot
from ninedtact.studio.socket_guard import SocketGuard

SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
"""Names of the protocol: that of today's Foxglove, and that of programs made before, such as Lichtblick."""
FOXGLOVE_ORIGIN = "https://app.foxglove.dev"
"""The website of Foxglove, which may connect."""
_MESSAGE_DATA = 1
"""First byte of a binary message with data: then the client's subscription id, the time in ns and the message."""
_STATUS_WARNING = 1
_QUEUED_READINGS = 2
"""Readings that wait for one client at most: what is shown is new."""


class _Subscription(msgspec.Struct):
    id: Annotated[int, msgspec.Meta(ge=0, lt=2**32)]  # four bytes of a message
    channel: int = msgspec.field(name="channelId")


class _Subscribe(msgspec.Struct, tag="subscribe", tag_field="op"):
    subscriptions: list[_Subscription]


class _Unsubscribe(msgspec.Struct, tag="unsubscribe", tag_field="op"):
    subscriptions: list[int] = msgspec.field(name="subscriptionIds")


@dataclass(frozen=True)
class FoxgloveChannel:
    """A topic: its schema, and what encodes a reading for it, given the wall time in ns; nothing where it has no message."""

    topic: str
    schema: foxglove.Schema
    encode: Callable[[Reading, int], bytes | None]
    encoding: Literal["protobuf", "json"] = "protobuf"
    encode_status: Callable[[SensorSnapshot, int], bytes] | None = None
    """Encodes a status. A client then gets a message only where warnings or status are not those of its last one."""


class FoxgloveMessages:
    """Encodes a sensor's readings as Foxglove messages, a channel for each topic. points_every: every so many rows and columns."""

    def __init__(self, folder: SensorFolder, points_every: int = 3) -> None:
        self._ros = SensorMessages(folder, folder.id, points_every)
        self.name = self._ros.path("").strip("/")
        """The name of the sensor in topics and frames."""

    @cached_property
    def channels(self) -> tuple[FoxgloveChannel, ...]:
        """All topics, in the order in which the messages of a reading are sent."""
        path = self._ros.path
        return (
            FoxgloveChannel("/tf", fox.FrameTransforms.get_schema(), self._transforms),
            FoxgloveChannel(path("camera_info"), fox.CameraCalibration.get_schema(), self._camera_info),
            FoxgloveChannel(path("image"), fox.CompressedImage.get_schema(), self._image),
            FoxgloveChannel(path("height"), fox.RawImage.get_schema(), self._height),
            FoxgloveChannel(path("points"), fox.PointCloud.get_schema(), self._points),
            FoxgloveChannel(path("wrench"), _json_schema("ninedtact.Wrench", _WRENCH), self._wrench, "json"),
            FoxgloveChannel(path("contact"), _json_schema("ninedtact.Contact", _CONTACT), self._contact, "json"),
            FoxgloveChannel(path("warnings"), fox.Log.get_schema(), self._warnings, encode_status=self._status),
        )

    def _transforms(self, reading: Reading, wall_ns: int) -> bytes:
        transforms = [
            fox.FrameTransform(
                timestamp=_timestamp(wall_ns),
                parent_frame_id=self._ros.frame("skin"),
                child_frame_id=child.name,
                translation=fox.Vector3(z=child.z_m),
                rotation=fox.Quaternion(z=child.rotation_zw[0], w=child.rotation_zw[1]),
            )
            for child in self._ros.child_frames
        ]
        return fox.FrameTransforms(transforms=transforms).encode()

    def _camera_info(self, reading: Reading, wall_ns: int) -> bytes:
        camera, (rows, cols) = self._ros.camera, self._ros.camera.raw_shape
        return fox.CameraCalibration(
            timestamp=_timestamp(wall_ns),
            frame_id=self._ros.frame("camera_optical"),
            width=cols,
            height=rows,
            distortion_model="plumb_bob",
            D=list(camera.distortion),
            K=camera.matrix.ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=camera.projection.ravel().tolist(),
        ).encode()

    def _image(self, reading: Reading, wall_ns: int) -> bytes:
        jpeg = cv2.imencode(".jpg", reading.image)[1].tobytes()
        frame = self._ros.frame("camera_optical")
        return fox.CompressedImage(timestamp=_timestamp(wall_ns), frame_id=frame, data=jpeg, format="jpeg").encode()

    def _height(self, reading: Reading, wall_ns: int) -> bytes:
        z_mm = reading.height.visible_z_mm.astype("<f4")
        return fox.RawImage(
            timestamp=_timestamp(wall_ns),
            frame_id=self._ros.frame("skin"),
            width=z_mm.shape[1],
            height=z_mm.shape[0],
            encoding="32FC1",
            step=z_mm.strides[0],
            data=z_mm.tobytes(),
        ).encode()

    def _points(self, reading: Reading, wall_ns: int) -> bytes:
        values = self._ros.point_values(reading)
        field, number = fox.PackedElementField, fox.PackedElementFieldNumericType.Float32
        return fox.PointCloud(
            timestamp=_timestamp(wall_ns),
            frame_id=self._ros.frame("skin"),
            pose=fox.Pose(position=fox.Vector3(), orientation=fox.Quaternion(w=1.0)),
            point_stride=values.strides[0],
            fields=[field(name=name, offset=4 * at, type=number) for at, name in enumerate(POINT_FIELDS)],
            data=values.tobytes(),
        ).encode()

    def _wrench(self, reading: Reading, wall_ns: int) -> bytes | None:
        if reading.force is None:
            return None
        estimate = reading.force.about_skin_centre()
        six, std = estimate.wrench.six, estimate.std
        vectors = (six[:3], six[3:], std[:3], std[3:])
        named = {name: _vector(values) for name, values in zip(_WRENCH_VECTORS, vectors, strict=True)}
        return json.dumps({"timestamp": _sec_nsec(wall_ns), **named, "touching": bool(estimate.touching)}).encode()

    def _contact(self, reading: Reading, wall_ns: int) -> bytes:
        fields = {
            "timestamp": _sec_nsec(wall_ns),
            "max_indentation_mm": float(reading.max_indentation_mm),
            "contact_area_mm2": float(reading.contact_area_mm2),
            "warnings": list(reading.warnings),
        }
        return json.dumps(fields).encode()

    def _warnings(self, reading: Reading, wall_ns: int) -> bytes:
        return self._log("; ".join(reading.warnings), "no warnings", wall_ns)

    def _status(self, status: SensorSnapshot, wall_ns: int) -> bytes:
        return self._log(status.trouble_sentence, status.phase.value, wall_ns)

    def _log(self, warning: str, otherwise: str, wall_ns: int) -> bytes:
        """Return a warning, or for information what holds where there is none."""
        level = fox.LogLevel.Warning if warning else fox.LogLevel.Info
        stamp = _timestamp(wall_ns)
        return fox.Log(timestamp=stamp, level=level, message=warning or otherwise, name=self.name).encode()


class _Encoded:
    """A reading or a status on its way to the clients; each message is encoded once, when a client first wants it."""

    def __init__(self, source: Reading | SensorSnapshot, channels: Sequence[FoxgloveChannel]) -> None:
        self._source, self._channels = source, channels
        self._messages: dict[int, bytes | None] = {}
        stamp_ns, self.warnings = (
            (source.stamp_ns, tuple[str, ...](source.warnings))
            if isinstance(source, Reading)
            else (monotonic_ns(), (source.phase.value, source.trouble_sentence))
        )
        self.wall_ns = wall_time_ns(stamp_ns)

    def message(self, channel: int) -> bytes | None:
        """Return the message for a channel, by its number."""
        if channel not in self._messages:
            self._messages[channel] = self._encode(self._channels[channel])
        return self._messages[channel]

    def _encode(self, channel: FoxgloveChannel) -> bytes | None:
        if isinstance(self._source, Reading):
            return channel.encode(self._source, self.wall_ns)
        return None if channel.encode_status is None else channel.encode_status(self._source, self.wall_ns)


class FoxgloveServer(BroadcastServer[_Encoded]):
    """Serves a sensor to Foxglove in a thread of its own while it is open (`with`).

    host, allowed_origins: as for `SocketGuard.for_host`; `FOXGLOVE_ORIGIN` is allowed besides. Port 0 takes any free port.
    """

    def __init__(self, messages: FoxgloveMessages, host: str, port: int, allowed_origins: tuple[str, ...] = ()) -> None:
        self.guard = SocketGuard.for_host(host, (FOXGLOVE_ORIGIN, *allowed_origins))
        self.port = port
        """The port; that in use, once the server is open."""
        self._name, self._channels = messages.name, messages.channels
        super().__init__(partial(_Encoded, channels=self._channels), _QUEUED_READINGS)

    @property
    def address(self) -> str:
        """Address to open in Foxglove, with the token."""
        return self.guard.page_address(self.port).replace("http://", "ws://", 1)

    async def _listen(self) -> None:
        with port_errors(self.guard.host, self.port, "--port"):
            guarded = self.guard.serve(
                self._feed,
                self.guard.host,
                self.port,
                is_expected=_is_request,
                subprotocols=SUBPROTOCOLS,
                compression=None,  # compressing a megabyte takes longer than sending it
            )
            server = await self._servers.enter_async_context(guarded)
        self.port = next(iter(server.sockets)).getsockname()[1]

    async def _feed(self, connection: ServerConnection) -> None:
        """Announce the channels to a client, obey its subscriptions and send it what it subscribed to."""
        info = {"name": f"ninedtact {self._name}", "capabilities": [], "supportedEncodings": [], "metadata": {}}
        await connection.send(json.dumps({"op": "serverInfo", **info}))
        await connection.send(json.dumps({"op": "advertise", "channels": self._advertised()}))
        subscriptions: dict[int, int] = {}
        with self._queue() as queue:
            sending = self._send_readings(connection, subscriptions, queue)
            await feed_until_closed(connection, sending, self._obey(connection, subscriptions))

    def _advertised(self) -> list[dict[str, Any]]:
        """Return the channels as the protocol states them; binary schemas are base64."""
        return [
            {
                "id": number,
                "topic": channel.topic,
                "encoding": channel.encoding,
                "schemaName": channel.schema.name,
                "schemaEncoding": channel.schema.encoding,
                "schema": _schema_text(channel.schema),
            }
            for number, channel in enumerate(self._channels)
        ]

    async def _obey(self, connection: ServerConnection, subscriptions: dict[int, int]) -> None:
        """Follow the subscriptions of a client, and warn it of one to a channel that does not exist."""
        async for request in connection:
            match msgspec.json.decode(request, type=_Subscribe | _Unsubscribe):
                case _Subscribe(wanted):
                    known = range(len(self._channels))
                    subscriptions |= {one.id: one.channel for one in wanted if one.channel in known}
                    self._repeat_status()  # the first one came before there was a subscription
                    if unknown := [one.channel for one in wanted if one.id not in subscriptions]:
                        sentence = f"expected channels 0 to {len(self._channels) - 1}, got {unknown}; see 'advertise'"
                        status = {"op": "status", "level": _STATUS_WARNING, "message": sentence}
                        await connection.send(json.dumps(status))
                case _Unsubscribe(ended):
                    for one in ended:
                        subscriptions.pop(one, None)

    async def _send_readings(
        self, connection: ServerConnection, subscriptions: Mapping[int, int], queue: ReadingQueue[_Encoded]
    ) -> None:
        shown: dict[int, tuple[str, ...]] = {}
        async for reading, _ in queue.arrivals():
            for subscription, channel in sorted(subscriptions.items(), key=lambda pair: pair[1]):
                if self._channels[channel].encode_status and shown.get(subscription) == reading.warnings:
                    continue
                shown[subscription] = reading.warnings
                if (message := reading.message(channel)) is not None:
                    head = struct.pack("<BIQ", _MESSAGE_DATA, subscription, reading.wall_ns)
                    await connection.send(head + message)


def _is_request(message: str | bytes) -> bool:
    """Return whether a message of a client is one to which the server has something to do."""
    try:
        msgspec.json.decode(message, type=_Subscribe | _Unsubscribe)
    except (msgspec.DecodeError, UnicodeEncodeError):
        return False
    return isinstance(message, str)


_WRENCH_VECTORS = ("force_n", "torque_nm", "force_std_n", "torque_std_nm")
_STAMP_SCHEMA = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_VECTOR_SCHEMA = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_WRENCH = {
    "timestamp": _STAMP_SCHEMA,
    **dict.fromkeys(_WRENCH_VECTORS, _VECTOR_SCHEMA),
    "touching": {"type": "boolean"},
}
_CONTACT = {
    "timestamp": _STAMP_SCHEMA,
    "max_indentation_mm": {"type": "number"},
    "contact_area_mm2": {"type": "number"},
    "warnings": {"type": "array", "items": {"type": "string"}},
}


def _json_schema(name: str, properties: dict[str, Any]) -> foxglove.Schema:
    schema = {"title": name, "type": "object", "properties": properties}
    return foxglove.Schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())


def _schema_text(schema: foxglove.Schema) -> str:
    """Return a schema as the protocol wants it: as text, binary ones in base64."""
    return schema.data.decode() if schema.encoding == "jsonschema" else base64.b64encode(schema.data).decode()


def _vector(values: Float64[Array, "3"]) -> dict[str, float]:
    """Return the known ones of three values by axis; an error that is not stated is left out."""
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True) if np.isfinite(value)}


def _sec_nsec(wall_ns: int) -> dict[str, int]:
    sec, nsec = divmod(wall_ns, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _timestamp(wall_ns: int) -> fox.Timestamp:
    return fox.Timestamp(**_sec_nsec(wall_ns))


def foxglove_layout(sensor: str) -> dict[str, Any]:
    """Return the layout that Foxglove imports for a sensor, by its name in topics.

    It shows camera, height, points, wrench, errors and warnings at once.
    """
    panels: dict[str, dict[str, Any]] = {
        "Image!camera": {
            _TITLE: "Camera",
            "imageMode": {"imageTopic": f"/{sensor}/image", "calibrationTopic": f"/{sensor}/camera_info"},
        },
        "Image!height": {
            _TITLE: "Height (mm)",
            "imageMode": {"imageTopic": f"/{sensor}/height", "colorMode": "colormap", "colorMap": "turbo"}
            | _HEIGHTS_MM,
        },
        "3D!points": {
            _TITLE: "Surface",
            "followTf": f"{sensor}_skin",
            "cameraState": {"distance": 0.05, "phi": 55, "thetaOffset": 30, "fovy": 45, "near": 0.001, "far": 10},
            "topics": {
                f"/{sensor}/points": {"visible": True, "colorMode": "colormap", "colorMap": "turbo", "colorField": "z"}
            },
        },
        "Plot!wrench": _plot(sensor, "Wrench", force_n="F{} (N)", torque_nm="T{} (N·m)"),
        "Plot!errors": _plot(
            sensor, "Errors: one standard deviation", force_std_n="± F{} (N)", torque_std_nm="± T{} (N·m)"
        ),
        "RosOut!warnings": {_TITLE: "Warnings", "topicToRender": f"/{sensor}/warnings", "minLogLevel": 1},
    }
    images = _split("column", "Image!camera", "Image!height", 50)
    plots = _split("column", "Plot!wrench", _split("column", "Plot!errors", "RosOut!warnings", 65), 45)
    layout = _split("row", images, _split("row", "3D!points", plots, 50), 30)
    unused = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return {"configById": panels, "layout": layout, **unused}


_TITLE = "foxglovePanelTitle"
_HEIGHTS_MM = {"minValue": -2.0, "maxValue": 0.5}


def _plot(sensor: str, title: str, **labels: str) -> dict[str, Any]:
    """Return a plot of vectors of the wrench, each named with its label for one axis."""
    series = [
        {"value": f"/{sensor}/wrench.{name}.{axis}", "label": label.format(axis), "enabled": True}
        for name, label in labels.items()
        for axis in "xyz"
    ]
    return {_TITLE: title, "paths": series, "showLegend": True, "xAxisVal": "timestamp"}


def _split(direction: str, first: Any, second: Any, percent: int) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percent}

"""A sensor in Foxglove: the messages of recordings and ROS 2 on the server of foxglove-sdk, and the layout that shows them.

Topics, each after the sensor's name; stamps are the wall time of the image's arrival:

    image_raw/compressed, camera_info, height, points, /tf_static    as on ROS 2 (`ros2_topics_and_messages`), lengths in metres
    wrench, contact    JSON with a schema: wrench with errors; depth and area of the contact, warnings
    log                warnings and status where they change

The server of foxglove-sdk answers every website that is open in a browser on this computer. It listens where none finds it, and a
front before it passes on what the guard of the live page accepts (`live.socket_guard`).
"""

import json
from collections.abc import Callable
from time import monotonic_ns
from typing import Any

import foxglove
import numpy as np
from foxglove import messages as fox
from jaxtyping import Float64
from numpy import ndarray as Array
from websockets.asyncio.client import ClientConnection
from websockets.asyncio.server import ServerConnection
from websockets.typing import Subprotocol

from ninedtact.interop.ros2_topics_and_messages import (
    CAMERA_INFO,
    COMPRESSED,
    LIVE_TOPICS,
    POINTS,
    TF_STATIC,
    TF_TYPE,
    SensorMessages,
)
from ninedtact.interop.sensor_sharing import SensorMoment, ServerThread
from ninedtact.live.sensor_poller import SensorPhase
from ninedtact.live.socket_guard import SocketGuard, hidden_loopback_address, network_port_errors, relay
from ninedtact.reading import Reading
from ninedtact.recording.metadata import wall_time_ns
from ninedtact.recording.topics_and_messages import Topic, message_definition

SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
"""Names of the protocol: that of today's Foxglove, and that of programs made before, such as Lichtblick."""
FOXGLOVE_ORIGIN = "https://app.foxglove.dev"
"""The website of Foxglove, which may connect."""
WRENCH, CONTACT, LOG = "wrench", "contact", "log"
_ROS_TOPICS = (CAMERA_INFO, COMPRESSED, Topic.HEIGHTS.value, POINTS)
_WAITING_MESSAGES = 20
"""Messages that wait for one client at most, those of two readings: what is shown is new."""


class FoxgloveServer:
    """Serves a sensor to Foxglove while it is open (`with`); raises `DeviceError` for a port that is taken.

    host, allowed_origins: as for `SocketGuard.for_host`; `FOXGLOVE_ORIGIN` is allowed besides. Port 0 takes any free port.
    """

    def __init__(self, messages: SensorMessages, host: str, port: int, allowed_origins: tuple[str, ...] = ()) -> None:
        self.guard = SocketGuard.for_host(host, (FOXGLOVE_ORIGIN, *allowed_origins))
        self.port = port
        """The port; that in use, once the server is open."""
        self._messages, self._context = messages, foxglove.Context()
        self._json = {WRENCH: encode_wrench_with_errors, CONTACT: encode_contact}
        self._channels = {topic: self._channel(topic) for topic in (TF_STATIC, *_ROS_TOPICS, *self._json, LOG)}
        self._logged, self._log = ("", ""), b""
        """What was logged last, and its message."""

    def _channel(self, topic: str) -> foxglove.Channel:
        if topic in self._json:
            encoding, schema = "json", _json_schema(topic, _JSON_PROPERTIES[topic])
        elif topic == LOG:
            encoding, schema = "protobuf", fox.Log.get_schema()
        else:
            kind = TF_TYPE if topic == TF_STATIC else LIVE_TOPICS[topic][0]
            encoding, schema = "cdr", foxglove.Schema(name=kind, encoding="ros2msg", data=message_definition(kind))
        path = self._messages.path(topic)
        return foxglove.Channel(path, message_encoding=encoding, schema=schema, context=self._context)

    def __enter__(self) -> "FoxgloveServer":
        self._host = hidden_loopback_address()
        self._server = foxglove.start_server(
            name=f"ninedtact {self._messages.name}",
            host=self._host,
            port=0,
            context=self._context,
            server_listener=_NewSubscriptions(self._repeat_log),
            message_backlog_size=_WAITING_MESSAGES,
        )
        self._thread = ServerThread("foxglove front")
        try:
            self._thread.start(self._listen())
        except BaseException:
            self._server.stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.close()
        self._server.stop()

    async def _listen(self) -> None:
        with network_port_errors(self.guard.host, self.port, "readings"):
            guarded = self.guard.serve(
                self._connect,
                self.port,
                subprotocols=SUBPROTOCOLS,
                compression=None,  # which takes longer than sending
            )
            front = await self._thread.servers.enter_async_context(guarded)
        self.port = next(iter(front.sockets)).getsockname()[1]

    async def _connect(self, client: ServerConnection) -> None:
        async def pass_to_server(server: ClientConnection) -> None:
            async for message in client:
                if isinstance(message, str):
                    await server.send(message)

        await relay(client, f"ws://{self._host}:{self._server.port}", SUBPROTOCOLS[0], pass_to_server)

    def publish(self, moment: SensorMoment) -> None:
        """Send the new reading of a sensor, and log why there is none; a client that is too slow misses messages."""
        now = moment.snapshot
        if moment.has_changed and (now.phase is not SensorPhase.READING or now.trouble is not None):
            self._log_change(now.trouble_sentence, now.phase.value, wall_time_ns(monotonic_ns()))
        if moment.new_reading is not None:
            self.publish_reading(moment.new_reading)

    def publish_reading(self, reading: Reading) -> None:
        """Send a reading on all topics to which a client subscribes."""
        wall_ns = wall_time_ns(reading.stamp_ns)
        wanted = {topic for topic, channel in self._channels.items() if channel.has_sinks()}
        for topic, message in self._messages.encode(reading, wall_ns, wanted).items():
            self._channels[topic].log(message, log_time=wall_ns)
        if TF_STATIC in wanted:
            self._channels[TF_STATIC].log(self._messages.encode_static_transforms(wall_ns), log_time=wall_ns)
        for topic in wanted & self._json.keys():
            if (fields := self._json[topic](reading)) is not None:
                stamp = dict(zip(("sec", "nsec"), divmod(wall_ns, 1_000_000_000), strict=True))
                self._channels[topic].log({"timestamp": stamp, **fields}, log_time=wall_ns)
        self._log_change("; ".join(reading.warnings), "no warnings", wall_ns)

    def _log_change(self, warning: str, otherwise: str, wall_ns: int) -> None:
        """Log a warning, or for information what holds where there is none, unless it was logged last."""
        if self._logged != (warning, otherwise):
            level = fox.LogLevel.Warning if warning else fox.LogLevel.Info
            stamp, text = fox.Timestamp(*divmod(wall_ns, 1_000_000_000)), warning or otherwise
            self._log = fox.Log(timestamp=stamp, level=level, message=text, name=self._messages.name).encode()
            self._logged = warning, otherwise
            self._channels[LOG].log(self._log, log_time=wall_ns)

    def _repeat_log(self, path: str) -> None:
        """Log again what was logged last, for a client that subscribes to it."""
        if path == self._messages.path(LOG) and self._log:
            self._channels[LOG].log(self._log, log_time=wall_time_ns(monotonic_ns()))


class _NewSubscriptions(foxglove.websocket.ServerListener):  # type: ignore[misc]
    """Reports the topics to which clients subscribe; called in a thread of the server."""

    def __init__(self, on_topic: Callable[[str], None]) -> None:
        self._on_topic = on_topic

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Report a topic."""
        self._on_topic(channel.topic)


def encode_wrench_with_errors(reading: Reading) -> dict[str, Any] | None:
    """Return the estimated wrench about the skin centre with its errors, those that are stated; None where there is none."""
    if reading.force is None:
        return None
    estimate = reading.force.about_skin_centre()
    six, std = estimate.wrench.six, estimate.std
    vectors = zip(_WRENCH_VECTORS, (six[:3], six[3:], std[:3], std[3:]), strict=True)
    return {name: _vector(values) for name, values in vectors} | {"touching": bool(estimate.touching)}


def encode_contact(reading: Reading) -> dict[str, Any]:
    """Return depth and area of the contact, and the warnings."""
    return {
        "max_indentation_mm": float(reading.max_indentation_mm),
        "contact_area_mm2": float(reading.contact_area_mm2),
        "warnings": list(reading.warnings),
    }


_WRENCH_VECTORS = ("force_n", "torque_nm", "force_std_n", "torque_std_nm")
_VECTOR_SCHEMA = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_JSON_PROPERTIES: dict[str, dict[str, Any]] = {
    WRENCH: {**dict.fromkeys(_WRENCH_VECTORS, _VECTOR_SCHEMA), "touching": {"type": "boolean"}},
    CONTACT: {
        "max_indentation_mm": {"type": "number"},
        "contact_area_mm2": {"type": "number"},
        "warnings": {"type": "array", "items": {"type": "string"}},
    },
}


def _json_schema(topic: str, properties: dict[str, Any]) -> foxglove.Schema:
    name = f"ninedtact.{topic.capitalize()}"
    stamp = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
    schema = {"title": name, "type": "object", "properties": {"timestamp": stamp, **properties}}
    return foxglove.Schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())


def _vector(values: Float64[Array, "3"]) -> dict[str, float]:
    """Return the known ones of three values by axis; an error that is not stated is left out."""
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True) if np.isfinite(value)}


def foxglove_layout(sensor: str) -> dict[str, Any]:
    """Return the layout that Foxglove imports for a sensor, by its name in topics.

    It shows camera, height, points, wrench, errors and warnings at once.
    """
    panels: dict[str, dict[str, Any]] = {
        "Image!camera": {
            _TITLE: "Camera",
            "imageMode": {
                "imageTopic": f"/{sensor}/image_raw/compressed",
                "calibrationTopic": f"/{sensor}/camera_info",
            },
        },
        "Image!height": {
            _TITLE: "Height (m)",
            "imageMode": {"imageTopic": f"/{sensor}/height", "colorMode": "colormap", "colorMap": "turbo"} | _HEIGHTS_M,
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
        "RosOut!warnings": {_TITLE: "Warnings", "topicToRender": f"/{sensor}/log", "minLogLevel": 1},
    }
    images = _split("column", "Image!camera", "Image!height", 50)
    plots = _split("column", "Plot!wrench", _split("column", "Plot!errors", "RosOut!warnings", 65), 45)
    layout = _split("row", images, _split("row", "3D!points", plots, 50), 30)
    unused = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return {"configById": panels, "layout": layout, **unused}


_TITLE = "foxglovePanelTitle"
_HEIGHTS_M = {"minValue": -0.002, "maxValue": 0.0005}


def _plot(sensor: str, title: str, **labels: str) -> dict[str, Any]:
    series = [
        {"value": f"/{sensor}/wrench.{name}.{axis}", "label": label.format(axis), "enabled": True}
        for name, label in labels.items()
        for axis in "xyz"
    ]
    return {_TITLE: title, "paths": series, "showLegend": True, "xAxisVal": "timestamp"}


def _split(direction: str, first: Any, second: Any, percent: int) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percent}

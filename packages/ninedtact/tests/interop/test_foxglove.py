"""A sensor in Foxglove: a client of its protocol that decodes every topic by the advertised schema, and who may connect."""

import base64
import json
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from small_sensor import RAW_SHAPE, SkinCamera, image_folder, sensor_folder, sensor_on
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.cli import main
from ninedtact.errors import DeviceError
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.interop.ros2_topics_and_messages import POINT_FIELDS, SensorMessages
from ninedtact.interop.sensor_sharing import watch_sensor
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.topics_and_messages import Topic, decode_height_map, encode_height

pytestmark = pytest.mark.interop
pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory  # noqa: E402

from ninedtact.interop.foxglove import FOXGLOVE_ORIGIN, FoxgloveServer, foxglove_layout  # noqa: E402

PATIENCE_S = 60
PRESSED = 60


class Doubtful(ForceEstimator):
    """Always answers the same wrench, whose last error is unknown, with a warning."""

    name = "doubtful"

    def estimate(self, reading: Reading) -> WrenchEstimate:
        wrench = Wrench(np.array([0.0, 0.5, -2.0]), np.zeros(3), stamp_ns=reading.stamp_ns)
        errors = np.diag([1.0, 1.0, 4.0, 1.0, 1.0, np.inf])
        return WrenchEstimate(wrench, errors, touching=True, warnings=(EstimateWarning.OUT_OF_RANGE,))

    def forget(self) -> None:
        pass


@pytest.fixture
def messages(tmp_path: Path) -> SensorMessages:
    return SensorMessages(load_sensor(sensor_folder(tmp_path / "small")), "small", points_every=2)


@contextmanager
def served(messages: SensorMessages, camera: SkinCamera) -> Iterator[FoxgloveServer]:
    sensor, over = sensor_on(camera), Event()
    sensor.estimator = Doubtful()

    def run() -> None:
        for moment in watch_sensor(sensor, over.is_set):
            server.publish(moment)

    with FoxgloveServer(messages, "127.0.0.1", 0) as server:
        thread = Thread(target=run)
        thread.start()
        try:
            yield server
        finally:
            over.set()
            thread.join()


def client(port: int, **options: Any) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{port}/", subprotocols=["foxglove.sdk.v1"], **options)


def announced_channels(connection: ClientConnection) -> dict[str, dict[str, Any]]:
    """What a server says first of its channels, by topic."""
    info, advertised = (json.loads(connection.recv(PATIENCE_S)) for _ in range(2))
    assert (info["name"], info["capabilities"], advertised["op"]) == ("ninedtact small", [], "advertise")
    return {one["topic"]: one for one in advertised["channels"]}


def subscribe(connection: ClientConnection, numbers: dict[int, int]) -> None:
    wanted = [{"id": own, "channelId": channel} for own, channel in numbers.items()]
    connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


def parts(data: Any) -> tuple[int, int, bytes]:
    """The subscription, the time and the message of a frame of the protocol."""
    assert isinstance(data, bytes)
    operation, subscription, stamp_ns = struct.unpack_from("<BIQ", data)
    assert operation == 1 and stamp_ns > 1e18
    return subscription, stamp_ns, data[13:]


def decode(channel: dict[str, Any], data: bytes) -> Any:
    """The message, by nothing but the schema that was advertised."""
    if channel["schemaEncoding"] == "jsonschema":
        return json.loads(data)
    if channel["schemaEncoding"] == "ros2msg":
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
        return store.deserialize_cdr(data, channel["schemaName"])
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"])).FromString(data)


def received(port: int) -> dict[str, tuple[bytes, Any]]:
    with client(port) as connection:
        assert "Sec-WebSocket-Extensions" not in connection.response.headers  # compression would take too long
        channels = announced_channels(connection)
        topics = {100 + one["id"]: topic for topic, one in channels.items()}
        subscribe(connection, {100 + one["id"]: one["id"] for one in channels.values()})
        found: dict[str, tuple[bytes, Any]] = {}
        while len(found) < len(channels) or found["/small/log"][1].level != 3:  # first the status, then the warning
            subscription, _, data = parts(connection.recv(PATIENCE_S))
            found[topics[subscription]] = data, decode(channels[topics[subscription]], data)
    return found


def test_a_client_decodes_every_topic_by_the_advertised_schema(messages: SensorMessages) -> None:
    with served(messages, SkinCamera()) as server:
        found = {topic: message for topic, (_, message) in received(server.port).items()}
    image = found["/small/image_raw/compressed"]
    assert "jpeg" in image.format and image.header.frame_id == "small_camera_optical"
    assert cv2.imdecode(image.data, cv2.IMREAD_COLOR).shape == (*RAW_SHAPE, 3)
    calibration = found["/small/camera_info"]
    assert (calibration.width, calibration.height, calibration.distortion_model) == (64, 48, "plumb_bob")
    cloud = found["/small/points"]
    assert tuple(field.name for field in cloud.fields) == POINT_FIELDS and cloud.width == 15 * 20
    surface = foxglove_layout("small")["configById"]["3D!points"]
    assert cloud.header.frame_id == surface["followTf"]
    assert surface["topics"]["/small/points"]["colorField"] in POINT_FIELDS
    wrench, contact, log = (found[f"/small/{name}"] for name in ("wrench", "contact", "log"))
    assert wrench["force_n"] == {"x": 0, "y": 0.5, "z": -2} and wrench["force_std_n"] == {"x": 1, "y": 1, "z": 2}
    assert wrench["torque_std_nm"] == {"x": 1, "y": 1} and wrench["touching"] is True
    assert contact["warnings"] == ["out of range"] and contact["max_indentation_mm"] == 0
    assert (log.message, log.name, log.level) == ("out of range", "small", 3)
    assert {one.child_frame_id for one in found["/tf_static"].transforms} == {"small_camera_optical", "small_gel"}


def test_heights_are_the_metres_of_recordings_and_ros_2(messages: SensorMessages) -> None:
    camera = SkinCamera()
    with sensor_on(camera) as sensor:
        camera.level = PRESSED
        while (reading := sensor.read()).max_indentation_mm == 0:
            pass
    with FoxgloveServer(messages, "127.0.0.1", 0) as server, client(server.port) as connection:
        subscribe(connection, {1: announced_channels(connection)["/small/height"]["id"]})
        data = None
        while data is None:
            server.publish_reading(reading)
            with suppress(TimeoutError):
                _, wall_ns, data = parts(connection.recv(0.2))
    assert data == messages.encode(reading, wall_ns, {Topic.HEIGHTS})[Topic.HEIGHTS]
    assert data == encode_height(reading.height.visible_z_mm, wall_ns, frame="small_skin")
    assert decode_height_map(data).min() == pytest.approx(-reading.max_indentation_mm, rel=1e-6)


def test_a_client_that_does_not_read_delays_nobody(messages: SensorMessages) -> None:
    with served(messages, SkinCamera()) as server, client(server.port) as slow, client(server.port) as quick:
        for connection in (slow, quick):
            channels = announced_channels(connection)
            subscribe(connection, {one["id"]: one["id"] for one in channels.values()})
        began = time.monotonic()
        assert all(quick.recv(PATIENCE_S) for _ in range(2000))
        assert time.monotonic() - began < PATIENCE_S


def test_other_websites_are_refused_and_a_network_needs_the_token(messages: SensorMessages) -> None:
    with FoxgloveServer(messages, "0.0.0.0", 0) as server:
        with pytest.raises(InvalidStatus, match="404"), client(server.port):
            pass
        with connect(f"ws://127.0.0.1:{server.port}/{server.guard.token}/", subprotocols=["foxglove.sdk.v1"]) as known:
            announced_channels(known)
    with FoxgloveServer(messages, "127.0.0.1", 0) as server:
        for origin in ("http://evil.example", "file://"):
            with pytest.raises(InvalidStatus, match="403"), client(server.port, origin=origin):
                pass
        with client(server.port, origin=FOXGLOVE_ORIGIN) as connection:
            announced_channels(connection)
        with pytest.raises(DeviceError, match=f"expected port {server.port} .* --port"):
            FoxgloveServer(messages, "127.0.0.1", server.port).__enter__()
    with (
        FoxgloveServer(messages, "127.0.0.1", 0, ("file://",)) as server,
        client(server.port, origin="file://") as connection,
    ):
        announced_channels(connection)


PANEL_SCHEMAS = {
    "Image": {"sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"},
    "3D": {"sensor_msgs/msg/PointCloud2"},
    "Plot": {"ninedtact.Wrench"},
    "RosOut": {"foxglove.Log"},
}
"""The schemas of the topics that each kind of panel shows, by Foxglove's documentation of the panel."""


def paths_in(config: Any) -> set[str]:
    if isinstance(config, str):
        return {config} if config.startswith("/") else set()
    parts = [*config, *config.values()] if isinstance(config, dict) else config if isinstance(config, list) else []
    return {path for part in parts for path in paths_in(part)}


def require_shown(layout: dict[str, Any], channels: dict[str, dict[str, Any]]) -> None:
    """Every topic and field of a layout is announced, with a schema that its panel shows."""
    paths = {kind: paths_in(config) for kind, config in layout["configById"].items()}
    assert [len(found) for found in paths.values()] == [2, 1, 1, 6, 6, 1]
    for kind, found in paths.items():
        for path in found:
            topic, *fields = path.split(".")
            channel = channels[topic]
            assert channel["schemaName"] in PANEL_SCHEMAS[kind.partition("!")[0]], path
            schema = json.loads(channel["schema"]) if fields else {}
            for field in fields:
                schema = schema["properties"][field]


def test_the_command_serves_and_writes_the_layout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, layout = sensor_folder(tmp_path / "small"), tmp_path / "layout.json"
    images = image_folder(tmp_path / "images", *[100] * 12)
    words = ["--source", str(images), "--sensor", str(folder), "--force", "none", "--loop", "--port", "0"]
    words += ["--layout", str(layout)]
    start = [sys.executable, "-m", "ninedtact", "foxglove", *words]
    with subprocess.Popen(start, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        address = running.stdout.readline().partition("ws://")[2].partition(";")[0].rstrip("/")
        with client(int(address.rpartition(":")[2])) as connection:
            channels = announced_channels(connection)
            require_shown(json.loads(layout.read_text()), channels)
            subscribe(connection, {1: channels["/small/contact"]["id"]})
            assert json.loads(parts(connection.recv(PATIENCE_S))[2])["max_indentation_mm"] == 0
        running.send_signal(signal.SIGINT)
        assert running.wait(PATIENCE_S) == 0
    assert json.loads(layout.read_text()) == foxglove_layout("small")
    assert main(["foxglove", *words]) == 1
    assert "expected --layout to name a new file" in capsys.readouterr().err
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["foxglove", *words[:-3], str(taken.getsockname()[1])]) == 1
    assert "in use" in capsys.readouterr().err

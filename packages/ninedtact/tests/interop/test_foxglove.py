"""A sensor in Foxglove: a client of its protocol that decodes by the advertised schemas, and the SDK's own server as a peer."""

import base64
import json
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread
from typing import Any

import cv2
import numpy as np
import pytest
from small_sensor import DARK, RAW_SHAPE, UNTOUCHED, SkinCamera, sensor_folder, sensor_on, skin, wait_until
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.cli import main
from ninedtact.force.estimator_interface import ForceEstimator
from ninedtact.interop.reading_broadcast import StreamPortRefused, publish_readings
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate
from ninedtact.reading import Reading

pytestmark = pytest.mark.interop
foxglove = pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory  # noqa: E402

from ninedtact.interop.foxglove import (  # noqa: E402
    FOXGLOVE_ORIGIN,
    FoxgloveMessages,
    FoxgloveServer,
    foxglove_layout,
)

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
def messages(tmp_path: Path) -> FoxgloveMessages:
    return FoxgloveMessages(load_sensor(sensor_folder(tmp_path / "small")), points_every=2)


@pytest.fixture
def served(messages: FoxgloveMessages) -> Iterator[FoxgloveServer]:
    with FoxgloveServer(messages, "127.0.0.1", 0) as server:
        over, camera = Event(), SkinCamera()
        sensor = sensor_on(camera)
        sensor.estimator = Doubtful()
        thread = Thread(target=publish_readings, args=(server.publish, sensor, over.is_set))
        thread.start()
        wait_until(lambda: sensor.current_depth_reader is not None and server._status is None)
        yield server
        over.set()
        thread.join()


def client(port: int, **options: Any) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{port}/", subprotocols=options.pop("subprotocols", ["foxglove.sdk.v1"]), **options)


def announced(connection: ClientConnection) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """What a server says first: about itself, and its channels."""
    info, advertised = (json.loads(connection.recv(PATIENCE_S)) for _ in range(2))
    assert (info["op"], advertised["op"]) == ("serverInfo", "advertise")
    return info, advertised["channels"]


def subscribe(connection: ClientConnection, numbers: dict[int, int]) -> None:
    wanted = [{"id": own, "channelId": channel} for own, channel in numbers.items()]
    connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


def parts(data: Any) -> tuple[int, int, int, bytes]:
    assert isinstance(data, bytes)
    return (*struct.unpack_from("<BIQ", data), data[13:])


def decode(channel: dict[str, Any], data: bytes) -> Any:
    """The message, by nothing but the schema that was advertised."""
    if channel["encoding"] == "json":
        assert channel["schemaEncoding"] == "jsonschema"
        return json.loads(data)
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"])).FromString(data)


def received(port: int, **options: Any) -> dict[str, Any]:
    """One message of every topic, decoded."""
    with client(port, **options) as connection:
        assert "Sec-WebSocket-Extensions" not in connection.response.headers  # compression would take too long
        channels = {one["id"]: one for one in announced(connection)[1]}
        subscribe(connection, {100 + number: number for number in channels})
        found: dict[str, Any] = {}
        while len(found) < len(channels):
            operation, subscription, stamp_ns, data = parts(connection.recv(PATIENCE_S))
            channel = channels[subscription - 100]
            assert operation == 1 and stamp_ns > 1e18
            found[channel["topic"]] = decode(channel, data)
    return found


def reading_of(level: int) -> Reading:
    """A reading of skin pressed in at this level."""
    camera = SkinCamera()
    with sensor_on(camera) as sensor:
        sensor.read()
        camera.level = level
        while (reading := sensor.read()).max_indentation_mm == 0:
            pass
    return reading


def test_a_client_decodes_every_topic_by_the_advertised_schema(served: FoxgloveServer) -> None:
    found = received(served.port)
    assert (image := found["/small/image"]).format == "jpeg" and image.frame_id == "small_camera_optical"
    assert cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR).shape == (*RAW_SHAPE, 3)
    calibration = found["/small/camera_info"]
    assert (calibration.width, calibration.height, calibration.distortion_model) == (64, 48, "plumb_bob")
    heights = found["/small/height"]
    z_mm = np.frombuffer(heights.data, "<f4").reshape(heights.height, heights.width)
    assert (heights.encoding, heights.step) == ("32FC1", 4 * heights.width) and z_mm.shape == (30, 40)
    cloud = found["/small/points"]
    assert [(field.name, field.offset) for field in cloud.fields] == [
        (name, 4 * at) for at, name in enumerate(("x", "y", "z", "normal_x", "normal_y", "normal_z", "intensity"))
    ]
    points = np.frombuffer(cloud.data, "<f4").reshape(-1, cloud.point_stride // 4)
    surface = foxglove_layout("small")["configById"]["3D!points"]
    assert cloud.frame_id == surface["followTf"]
    assert surface["topics"]["/small/points"]["colorField"] in [field.name for field in cloud.fields]
    assert len(points) == 15 * 20 and np.abs(points[:, :2]).max() < 0.02
    np.testing.assert_allclose(np.linalg.norm(points[:, 3:6], axis=1), 1, atol=1e-5)
    wrench = found["/small/wrench"]
    assert wrench["force_n"] == {"x": 0, "y": 0.5, "z": -2} and wrench["force_std_n"] == {"x": 1, "y": 1, "z": 2}
    assert wrench["torque_std_nm"] == {"x": 1, "y": 1} and wrench["touching"] is True
    assert (
        found["/small/contact"]["warnings"] == ["out of range"] and found["/small/contact"]["max_indentation_mm"] == 0
    )
    assert (found["/small/warnings"].message, found["/small/warnings"].name) == ("out of range", "small")
    frames = {transform.child_frame_id: transform for transform in found["/tf"].transforms}
    assert set(frames) == {"small_camera_optical", "small_gel"}
    assert frames["small_camera_optical"].translation.z < frames["small_gel"].translation.z < 0


def test_heights_and_points_are_those_of_the_reading(messages: FoxgloveMessages) -> None:
    reading = reading_of(PRESSED)
    for channel in messages.channels:
        data = channel.encode(reading, 5_000_000_007)
        if channel.topic == "/small/height":
            np.testing.assert_array_equal(
                np.frombuffer(foxglove_decode(channel, data).data, "<f4"), reading.height.z_mm.ravel()
            )
        elif channel.topic == "/small/points":
            cloud = foxglove_decode(channel, data)
            lowest_m = np.frombuffer(cloud.data, "<f4").reshape(-1, 7)[:, 2].min()
            assert lowest_m == pytest.approx(reading.height.z_mm[::2, ::2].min() / 1000)
            assert (cloud.timestamp.seconds, cloud.timestamp.nanos) == (5, 7)
        elif channel.topic == "/small/wrench":
            assert data is None


def foxglove_decode(channel: Any, data: bytes | None) -> Any:
    schema = base64.b64encode(channel.schema.data).decode()
    assert data is not None
    return decode({"encoding": "protobuf", "schema": schema, "schemaName": channel.schema.name}, data)


def test_the_sdks_own_server_announces_and_sends_the_same(messages: FoxgloveMessages) -> None:
    reading, context = reading_of(PRESSED), foxglove.Context()
    peers = [
        foxglove.Channel(one.topic, message_encoding=one.encoding, schema=one.schema, context=context)
        for one in messages.channels
    ]
    peer = foxglove.start_server(name="ninedtact small", port=0, context=context)
    answers = []
    try:
        with FoxgloveServer(messages, "127.0.0.1", 0) as own:
            for port in (peer.port, own.port):
                with client(port) as connection:
                    info, channels = announced(connection)
                    numbers = {one["topic"]: one["id"] for one in channels}
                    subscribe(connection, {7: numbers["/small/height"]})
                    stamp_ns = 0
                    while not stamp_ns:
                        if port == own.port:
                            own.publish(reading)
                        else:
                            number = [one.topic for one in messages.channels].index("/small/height")
                            peers[number].log(messages.channels[number].encode(reading, 5), log_time=5)
                        try:
                            operation, subscription, stamp_ns, data = parts(connection.recv(0.2))
                        except TimeoutError:
                            continue
                    described = {one.pop("topic"): one for one in channels if one.pop("id") is not None}
                    shown = decode(described["/small/height"], data)
                    shown.ClearField("timestamp")
                    shown = shown.SerializeToString()
                    answers.append((info["name"], info["capabilities"], described, operation, subscription, shown))
    finally:
        peer.stop()
    assert answers[0] == answers[1]


def test_a_client_stops_getting_what_it_ends_and_is_warned_of_what_does_not_exist(served: FoxgloveServer) -> None:
    with client(served.port, subprotocols=["foxglove.websocket.v1"]) as connection:
        numbers = {one["topic"]: one["id"] for one in announced(connection)[1]}
        connection.send(json.dumps({"op": "getParameters", "parameterNames": []}))  # not served, not answered
        for impossible in (-1, 2**32):  # a message has four bytes for it
            subscribe(connection, {impossible: numbers["/tf"]})
        subscribe(connection, {1: 99})
        status = json.loads(connection.recv(PATIENCE_S))
        assert status["op"] == "status" and "expected channels 0 to 7, got [99]" in status["message"]
        subscribe(connection, {1: numbers["/tf"], 2: numbers["/small/contact"], 3: numbers["/small/warnings"]})
        while parts(connection.recv(PATIENCE_S))[1] != 1:
            pass
        connection.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [1]}))
        seen = [parts(connection.recv(PATIENCE_S))[1] for _ in range(60)]
    assert 1 not in seen[-20:] and seen.count(2) > 20 and seen.count(3) <= 1  # warnings only where they change


def test_a_client_is_warned_of_a_refused_reference(messages: FoxgloveMessages) -> None:
    with FoxgloveServer(messages, "127.0.0.1", 0) as server:
        over, camera, sentences = Event(), SkinCamera(), list[str]()
        camera.level = DARK
        arguments = (server.publish, sensor_on(camera), over.is_set, sentences.append)
        thread = Thread(target=publish_readings, args=arguments)
        thread.start()
        try:
            wait_until(lambda: len(sentences) > 0)  # whoever comes later is warned too
            with client(server.port) as connection:
                channel = next(one for one in announced(connection)[1] if one["topic"] == "/small/warnings")
                subscribe(connection, {1: channel["id"]})
                texts = (decode(channel, parts(connection.recv(PATIENCE_S))[3]) for _ in range(100))
                refused = next(texts)
                assert "expected a lit reference image" in refused.message and refused.level == 3
                camera.level = UNTOUCHED
                assert next(log for log in texts if log.message == "reading").level == 2
        finally:
            over.set()
            thread.join()


def test_other_websites_are_refused_and_a_network_needs_the_token(messages: FoxgloveMessages) -> None:
    with (
        FoxgloveServer(messages, "0.0.0.0", 0) as server,
        pytest.raises(InvalidStatus, match="404"),
        client(server.port),
    ):
        pass
    with FoxgloveServer(messages, "127.0.0.1", 0) as server:
        for origin in ("http://evil.example", "file://"):
            with pytest.raises(InvalidStatus, match="403"), client(server.port, origin=origin):
                pass
        with client(server.port, origin=FOXGLOVE_ORIGIN) as connection:
            announced(connection)
        with pytest.raises(StreamPortRefused, match=f"expected port {server.port} .* --port"):
            FoxgloveServer(messages, "127.0.0.1", server.port).__enter__()
    with (
        FoxgloveServer(messages, "127.0.0.1", 0, ("file://",)) as server,
        client(server.port, origin="file://") as connection,
    ):
        announced(connection)


def test_the_layout_has_settings_that_the_sdk_names(messages: FoxgloveMessages) -> None:
    from foxglove import layouts

    layout = foxglove_layout(messages.name)
    shown = layout["configById"]

    def leaves(tree: Any) -> list[str]:
        return [tree] if isinstance(tree, str) else leaves(tree["first"]) + leaves(tree["second"])

    assert sorted(leaves(layout["layout"])) == sorted(shown)
    known = {
        "Image": layouts.ImageConfig(),
        "3D": layouts.ThreeDeeConfig(),
        "Plot": layouts.PlotConfig(),
        "RosOut": layouts.LogConfig(),
    }
    for kind, config in shown.items():
        assert set(config) - {"foxglovePanelTitle"} <= set(known[kind.partition("!")[0]]._to_dict()), kind


PANEL_SCHEMAS = {
    "Image": {"foxglove.CompressedImage", "foxglove.RawImage", "foxglove.CameraCalibration"},
    "3D": {"foxglove.PointCloud"},
    "Plot": {"ninedtact.Wrench"},
    "RosOut": {"foxglove.Log"},
}
"""The schemas of the topics that each kind of panel shows, by Foxglove's documentation of the panel."""


def paths_in(config: Any) -> set[str]:
    """All topics of a panel's settings, with the fields that it takes from them."""
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
    folder, images, layout = sensor_folder(tmp_path / "small"), tmp_path / "images", tmp_path / "layout.json"
    images.mkdir()
    for number in range(12):
        cv2.imwrite(str(images / f"{number:02}.png"), skin(100))
    words = ["--source", str(images), "--sensor", str(folder), "--force", "none", "--loop", "--port", "0"]
    words += ["--layout", str(layout)]
    start = [sys.executable, "-m", "ninedtact", "foxglove", *words]
    with subprocess.Popen(start, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        address = running.stdout.readline().partition("ws://")[2].partition(";")[0].rstrip("/")
        with client(int(address.rpartition(":")[2])) as connection:
            channels = {one["topic"]: one for one in announced(connection)[1]}
            require_shown(json.loads(layout.read_text()), channels)
            subscribe(connection, {1: channels["/small/contact"]["id"]})
            assert json.loads(parts(connection.recv(PATIENCE_S))[3])["max_indentation_mm"] == 0
        running.send_signal(signal.SIGINT)
        assert running.wait(PATIENCE_S) == 0
    assert json.loads(layout.read_text()) == foxglove_layout("small")
    assert main(["foxglove", *words]) == 1
    assert "expected --layout to name a new file" in capsys.readouterr().err
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["foxglove", *words[:-3], str(taken.getsockname()[1])]) == 1
    assert "in use" in capsys.readouterr().err

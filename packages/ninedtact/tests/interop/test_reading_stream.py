"""Readings over TCP and WebSocket: the clients of the documentation, the guard, and clients that are slow."""

import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import dedent
from threading import Event, Thread

import msgspec
import numpy as np
import pytest
from small_sensor import DARK, SHAPE, UNTOUCHED, SkinCamera, image_folder, sensor_folder, sensor_on, skin, wait_until
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.reconnecting import ReconnectingFrameSource
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.interop.reading_stream import ReadingServer, StreamedReading, StreamedStatus, reading_stream_json_schema
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, Wrench, WrenchEstimate
from ninedtact.reading import Reading, read_frame
from ninedtact.reference_images import ReferenceImages
from ninedtact.sensor import Sensor
from ninedtact.simulation.objects.catalogue import indenter_from_name

DOCS = Path(__file__).parents[4] / "docs"
PAGE = (DOCS / "streaming.md").read_text(encoding="utf-8")
WITHOUT_STATED_ERROR = np.diag([1.0, 1.0, 4.0, 1.0, 1.0, np.inf])
PATIENCE_S = 60


class Constant(ForceEstimator):
    """Always answers the same wrench, whose last error is unknown."""

    name = "constant"

    def estimate(self, reading: Reading) -> WrenchEstimate:
        wrench = Wrench(np.array([0.0, 0.0, -2.0]), np.zeros(3), stamp_ns=reading.stamp_ns)
        return WrenchEstimate(wrench, WITHOUT_STATED_ERROR, touching=True)

    def forget(self) -> None:
        pass


@dataclass
class Served:
    """A server and the sensor that it serves."""

    server: ReadingServer
    sensor: Sensor
    camera: SkinCamera
    sentences: list[str]
    """What a terminal is told."""


@contextmanager
def served_camera(level: int) -> Iterator[Served]:
    with ReadingServer("small", "127.0.0.1", 0, 0) as server:
        over, camera, sentences = Event(), SkinCamera(), list[str]()
        camera.level = level
        sensor = sensor_on(ReconnectingFrameSource(camera, on_lost=lambda loss: None, retry_ms=20.0))
        sensor.estimator = Constant()
        thread = Thread(target=server.serve, args=(sensor, over.is_set, sentences.append))
        thread.start()
        try:
            yield Served(server, sensor, camera, sentences)
        finally:
            over.set()
            thread.join()


@pytest.fixture
def served() -> Iterator[Served]:
    with served_camera(UNTOUCHED) as served:
        wait_until(lambda: served.sensor.current_depth_reader is not None and served.server._status is None)
        yield served


def client_of_the_page(language: str, served: Served) -> str:
    found = re.search(rf"    ```{language}\n(.*?)    ```", PAGE, re.DOTALL)
    assert found is not None
    code = dedent(found[1]).replace("8765", str(served.server.port)).replace("8766", str(served.server.tcp_port))
    assert len([line for line in code.splitlines() if line.strip()]) <= 14
    return code


def camera_reading() -> Reading:
    """A reading with an image of noise, which compresses badly."""
    camera = SkinCamera()
    with Sensor(camera, SHAPE, ReferenceImages(SHAPE.depth_reader(Frame(skin(100))))) as sensor:
        reading = sensor.read()
    image = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    return replace(reading, frame=replace(reading.frame, image=image))


def first_line(command: list[str]) -> str:
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None and client.stderr is not None
        line = client.stdout.readline()
        client.kill()
        assert line, client.stderr.read()
    return line


def tcp(port: int, request: bytes) -> socket.socket:
    client = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
    client.sendall(request)
    return client


def test_the_python_client_of_the_page(served: Served) -> None:
    assert "-2.0" in first_line([sys.executable, "-u", "-c", client_of_the_page("python", served)])


def test_the_cpp_client_of_the_page(served: Served, tmp_path: Path) -> None:
    if shutil.which("g++") is None:
        pytest.skip("expected g++, got none")
    (tmp_path / "client.cpp").write_text(client_of_the_page("cpp", served))
    subprocess.run(["g++", "-o", str(tmp_path / "client"), str(tmp_path / "client.cpp")], check=True)
    assert json.loads(first_line([str(tmp_path / "client")]))["wrench"]["force_n"][2] == -2


def test_the_javascript_client_of_the_page(served: Served, tmp_path: Path) -> None:
    if shutil.which("node") is None:
        pytest.skip("expected node, got none")
    (tmp_path / "client.js").write_text(client_of_the_page("js", served))
    version = int(
        subprocess.run(["node", "--version"], capture_output=True, text=True, check=True).stdout[1:].split(".")[0]
    )
    flags = ["--experimental-websocket"] if version < 22 else []  # browsers, and Node since 22, have it
    assert "-2" in first_line(["node", *flags, str(tmp_path / "client.js")])


def test_a_client_is_told_of_a_refused_reference_and_of_a_lost_camera() -> None:
    with served_camera(DARK) as served:
        wait_until(lambda: len(served.sentences) > 0)
        with tcp(served.server.tcp_port, b"{}\n") as client:  # which comes later
            lines = map(json.loads, client.makefile())
            refused = next(lines)
            msgspec.json.decode(json.dumps(refused), type=StreamedStatus, strict=True)
            assert (refused["type"], refused["phase"]) == ("status", "taking the reference")
            assert "expected a lit reference image" in refused["trouble"] and "trying again" in refused["trouble"]
            served.camera.level = UNTOUCHED
            kinds = [next(lines)["type"] for _ in range(20)]
            assert kinds.count("reading") >= 17
            served.camera.plugged_in = False
            lost = next(line for line in lines if line["type"] == "status" and line["trouble"])
            assert lost["phase"].startswith("no images for ") and "got none within" in lost["trouble"]
            served.camera.plugged_in = True
            back = next(line for line in lines if line["type"] == "status")
            assert (back["phase"], back["trouble"]) == ("reading", "")
    assert served.sentences == [refused["trouble"], "readings arrive again", lost["trouble"], "readings arrive again"]


def test_messages_keep_to_the_schema_that_is_served_and_documented(served: Served) -> None:
    with connect(f"ws://127.0.0.1:{served.server.port}/?images=png") as client:
        first = json.loads(message := client.recv())
    reading = msgspec.json.decode(message, type=StreamedReading, strict=True)
    assert (reading.wrench.force_std_n, reading.wrench.torque_std_nm) == ([1, 1, 2], [1, 1, None])  # type: ignore[union-attr]
    assert abs(reading.stamp_ns - time.time_ns()) < PATIENCE_S * 1e9
    assert (reading.image.width, reading.image.height) == (64, 48)  # type: ignore[union-attr]
    with urllib.request.urlopen(f"http://127.0.0.1:{served.server.port}/schema.json") as answer:
        schema = json.load(answer)
    assert set(first) == set(schema["$defs"]["StreamedReading"]["properties"])
    assert schema == reading_stream_json_schema() == json.loads((DOCS / "reading_stream.schema.json").read_text())


def test_contacts_motion_and_slip_come_to_the_client_that_asks_and_are_computed_for_nobody_else(
    physical_sensor: SensorFolder,
) -> None:
    twin, shape = physical_sensor.twin(), physical_sensor.shape
    reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(4)))
    press = twin.press(None, indenter_from_name("key_05"), Pose(depth_mm=0.5))
    reading = read_frame(Frame(twin.renderer(press.corrected, 1), 10**9), shape, reader)
    reading = physical_sensor.estimator("physics").add_force(reading)
    with ReadingServer("small", "127.0.0.1", 0, 0) as server:
        with tcp(server.tcp_port, b"{}\n") as client:
            wait_until(lambda: server.clients == 1)
            server.publish(reading)
            alone = json.loads(client.makefile().readline())
            assert server._tracker is None and alone["tracking"] is None
        with (
            tcp(server.tcp_port, b'{"tracking": true}\n') as client,
            connect(f"ws://127.0.0.1:{server.port}/?tracking=true") as browser,
        ):
            wait_until(lambda: server.clients >= 2)
            server.publish(reading)
            message = json.loads(client.makefile().readline())
            found, wrench = message["tracking"], message["wrench"]
            assert json.loads(browser.recv())["tracking"] == found
    (contact,) = found["contacts"]
    assert contact["area_mm2"] == pytest.approx(reading.contacts[0].area_mm2)
    assert contact["force_n"] == wrench["force_n"] == pytest.approx(alone["wrench"]["force_n"], abs=0.01)
    assert wrench["torque_std_nm"][2] < alone["wrench"]["torque_std_nm"][2], "the object has not turned"
    assert found["motion"]["moved_mm"] == [0, 0, 0] and found["slip"]["state"] == "static"
    assert found["slip"]["friction"] is None


def test_a_client_that_does_not_read_delays_nobody_and_is_told_what_it_missed() -> None:
    reading, published = camera_reading(), 60
    with ReadingServer("small", "127.0.0.1", 0, 0) as server, socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", server.tcp_port))
        slow.sendall(b'{"images": "jpeg"}\n')
        quick = tcp(server.tcp_port, b"{}\n").makefile()
        wait_until(lambda: server.clients == 2)
        took_s = 0.0
        for number in range(published):
            began = time.perf_counter()
            server.publish(replace(reading, frame=replace(reading.frame, index=number)))
            took_s += time.perf_counter() - began
            assert json.loads(quick.readline())["index"] == number
        assert took_s / published < 0.01
        received, lines = [], slow.makefile()
        while not received or received[-1]["index"] < published - 1:
            received.append(json.loads(lines.readline()))
    assert len(received) < published
    assert len(received) + sum(each["missed"] for each in received) == published


@pytest.mark.parametrize(
    ("request_line", "sentence"),
    [
        (b"GET / HTTP/1.1\r\n", "one line of JSON"),
        (b'{"images": "gif"}\n', "got a fault in it: Invalid enum value 'gif' - at `$.images`"),
        (b"x" * 10_000 + b"\n", "one line of JSON"),
        (b'{"token": "guess"}\n', '"token" to be the one'),
    ],
)
def test_a_tcp_request_that_is_not_one_gets_a_sentence_and_no_reading(
    served: Served, request_line: bytes, sentence: str
) -> None:
    with tcp(served.server.tcp_port, request_line) as client:
        answer = json.loads(client.makefile().readline())
    assert answer["type"] == "error"
    assert sentence in answer["message"]


def test_a_website_cannot_read_the_stream(served: Served) -> None:
    address = f"ws://127.0.0.1:{served.server.port}/"
    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(address, additional_headers={"Origin": "http://evil.example"}),
    ):
        pass
    with pytest.raises(InvalidStatus, match="404"), connect(address + "?images=gif"):
        pass


def test_on_a_network_only_who_has_the_token_can_read() -> None:
    with ReadingServer("small", "0.0.0.0", 0, 0) as server:
        with tcp(server.tcp_port, b"{}\n") as client:
            assert "token" in json.loads(client.makefile().readline())["message"]
        with pytest.raises(InvalidStatus, match="404"), connect(f"ws://127.0.0.1:{server.port}/"):
            pass
        with connect(f"ws://127.0.0.1:{server.port}/{server.guard.token}/?images=jpeg"):
            pass
        with tcp(server.tcp_port, json.dumps({"token": server.guard.token}).encode() + b"\n") as client:
            wait_until(lambda: server.clients > 0)


def test_the_command_prints_where_it_serves(tmp_path: Path) -> None:
    folder, images = sensor_folder(tmp_path / "small"), image_folder(tmp_path / "images", *[100] * 12)
    words = ["--source", str(images), "--sensor", str(folder), "--force", "none", "--loop"]
    words += ["--port", "0", "--tcp-port", "0"]
    start = [sys.executable, "-m", "ninedtact", "serve", *words]
    with subprocess.Popen(start, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        addresses = json.loads(running.stdout.readline().partition(": ")[2].rpartition(";")[0])
        with tcp(int(addresses["tcp"].rpartition(":")[2]), b"{}\n") as client:
            messages = map(json.loads, client.makefile())
            assert next(message for message in messages if message["type"] == "reading")["wrench"] is None
        running.send_signal(signal.SIGINT)
        assert running.wait(PATIENCE_S) == 0


def test_idle_connections_keep_nobody_out_and_a_client_too_many_is_refused() -> None:
    with ReadingServer("small", "127.0.0.1", 0, 0) as server, ExitStack() as opened:
        most = server.guard.limits.clients
        for _ in range(2 * most):
            opened.enter_context(tcp(server.tcp_port, b""))
        clients = [opened.enter_context(tcp(server.tcp_port, b"{}\n")) for _ in range(most)]
        wait_until(lambda: server.clients == most)
        with tcp(server.tcp_port, b"{}\n") as one_more:
            assert b"expected at most 32 clients, got one more" in one_more.recv(1000)
        server.publish(camera_reading())
        assert all(client.recv(10).startswith(b'{"type"') for client in clients)

"""The page belongs to its user: who may connect to it, what clients may send, and how little they can cost the sensor."""

import asyncio
import http.server
import logging
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import pytest
from page_client import LOCAL, PROTOCOL, PageClient, page_client, served_small_page
from playwright.sync_api import Browser
from reading_clients import CAMERA, page_errors
from small_calibrated_twin import TWIN as CALIBRATED_TWIN
from small_calibrated_twin import PluggedCamera
from small_press_simulation import PRESSED, TWIN
from small_sensor import sensor_folder, wait_until
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request
from websockets.sync.client import connect

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.design import SensorDesign
from ninedtact.errors import InputError
from ninedtact.live.reading_recorder import RecordedSensorMetadata
from ninedtact.live.socket_guard import SocketGuard, SocketLimits
from ninedtact.simulation.press_sequence import PressSequence
from ninedtact.studio.accepted_page_messages import PART_BYTES, OneUploadPerClient, decode_page_message
from ninedtact.studio.calibration_page import CalibrationPage
from ninedtact.studio.calibration_session import CalibrationSession
from ninedtact.studio.guided_session import SwitchableCamera
from ninedtact.studio.page_server import PageServer, page_server
from ninedtact.studio.press_control import TwinPressController
from ninedtact.studio.recordings_panel import RecordingsPanel, RecordingsPanelContext
from ninedtact.studio.saved_files import SaveQuota
from ninedtact.studio.viewer import DRAWN_WITHIN_S

PATIENCE_S = 90.0
PROXY = "http://robot.local:9000"


def request(port: int, path: str = "/", headers: tuple[str, ...] = (), upgrade: bool = False) -> tuple[int, str]:
    upgrading = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13")
    upgrading = (*upgrading, "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==", f"Sec-WebSocket-Protocol: {PROTOCOL}")
    lines = (f"GET {path} HTTP/1.1", *headers, *(upgrading if upgrade else ()), "", "")
    with socket.create_connection(("127.0.0.1", port), timeout=30) as client:
        client.sendall("\r\n".join(lines).encode())
        answer = client.recv(100_000).decode(errors="replace")
    return int(answer.split()[1]), answer


def both(port: int, path: str, *headers: str) -> tuple[int, int]:
    return request(port, path, headers)[0], request(port, path, headers, upgrade=True)[0]


def test_other_websites_and_rebound_names_are_refused() -> None:
    with page_server(SocketGuard.for_host("127.0.0.1", (PROXY,))) as server:
        port, own = server.port, f"Host: 127.0.0.1:{server.port}"
        for name in (f"127.0.0.1:{port}", f"LOCALHOST:{port}", f"[::1]:{port}", "robot.local:9000"):
            assert both(port, "/", f"Host: {name}") == (200, 101), name
        for origin in (f"http://127.0.0.1:{port}", f"http://localhost:{port}", PROXY):
            assert both(port, "/", own, f"Origin: {origin}") == (200, 101), origin
        for name in (f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port + 1}", f"localhost.:{port}"):
            assert both(port, "/", f"Host: {name}") == (403, 403), name
        others = ("http://evil.example", "null", f"http://localhost:{port + 1}", f"https://127.0.0.1:{port}", "")
        for origin in (*others, "https://robot.local:9000"):
            assert both(port, "/", own, f"Origin: {origin}") == (403, 403), origin
        assert both(port, "/") == (403, 403) and both(port, "/", own, own) == (403, 403)
        assert both(port, "/", own, f"Origin: {PROXY}", "Origin: http://evil.example") == (403, 403)
        refused = request(port, "/", (f"Host: {'<b>' * 99}",))[1]
        assert "expected Host to name the page, got '<b>" in refused and "--allow-origin" in refused
        assert "text/plain" in refused and "nosniff" in refused


def test_viser_itself_is_at_an_address_that_no_website_can_guess() -> None:
    with page_server(LOCAL) as server, pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", server.viser.get_port()), timeout=5)


def test_who_is_the_page_itself() -> None:
    def is_refused(guard: SocketGuard, port: int = 8080, **headers: str) -> bool:
        return guard.find_refusal(Request("/", Headers(**headers)), "127.0.0.1", port) is not None

    local, files, own = SocketGuard.for_host("localhost"), SocketGuard.for_host("::1", ("FILE://",)), "127.0.0.1:8080"
    for host, port, is_own in (("localhost", 80, True), ("[::1]", 80, True), ("localhost", 8080, False)):
        assert is_refused(local, port, Host=host, Origin=f"http://{host}") != is_own  # browsers leave port 80 out
    assert is_refused(local, Host=own, Origin="file://") and not is_refused(files, Host=own, Origin="file://")
    assert is_refused(files, Host=own, Origin="null") and is_refused(files, Host="", Origin="file://")
    origins = SocketGuard.for_host("::1", ("HTTP://Robot:80/", "https://a.b:443", "https://a.b:80")).allowed_origins
    assert origins == ("http://robot", "https://a.b", "https://a.b:80")  # as browsers send them
    for none in ("*", "robot", "http://", "ftp://robot", "http://robot/page", "http://u@robot", "http://x:65536"):
        with pytest.raises(InputError, match="expected --allow-origin as http://NAME:PORT"):
            SocketGuard.for_host("127.0.0.1", (none,))


def test_on_a_network_the_address_has_a_secret() -> None:
    guard = SocketGuard.for_host("0.0.0.0")
    with page_server(guard) as server:
        port, token, host = server.port, guard.token, f"Host: 127.0.0.1:{server.port}"
        assert re.fullmatch(rf"http://[\w.-]+:{port}/[\w-]{{22}}/", guard.page_address(port))
        assert both(port, f"/{token}/", host) == both(port, f"/{token}", host) == (200, 101)
        for path in ("/", f"/{token[:-1]}/", f"/{token}x/", f"//{token}/", f"/?{token}", "/\udcff/", f"/x/../{token}/"):
            path = path.encode("utf-8", "surrogateescape").decode("latin-1")
            assert both(port, path, host) == (404, 404), path
        assert both(port, f"/{token}/", f"Host: evil.example:{port}") == (403, 403)
        assert token not in request(port, "/", (host,))[1]
    assert SocketGuard.for_host("0.0.0.0").token != token
    assert {SocketGuard.for_host(host).token for host in ("127.0.0.1", "::1", "localhost", "127.9.9.9")} == {""}
    # A server at "::" is not reached over IPv4.
    assert re.fullmatch(r"http://\[[0-9a-f:]+\]:80/[\w-]{22}/", SocketGuard.for_host("::").page_address(80))


UPDATE = {"type": "GuiUpdateMessage", "uuid": "u"}
HANDLE = {"type": "TransformControlsUpdateMessage", "name": "/handle", "owner": "1", "position": (1.5, 0.0, 6.0)}
START = {"type": "FileTransferStartUpload", "source_component_uuid": "b", "transfer_uuid": "t", "filename": "a.stl"}
START |= {"mime_type": "model/stl", "part_count": 2, "size_bytes": PART_BYTES + 3}
PART = {"type": "FileTransferPart", "source_component_uuid": "b", "transfer_uuid": "t", "part_index": 0, "content": b""}
CLICK = {"type": "ScenePointerMessage", "event_type": "click", "ray_origin": (0.0, 0.0, 1.0), "modifier": "shift"}
CLICK |= {"ray_direction": (0.0, 0.0, -1.0), "screen_pos": [(0.5, 0.5)]}
SENT_BY_CONTROLS: tuple[dict[str, Any], ...] = (
    *(UPDATE | {"updates": {"value": value}} for value in (True, 1.25, 7, "height", (1.0, -2.5))),
    HANDLE | {"wxyz": (1.0, 0, 0, 0)},
    {"type": "CommandTriggerMessage", "uuid": "c"},
    CAMERA,
    CLICK,
    START,
    PART | {"content": b"x" * PART_BYTES},
)
SENT_BY_NOBODY: tuple[dict[str, Any], ...] = (
    *(UPDATE | {"updates": {"value": value}} for value in ((1.0,), (1.0, 2.0, 3.0), None, {}, 1e12, "x" * 201)),
    *(UPDATE | {"updates": {"value": value}} for value in (float("nan"), float("inf"), 2**63, ["", ""], b"")),
    UPDATE | {"updates": {"removed": True}},
    UPDATE | {"updates": {}},
    HANDLE | {"wxyz": (1.0, 0, 0, float("nan"))},
    CLICK | {"screen_pos": [(0.5, 0.5)] * 3},
    CAMERA | {"wxyz": (1.0,)},
    START | {"size_bytes": 16_000_001},
    START | {"part_count": 33},
    PART | {"content": b"x" * (PART_BYTES + 1)},
    PART | {"part_index": -1},
    {"type": "ShareUrlRequest"},
    {"type": "NoSuchMessage"},
)


def test_only_what_the_controls_of_a_page_send_is_passed_on_and_one_file_at_a_time() -> None:
    encode = msgspec.msgpack.encode
    assert [one for one in SENT_BY_CONTROLS if decode_page_message(encode(one)) is None] == []
    assert [one for one in SENT_BY_NOBODY if decode_page_message(encode(one)) is not None] == []
    assert [junk for junk in ("text", b"", b"\xc1", b"\x91" * 50_000) if decode_page_message(junk) is not None] == []
    test = OneUploadPerClient()
    other = {"transfer_uuid": "other"}
    first, last = PART | {"content": b"x" * PART_BYTES}, PART | {"part_index": 1, "content": b"xyz"}
    sent = (first, START, START | other, first | other, first, START | other, last, last, START | other, CLICK)
    taken = [test.accepts(decode_page_message(encode(one))) for one in sent]
    assert taken == [False, True, False, False, True, False, True, False, True, True]
    of_another_size = (START | {"size_bytes": 9}, START, last, PART, first, PART | {"part_index": 1})
    test = OneUploadPerClient()
    assert [test.accepts(decode_page_message(encode(one))) for one in of_another_size] == [
        *(False, True, False, False, True, False)
    ]


def test_junk_is_dropped_in_one_line_and_disturbs_nobody(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    with page_server(LOCAL) as server:
        slider, shared = server.viser.gui.add_slider("slider", 0.0, 9.0, 1.0, 1.0), list[str]()
        server.viser.request_share_url = lambda verbose=True: shared.append("shared")
        with page_client(server) as junk, page_client(server) as other:
            uuid = junk.control("slider").uuid
            for message in SENT_BY_NOBODY:
                junk.send(message | ({"uuid": uuid} if "uuid" in message else {}))
            junk.socket.send("text")
            for client, value in ((junk, 7.0), (other, 3.0)):  # the one who sends junk is still connected, and heard
                client.use("slider", value)
                wait_until(lambda value=value: slider.value == value)
            with page_client(server) as large, pytest.raises(ConnectionClosed):
                large.socket.send(b"x" * 1_000_000)
                wait_until(lambda: large.socket.ping().wait(1.0))
                pytest.fail("it is still connected")
            wait_until(lambda: len(server.viser.get_clients()) == 2)
        protocols: Any = ["viser-v0.0.1"]
        with (
            connect(f"ws://127.0.0.1:{server.port}", subprotocols=protocols) as outdated,
            pytest.raises(ConnectionClosed, match=r"1002 .* Version mismatch\. Client: 0\.0\.1"),
        ):
            outdated.recv(timeout=30)
    dropped, version = caplog.messages
    assert "dropped a message of" in dropped and "load it again" in version and not shared
    said = capfd.readouterr()
    assert "Traceback" not in said.err and said.out == ""


@contextmanager
def live_page(guard: SocketGuard, out: Path) -> Iterator[tuple[PageServer, Callable[[], Any]]]:
    press, quota = TwinPressController(PressSequence(TWIN, [PRESSED])), SaveQuota()
    folder = load_sensor(sensor_folder(out / "sensor"))
    recorder = quota.new_recorder([RecordedSensorMetadata(folder, "bench")], out)
    panel = partial(RecordingsPanel, context=RecordingsPanelContext(folder, recorder))
    with served_small_page(out, [panel], press=press, guard=guard, quota=quota) as served:
        yield served.server, served.refresh
    recorder.stop()


@contextmanager
def calibration_page(guard: SocketGuard, out: Path) -> Iterator[tuple[PageServer, Callable[[], Any]]]:
    camera = PluggedCamera(CALIBRATED_TWIN, SensorDesign(), rate_hz=60.0)
    with (
        page_server(guard) as server,
        CalibrationSession(SwitchableCamera(lambda address: camera, "sim"), out / "s") as session,
    ):
        yield server, CalibrationPage(server, session, lambda: {"sim": "simulated sensor"}, camera).refresh


@pytest.mark.usefixtures("without_type_checks")
@pytest.mark.parametrize(("page", "expected"), [(live_page, 20), (calibration_page, 8)])
def test_values_that_no_person_could_choose_stop_no_page(
    page: Any, expected: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    patient = SocketGuard("127.0.0.1", limits=SocketLimits(messages_per_s=1_000_000))
    with ExitStack() as opened:
        server, refresh = opened.enter_context(page(patient, tmp_path))
        junk, other = (opened.enter_context(page_client(server)) for _ in range(2))
        wait_until(lambda: (refresh(), all(one.control("dark") for one in (junk, other)))[1])
        every = [one for one in list(junk.controls.values()) if one.value is not None]
        assert len(every) >= expected
        for control in every:
            for value in (-1e9, 7, 0.5, "nope", "", "\x00", (0.0, 0.0), (1e9, -1e9)):
                junk.set_value(control.uuid, value)
            refresh()
        for uuid in (*(control.uuid for control in every), "nobody"):
            name = {"source_component_uuid": uuid, "transfer_uuid": f"of {uuid}"}
            for size, parts in ((0, 0), (3, 1), (4, 1), (PART_BYTES + 3, 2)):
                junk.send(START | name | {"size_bytes": size, "part_count": parts})
                junk.send(PART | name | {"content": b"abc"})
                junk.send(PART | name | {"content": b"abc", "part_index": 1})
            junk.send(CLICK | {"ray_direction": (0.0,) * 3, "ray_origin": (1e9,) * 3, "screen_pos": []})
            junk.send(CLICK | {"ray_direction": (1.0, 0, 1e-9), "modifier": uuid[:200]})
            junk.send(CLICK | {"screen_pos": [(0.5, 0.5)] * 2})
            junk.send({"type": "CommandTriggerMessage", "uuid": uuid})
            junk.send(HANDLE | {"wxyz": (0.0,) * 4, "name": uuid})
        refresh()
        junk.send(CAMERA | {"wxyz": (0.0,) * 4, "position": (1e9,) * 3, "image_height": -1, "image_width": 1e9})
        junk.socket.ping().wait(PATIENCE_S)
        for dark in (True, False):
            other.use("dark", dark)
            newest = lambda: other.until_sent(lambda one: one["type"] == "ThemeConfigurationMessage")  # noqa: E731
            wait_until(lambda dark=dark, newest=newest: (refresh(), newest()["dark_mode"] == dark)[1])
    assert "Traceback" not in capfd.readouterr().err


def test_a_browser_that_draws_slowly_is_sent_two_moments_ahead_and_tells_for_nobody_else(tmp_path: Path) -> None:
    with served_small_page(tmp_path) as served, served.viewer() as (slow, _), served.viewer() as (_, other):

        def mark(client: PageClient) -> tuple[str, int]:
            found = [
                re.search('data-moment="(.*)/(.*)"', str(getattr(one, "content", "")))
                for one in client.controls.values()
            ]
            ((name, number),) = (one.groups() for one in found if one)
            return name, int(number)

        def tell(name: str, number: object) -> None:
            own = f"Host: 127.0.0.1:{served.server.port}"
            assert request(served.server.port, f"/drawn/{name}/{number}", (own,))[0] in (204, 400)

        wait_until(lambda: "<i hidden data-moment" in str([vars(one) for one in slow.controls.values()]))
        wait_until(lambda: served.refresh() and mark(slow)[1] > 0)  # the first moment; the page is there before it
        name, number = mark(slow)
        for nobody, forged in (
            ("nobody", 10**9),
            (name, "x"),
            (name, -1),
            (name, 10**20),
            (name, "1/2"),
            (f"{name}x", 1),
        ):
            tell(nobody, forged)
        assert served.server.drawn_moments.last(name) == 0
        tell(name, number)
        began_s, before = time.monotonic(), other.moment
        wait_until(lambda: served.refresh() and mark(slow)[1] > number)
        for _ in range(20):
            served.refresh()
            time.sleep(0.01)
        if time.monotonic() - began_s < DRAWN_WITHIN_S:  # else this computer is too slow to tell
            assert mark(slow)[1] <= number + 2 and other.moment is not before
        ahead = mark(slow)[1]
        wait_until(
            lambda: served.refresh() and mark(slow)[1] > ahead
        )  # as to a tab that is hidden, which draws nothing


@contextmanager
def served(limits: SocketLimits, sent: bytes, times: int = 10**9) -> Iterator[tuple[int, list[ServerConnection]]]:
    """Any other server under the guard, which sends the same again and again."""
    loop, connections = asyncio.new_event_loop(), []

    async def send(connection: ServerConnection) -> None:
        connections.append(connection)
        for _ in range(times):
            await connection.send(sent)
        word = await connection.recv()
        if word != "ready":
            raise ZeroDivisionError(word)
        await connection.wait_closed()

    async def start() -> int:
        guard = SocketGuard("127.0.0.1", limits=limits)
        server = await guard.serve(send, 0)
        return int(server.sockets[0].getsockname()[1])

    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield asyncio.run_coroutine_threadsafe(start(), loop).result(30), connections
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        for task in asyncio.all_tasks(loop):
            task.cancel()
        loop.run_until_complete(asyncio.sleep(0))
        loop.close()


def test_a_client_that_never_reads_is_disconnected_and_keeps_no_memory(caplog: pytest.LogCaptureFixture) -> None:
    message = bytes(1_000_000)
    with served(SocketLimits(send_timeout_s=1.0), message) as (port, connections):
        client = socket.create_connection(("127.0.0.1", port))
        handshake = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13"
        key = "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg=="
        client.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{handshake}\r\n{key}\r\n\r\n".encode())
        wait_until(lambda: bool(connections))
        largest = 0

        def is_closed() -> bool:
            nonlocal largest
            largest = max(largest, connections[0].transport.get_write_buffer_size())
            return connections[0].state.name == "CLOSED"

        wait_until(is_closed)
        client.close()
    assert largest < 1.1 * len(message)
    assert any("disconnected 127.0.0.1:" in line and "did not read for 1 s" in line for line in caplog.messages)


def test_a_client_that_floods_and_clients_beyond_the_limit_are_disconnected(caplog: pytest.LogCaptureFixture) -> None:
    with (
        served(SocketLimits(messages_per_s=20, clients=2), b"", times=0) as (port, _),
        connect(f"ws://127.0.0.1:{port}") as one,
        connect(f"ws://127.0.0.1:{port}") as two,
    ):
        assert request(port, "/", (f"Host: 127.0.0.1:{port}",), upgrade=True)[0] == 503
        with pytest.raises(ConnectionClosed):
            while True:
                one.ping()
                time.sleep(0.001)
        two.ping().wait(30)
        two.send("a bug in a handler")
        with pytest.raises(ConnectionClosed, match="1011"):
            two.recv(timeout=30)
    assert sum("more than 20 messages in a second" in line for line in caplog.messages) == 1
    assert any("connection handler failed: ZeroDivisionError('a bug in a handler')" in line for line in caplog.messages)
    assert all(one.exc_info is None for one in caplog.records if one.name != "websockets.client")


def test_clients_that_never_speak_keep_nobody_out_and_are_disconnected(caplog: pytest.LogCaptureFixture) -> None:
    with served(SocketLimits(clients=4, speaks_within_s=60.0), b"", times=0) as (port, _), ExitStack() as opened:
        silent = [opened.enter_context(connect(f"ws://127.0.0.1:{port}")) for _ in range(4)]
        for number in range(4):
            visitor = opened.enter_context(connect(f"ws://127.0.0.1:{port}"))
            visitor.send("ready")
            with pytest.raises(ConnectionClosed):
                silent[number].recv(timeout=30)
    with (
        served(SocketLimits(speaks_within_s=0.2), b"", times=0) as (port, _),
        connect(f"ws://127.0.0.1:{port}") as one,
        pytest.raises(ConnectionClosed),
    ):
        one.recv(timeout=30)
    assert any("it sent nothing in 0.2 s" in line for line in caplog.messages)


FOREIGN_PAGE = """<body><iframe src="http://127.0.0.1:{port}/"></iframe><script>
const socket = new WebSocket("ws://127.0.0.1:{port}/", ["{protocol}"]);
socket.onopen = () => document.title = "connected"; socket.onerror = () => document.title = "refused";
</script></body>"""


def test_in_a_browser_other_websites_reach_nothing(browser: Browser) -> None:
    asked: list[str] = []

    class Website(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path != "/favicon.ico":  # which the browser asks of every website, at a time of its own
                asked.append(self.path)
            self.send_response(200)
            self.end_headers()
            self.wfile.write(FOREIGN_PAGE.format(port=port, protocol=PROTOCOL).encode())

        def log_message(self, *args: object) -> None: ...

    with page_server(LOCAL) as server, http.server.ThreadingHTTPServer(("127.0.0.1", 0), Website) as website:
        port, tab = server.port, browser.new_page()
        threading.Thread(target=website.serve_forever).start()
        try:
            tab.goto(f"http://localhost:{website.server_port}/")
            tab.wait_for_function("document.title != ''", timeout=PATIENCE_S * 1000)
            assert tab.title() == "refused" and not server.viser.get_clients()
            assert all(frame.url != f"http://127.0.0.1:{port}/" for frame in tab.frames)
            asked.clear()
            said: list[str] = []
            tab.on("console", lambda line: said.append(line.text))
            tab.goto(f"http://127.0.0.1:{port}/?websocket=ws://localhost:{website.server_port}/")
            wait_until(
                lambda: bool(tab.title()) and any("Connecting to: ws://localhost" in line for line in said), PATIENCE_S
            )
            tab.wait_for_timeout(1000)
            assert asked == []
        finally:
            website.shutdown()


LATE_IMAGE = """() => new Promise(done => {
  const drawing = new Blob(["<svg xmlns='http://www.w3.org/2000/svg'/>"], {type: 'image/svg+xml'});
  const image = new Image(), address = URL.createObjectURL(drawing);
  image.onload = () => done('loaded');
  image.onerror = () => done('lost');
  setTimeout(() => { image.src = address; }, 200);
  URL.revokeObjectURL(address);
})"""
"""A busy browser begins to load an image after viser's page has dropped it for the next one."""


def test_in_a_browser_the_secret_address_works_also_with_the_next_program_that_serves_it(
    browser: Browser, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    guard, tab, port = SocketGuard.for_host("0.0.0.0"), browser.new_page(), 0
    errors = page_errors(tab)
    for number in range(2):
        with page_server(guard, port) as server:
            box, port = server.viser.gui.add_slider("number", 0, 10, 1, 5), server.port
            text = server.viser.gui.add_text("word", "none yet")
            if number == 0:
                tab.goto(f"http://127.0.0.1:{port}/{guard.token}/")
            text.value = f"shown {number}"
            is_shown = f"[...document.querySelectorAll('input')].some(input => input.value == 'shown {number}')"
            tab.wait_for_function(f"!window.isOfEarlierPage && {is_shown}", timeout=PATIENCE_S * 1000)
            tab.get_by_role("slider").first.focus()
            tab.keyboard.press("ArrowRight")
            wait_until(lambda box=box: box.value == 6, PATIENCE_S, pause_s=0.05)
            assert tab.evaluate(LATE_IMAGE) == "loaded"
            tab.evaluate("window.isOfEarlierPage = true")
    assert errors == [] and caplog.messages == []

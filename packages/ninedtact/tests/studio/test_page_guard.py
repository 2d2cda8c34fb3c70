"""The page belongs to its user: who may connect to it, what clients may send, and how little they can cost the sensor."""

import asyncio
import gc
import http.server
import logging
import re
import socket
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
import viser
from playwright.sync_api import Browser
from reading_clients import CAMERA, page_errors, unpack_text
from small_sensor import SHAPE, SkinCamera, sensor_on, wait_until
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from ninedtact.design import Gel
from ninedtact.studio import viser_internals
from ninedtact.studio.page_and_server import SensorPage, page_server
from ninedtact.studio.page_controller import DisplayedSensor, PageController, PageMoment
from ninedtact.studio.page_messages import PART_BYTES, is_page_message
from ninedtact.studio.scene_3d import gel_block_under_skin
from ninedtact.studio.sensor_poller import SensorPoller
from ninedtact.studio.socket_guard import InvalidAllowedOrigin, SocketGuard, SocketLimits
from ninedtact.studio.viser_internals import UnknownPageServer

PATIENCE_S = 90.0
PROTOCOL = f"viser-v{viser.__version__}"
PROXY = "http://robot.local:9000"


def request(port: int, path: str = "/", headers: tuple[str, ...] = (), upgrade: bool = False) -> tuple[int, str]:
    """The status of the answer to a request with just these headers, and the answer."""
    upgrading = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13")
    upgrading = (*upgrading, "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==", f"Sec-WebSocket-Protocol: {PROTOCOL}")
    lines = (f"GET {path} HTTP/1.1", *headers, *(upgrading if upgrade else ()), "", "")
    with socket.create_connection(("127.0.0.1", port), timeout=30) as client:
        client.sendall("\r\n".join(lines).encode())
        answer = client.recv(100_000).decode(errors="replace")
    return int(answer.split()[1]), answer


def both(port: int, path: str, *headers: str) -> tuple[int, int]:
    """The statuses of a page and of a WebSocket."""
    return request(port, path, headers)[0], request(port, path, headers, upgrade=True)[0]


def open_client(port: int) -> ClientConnection:
    """A client as viser's page opens it, whose camera has been sent."""
    client = connect(f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL], max_size=None)  # type: ignore[list-item]
    client.send(msgspec.msgpack.encode(CAMERA))
    return client


def test_other_websites_and_rebound_names_are_refused() -> None:
    with page_server("127.0.0.1", 0, SocketGuard.for_host("127.0.0.1", (PROXY,))) as server:
        port = server.get_port()
        own = f"Host: 127.0.0.1:{port}"
        for host in (
            f"127.0.0.1:{port}",
            f"localhost:{port}",
            f"LOCALHOST:{port}",
            f"[::1]:{port}",
            "robot.local:9000",
        ):
            assert both(port, "/", f"Host: {host}") == (200, 101), host
        for origin in (f"http://127.0.0.1:{port}", f"http://localhost:{port}", PROXY):
            assert both(port, "/", own, f"Origin: {origin}") == (200, 101), origin
        for host in (
            f"evil.example:{port}",
            "127.0.0.1",
            f"127.0.0.1:{port + 1}",
            f"localhost.:{port}",
            f"10.0.0.1:{port}",
        ):
            assert both(port, "/", f"Host: {host}") == (403, 403), host
        others = ("http://evil.example", "null", f"http://localhost:{port + 1}", f"https://127.0.0.1:{port}", "")
        for origin in (*others, "https://robot.local:9000"):
            assert both(port, "/", own, f"Origin: {origin}") == (403, 403), origin
        assert both(port, "/") == (403, 403) and both(port, "/", own, own) == (403, 403)
        assert both(port, "/", own, f"Origin: {PROXY}", "Origin: http://evil.example") == (403, 403)
        refused = request(port, "/", (f"Host: {'<b>' * 99}",))[1]
        assert "expected Host to name the page, got '<b>" in refused and "--allow-origin" in refused
        assert "text/plain" in refused and "nosniff" in refused


def test_browsers_leave_port_80_out() -> None:
    guard = SocketGuard.for_host("localhost")
    for host, port, is_own in (("localhost", 80, True), ("[::1]", 80, True), ("localhost", 8080, False)):
        plain = Request("/", Headers(Host=host, Origin=f"http://{host}"))
        assert (guard.find_refusal(plain, "127.0.0.1", port) is None) == is_own


def test_files_of_this_computer_connect_only_where_they_are_allowed() -> None:
    def is_refused(guard: SocketGuard, **headers: str) -> bool:
        return guard.find_refusal(Request("/", Headers(**headers)), "127.0.0.1", 8080) is not None

    closed, opened = SocketGuard.for_host("127.0.0.1"), SocketGuard.for_host("127.0.0.1", ("FILE://",))
    own = "127.0.0.1:8080"
    assert is_refused(closed, Host=own, Origin="file://") and not is_refused(opened, Host=own, Origin="file://")
    assert is_refused(opened, Host=own, Origin="null") and is_refused(opened, Host="", Origin="file://")
    nameless = opened.find_refusal(Request("/", Headers(Host=own, Origin="null")), "127.0.0.1", 8080)
    assert nameless is not None and "python -m http.server" in nameless[1]  # --allow-origin null does not exist


def test_on_a_network_the_address_has_a_secret() -> None:
    guard = SocketGuard.for_host("0.0.0.0")
    with page_server("0.0.0.0", 0, guard) as server:
        port, token = server.get_port(), guard.token
        assert re.fullmatch(rf"http://[\w.-]+:{port}/[\w-]{{22}}/", guard.page_address(port))
        host = f"Host: 127.0.0.1:{port}"
        assert both(port, f"/{token}/", host) == both(port, f"/{token}", host) == (200, 101)
        assert both(port, f"/{token}/?websocket=ws://127.0.0.1:{port}/{token}", host) == (200, 101)
        for path in ("/", f"/{token[:-1]}/", f"/{token}x/", f"//{token}/", f"/?{token}", "/\udcff/", f"/x/../{token}/"):
            path = path.encode("utf-8", "surrogateescape").decode("latin-1")
            assert both(port, path, host) == (404, 404), path
        assert both(port, f"/{token}/", f"Host: evil.example:{port}") == (403, 403)
        assert token not in request(port, "/", (host,))[1]
    assert SocketGuard.for_host("0.0.0.0").token != token
    assert {SocketGuard.for_host(host).token for host in ("127.0.0.1", "::1", "localhost", "127.9.9.9")} == {""}
    assert SocketGuard.for_host("::1").page_address(80) == "http://[::1]:80"
    # A server at "::" is not reached over IPv4.
    assert re.fullmatch(r"http://\[[0-9a-f:]+\]:80/[\w-]{22}/", SocketGuard.for_host("::").page_address(80))


@pytest.mark.parametrize(
    "origin", ["*", "robot", "http://", "ftp://robot", "http://robot/page", "http://u@robot", "http://x:65536"]
)
def test_an_origin_that_is_none_is_refused(origin: str) -> None:
    with pytest.raises(InvalidAllowedOrigin, match="expected --allow-origin as http://NAME:PORT"):
        SocketGuard.for_host("127.0.0.1", (origin,))


def test_an_origin_is_compared_as_browsers_send_it() -> None:
    origins = SocketGuard.for_host(
        "127.0.0.1", ("HTTP://Robot:80/", "https://a.b:443", "https://a.b:80")
    ).allowed_origins
    assert origins == ("http://robot", "https://a.b", "https://a.b:80")


def test_junk_is_dropped_in_one_line_and_disturbs_nobody(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    with page_server("127.0.0.1", 0) as server:
        slider = server.gui.add_slider("slider", 0.0, 9.0, 1.0, 1.0)
        uuid = slider._impl.uuid
        shared: list[str] = []
        server.request_share_url = lambda verbose=True: shared.append("shared")
        with open_client(server.get_port()) as junk, open_client(server.get_port()) as other:
            for message in (
                "text",
                b"",
                b"\xc1",
                b"\x91" * 50_000,
                msgspec.msgpack.encode({"type": "ShareUrlRequest"}),
                msgspec.msgpack.encode({"type": "NoSuchMessage"}),
                msgspec.msgpack.encode(CAMERA | {"wxyz": (1.0,)}),
                msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"removed": True}}),
                msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": float("nan")}}),
            ):
                assert not is_page_message(message, {uuid: slider}.get)
                junk.send(message)
            not_a_number = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": "x"}}
            junk.send(msgspec.msgpack.encode(not_a_number))
            junk.send(msgspec.msgpack.encode(not_a_number | {"updates": {"value": 7}}))
            wait_until(lambda: slider.value == 7.0)  # the one who sends junk is still connected, and heard
            other.send(msgspec.msgpack.encode(not_a_number | {"updates": {"value": 3}}))
            wait_until(lambda: slider.value == 3.0)
            assert len(server.get_clients()) == 2 and not slider._impl.removed and not shared
            with open_client(server.get_port()) as large, pytest.raises(ConnectionClosed, match="1009"):
                large.send(b"x" * 1_000_000)
                while True:
                    large.recv(timeout=30)
            wait_until(lambda: len(server.get_clients()) == 2)
    (dropped,) = caplog.messages
    assert "dropped a message of 4 bytes" in dropped and "Traceback" not in capfd.readouterr().err


def test_what_fails_in_a_control_is_one_line_and_no_flood(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail(event: viser.GuiEvent) -> None:
        raise ZeroDivisionError(f"a bug\nin {event.target.label}")

    async def fail_later(event: viser.GuiEvent) -> None:
        fail(event)

    with page_server("127.0.0.1", 0) as server:
        first, second = server.gui.add_button("a thread"), server.gui.add_button("a task")
        first.on_click(fail)
        second.on_click(fail_later)
        with open_client(server.get_port()) as client:

            def press(button: viser.GuiButtonHandle) -> None:
                message = {"type": "GuiUpdateMessage", "uuid": button._impl.uuid, "updates": {"value": True}}
                client.send(msgspec.msgpack.encode(message))

            press(first)
            wait_until(lambda: len(caplog.messages) == 1)
            press(second)
            wait_until(lambda: gc.collect() >= 0 and len(caplog.messages) == 2, pause_s=0.1)  # asyncio reports then
            for _ in range(10):
                press(first)
        for _ in range(30):  # pages of another version are refused, and no more is said
            other: list[Subprotocol] = [Subprotocol("viser-v0.0.1")]
            with (
                connect(f"ws://127.0.0.1:{server.get_port()}", subprotocols=other) as outdated,
                pytest.raises(ConnectionClosed, match=r"1002 .* Version mismatch\. Client: 0\.0\.1"),
            ):
                outdated.recv(timeout=30)
    said = capfd.readouterr()
    thread, task, *others = caplog.messages
    assert re.fullmatch(
        r"a control of the page failed: ZeroDivisionError\('a bug\\nin a thread'\) at test_page_guard.py:\d+", thread
    )
    assert re.fullmatch(
        r"Task exception was never retrieved: ZeroDivisionError\('a bug\\nin a task'\) at test_page_guard.py:\d+", task
    )
    assert len(others) == 18 and all(record.exc_info is None for record in caplog.records)
    assert "Traceback" not in said.err and "viser" not in said.out


def test_what_cannot_be_shown_to_one_viewer_is_one_line_and_the_others_see_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(moment: PageMoment) -> None:
        raise ZeroDivisionError("a bug")

    with page_server("127.0.0.1", 0) as server, SensorPoller(sensor_on(SkinCamera())) as loop:
        controller = PageController([DisplayedSensor(loop)], tmp_path)
        page = SensorPage(server, controller, gel_block_under_skin(SHAPE, Gel()), "small")
        with open_client(server.get_port()), open_client(server.get_port()):
            wait_until(lambda: len(page.viewers) == 2)
            seen: list[PageMoment] = []
            for viewer, show in zip(page.viewers, (fail, seen.append), strict=True):
                monkeypatch.setattr(viewer, "show", show)
            for _ in range(30):
                controller.refresh(page)
    assert len(seen) == 30 and len(caplog.messages) == 20
    (line,) = set(caplog.messages)
    assert re.fullmatch(
        r"a moment could not be shown to one browser: ZeroDivisionError\('a bug'\) at test_page_guard.py:\d+", line
    )


def test_every_control_of_the_page_is_heard_and_no_more_than_one_file_at_a_time() -> None:
    update = {"type": "GuiUpdateMessage", "uuid": "u"}
    handle = {"type": "TransformControlsUpdateMessage", "name": "/handle", "owner": "1"}
    start = {"type": "FileTransferStartUpload", "source_component_uuid": "b", "transfer_uuid": "t", "filename": "a.stl"}
    start |= {"mime_type": "model/stl", "part_count": 2, "size_bytes": 9}
    part = {"type": "FileTransferPart", "source_component_uuid": "b", "transfer_uuid": "t", "part_index": 0}
    click = {"type": "ScenePointerMessage", "event_type": "click", "ray_origin": (0.0, 0.0, 1.0), "modifier": "shift"}
    click |= {"ray_direction": (0.0, 0.0, -1.0), "screen_pos": [(0.5, 0.5)]}
    kept = {"type": "LocalStorageGetItemResponseMessage", "error": None, "request_uuid": "r"}
    for accepted, message in (
        *((True, update | {"updates": {"value": value}}) for value in (True, 1.25, 7, "height", (1.0, -2.5))),
        *(
            (False, update | {"updates": {"value": value}})
            for value in ((1.0,), (1.0, 2.0, 3.0), None, {}, 1e12, "x" * 201)
        ),
        (True, handle | {"wxyz": (1.0, 0, 0, 0), "position": (1.5, 0.0, 6.0)}),
        (False, handle | {"wxyz": (1.0, 0, 0, float("nan")), "position": (1.5, 0.0, 6.0)}),
        (True, {"type": "CommandTriggerMessage", "uuid": "c"}),
        (True, click),
        (True, kept | {"value": "dark"}),
        (True, kept | {"value": None}),
        (False, kept | {"value": "x" * 201}),
        (False, click | {"screen_pos": [(0.5, 0.5)] * 3}),
        (True, start),
        (False, start | {"size_bytes": 16_000_001}),
        (False, start | {"part_count": 33}),
        (True, part | {"content": b"x" * PART_BYTES}),
        (False, part | {"content": b"x" * (PART_BYTES + 1)}),
        (False, part | {"content": b"", "part_index": -1}),
    ):
        assert is_page_message(msgspec.msgpack.encode(message), lambda uuid: None) == accepted, message
    with page_server("127.0.0.1", 0) as server, open_client(server.get_port()) as client:
        button = server.gui.add_upload_button("upload")
        start |= {"source_component_uuid": button._impl.uuid}
        unfinished = server.gui._current_file_upload_states
        for name in ("first", "second"):
            client.send(msgspec.msgpack.encode(start | {"transfer_uuid": name}))
            wait_until(lambda name=name: list(unfinished) == [name])


@contextmanager
def served(limits: SocketLimits, sent: bytes, times: int = 10**9) -> Iterator[tuple[int, list[ServerConnection]]]:
    """Any other server under the guard, which sends the same again and again."""
    loop, connections = asyncio.new_event_loop(), []

    async def send(connection: ServerConnection) -> None:
        connections.append(connection)
        for _ in range(times):
            await connection.send(sent)
        raise ZeroDivisionError(await connection.recv())

    async def start() -> int:
        guard = SocketGuard("127.0.0.1", limits=limits)
        server = await guard.serve(send, "127.0.0.1", 0, is_expected=lambda message: True)
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
    with served(SocketLimits(messages_per_s=20, clients=2), b"", times=0) as (port, _):
        with connect(f"ws://127.0.0.1:{port}") as one, connect(f"ws://127.0.0.1:{port}") as two:
            assert request(port, "/", (f"Host: 127.0.0.1:{port}",), upgrade=True)[0] == 503
            with pytest.raises(ConnectionClosed):
                while True:
                    one.ping()
                    time.sleep(0.001)
            two.ping().wait(30)
            two.send("a bug in a handler")
            with pytest.raises(ConnectionClosed, match="1011"):
                two.recv(timeout=30)
        idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(30)]
        assert request(port, "/", (f"Host: 127.0.0.1:{port}",), upgrade=True)[0] == 101  # they keep nobody out
        still_open = 0
        for client in idle:
            client.settimeout(0.2)
            try:
                still_open += client.recv(1) != b""
            except TimeoutError:
                still_open += 1
            except ConnectionResetError:
                pass
            client.close()
        assert still_open <= 8
    assert sum("more than 20 messages in a second" in line for line in caplog.messages) == 1
    assert any("connection handler failed: ZeroDivisionError('a bug in a handler')" in line for line in caplog.messages)
    assert all(record.exc_info is None for record in caplog.records)


def test_the_memory_of_departed_clients_is_given_back() -> None:
    with page_server("127.0.0.1", 0) as server:
        gc.collect()
        gc.disable()
        try:
            clients = [open_client(server.get_port()) for _ in range(3)]
            wait_until(lambda: len(server.get_clients()) == 3)
            handles = [weakref.ref(handle) for handle in server.get_clients().values()]
            for client in clients:
                client.close()
            wait_until(lambda: not any(handle() for handle in handles), limit_s=20)
        finally:
            gc.enable()


def test_clients_are_woken_in_the_thread_of_the_server_only(monkeypatch: pytest.MonkeyPatch) -> None:
    woken_in: set[int] = set()
    set_event = asyncio.Event.set
    monkeypatch.setattr(asyncio.Event, "set", lambda event: (woken_in.add(threading.get_ident()), set_event(event))[1])
    with page_server("127.0.0.1", 0) as server, open_client(server.get_port()) as client:
        wait_until(lambda: len(server.get_clients()) == 1)
        text = server.gui.add_text("word", "first")
        received = b""
        text.value = "second"
        while b"second" not in received:
            received += unpack_text(client.recv(timeout=30))
    assert woken_in and threading.get_ident() not in woken_in


def test_twenty_clients_do_not_slow_the_sensor(tmp_path: Path) -> None:
    camera, stop = SkinCamera(period_s=1 / 30), threading.Event()
    with (
        page_server("127.0.0.1", 0) as server,
        SensorPoller(sensor_on(camera)) as loop,
        ThreadPoolExecutor(1) as page_thread,
    ):
        studio = PageController([DisplayedSensor(loop)], tmp_path)
        page = SensorPage(server, studio, gel_block_under_skin(SHAPE, Gel()), "small")
        showing = page_thread.submit(studio.run, page, 15.0, stop.is_set)
        script = Path(__file__).with_name("reading_clients.py")
        address = f"ws://127.0.0.1:{server.get_port()}"
        clients = subprocess.Popen([sys.executable, str(script), address, PROTOCOL, "20", "1"])
        try:
            wait_until(lambda: len(server.get_clients()) == 20)
            lost_shares: list[float] = []
            while len(lost_shares) < 6 and min(lost_shares, default=1.0) >= 0.05:
                lost_shares.append(lost_share(loop, images=60))
        finally:
            clients.kill()
            clients.wait()
            stop.set()
        showing.result(timeout=60)
    assert min(lost_shares) < 0.05, lost_shares


def lost_share(loop: SensorPoller, images: int) -> float:
    """The share of images that arrive and are not read."""

    def count() -> tuple[int, int]:
        reading = loop.snapshot(0).reading
        return (-1 if reading is None else reading.frame.index), loop.sensor.frames_read

    wait_until(lambda: count()[0] >= 0)
    arrived, read = count()
    wait_until(lambda: count()[0] >= arrived + images)
    arrived_later, read_later = count()
    return 1 - (read_later - read) / (arrived_later - arrived)


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

    with page_server("127.0.0.1", 0) as server, http.server.ThreadingHTTPServer(("127.0.0.1", 0), Website) as website:
        port, tab = server.get_port(), browser.new_page()
        threading.Thread(target=website.serve_forever).start()
        try:
            tab.goto(f"http://localhost:{website.server_port}/")
            tab.wait_for_function("document.title != ''", timeout=PATIENCE_S * 1000)
            assert tab.title() == "refused" and not server.get_clients()
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


def test_in_a_browser_the_secret_address_works(browser: Browser, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    guard, tab = SocketGuard.for_host("0.0.0.0"), browser.new_page()
    errors = page_errors(tab)
    with page_server("0.0.0.0", 0, guard) as server:
        text = server.gui.add_text("word", "none yet")
        box = server.gui.add_slider("number", 0, 10, 1, 5)
        tab.goto(f"http://127.0.0.1:{server.get_port()}/{guard.token}/")
        for number in range(2):
            text.value = f"shown {number}"
            shown = f"[...document.querySelectorAll('input')].some(input => input.value == 'shown {number}')"
            tab.wait_for_function(shown, timeout=PATIENCE_S * 1000)
            wait_until(lambda: bool(server.get_clients()), PATIENCE_S)
            slider = tab.get_by_role("slider").first
            slider.focus()
            tab.keyboard.press("ArrowRight")
            wait_until(lambda wanted=6 + number: box.value == wanted, PATIENCE_S, pause_s=0.05)
            tab.reload()
    assert errors == [] and caplog.messages == []


LATE_IMAGE = """() => new Promise(done => {
  const drawing = new Blob(["<svg xmlns='http://www.w3.org/2000/svg'/>"], {type: 'image/svg+xml'});
  const image = new Image(), address = URL.createObjectURL(drawing);
  image.onload = () => done('loaded');
  image.onerror = () => done('lost');
  setTimeout(() => { image.src = address; }, 200);
  URL.revokeObjectURL(address);
})"""
"""A busy browser begins to load an image after viser's page has dropped it for the next one."""


def test_an_image_that_is_replaced_before_it_is_loaded_leaves_no_error_in_the_browser(browser: Browser) -> None:
    tab = browser.new_page()
    errors = page_errors(tab)
    with page_server("127.0.0.1", 0) as server:
        server.gui.add_text("word", "shown")
        tab.goto(f"http://127.0.0.1:{server.get_port()}")
        is_shown = "[...document.querySelectorAll('input')].some(input => input.value == 'shown')"
        tab.wait_for_function(is_shown, timeout=PATIENCE_S * 1000)
        assert tab.evaluate(LATE_IMAGE) == "loaded"
    assert errors == []


def test_a_browser_loads_the_page_anew_where_another_program_serves_it(browser: Browser) -> None:
    tab, port = browser.new_page(), 0
    for number in range(2):
        with page_server("127.0.0.1", port) as server:
            server.gui.add_text("word", f"shown {number}")
            port = server.get_port()
            if number == 0:
                tab.goto(f"http://127.0.0.1:{port}")
            is_shown = f"[...document.querySelectorAll('input')].some(input => input.value == 'shown {number}')"
            tab.wait_for_function(f"!window.isOfEarlierPage && {is_shown}", timeout=PATIENCE_S * 1000)
            tab.evaluate("window.isOfEarlierPage = true")


def test_an_unknown_viser_is_refused_and_never_served(monkeypatch: pytest.MonkeyPatch) -> None:
    pinned = re.search(r'"viser>=1\.1,<1\.2"', (Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert pinned is not None and viser_internals.GUARDED_VISER == "1.1."
    started: list[viser.ViserServer] = []
    real = viser.ViserServer
    monkeypatch.setattr(viser, "ViserServer", lambda **options: started.append(real(**options)) or started[-1])
    with monkeypatch.context() as patch:
        unused = SimpleNamespace(websockets=SimpleNamespace(asyncio=SimpleNamespace(server=SimpleNamespace())))
        patch.setattr(viser_internals, "_wake_clients_in_event_loop", lambda: None)
        patch.setattr(viser_internals, "import_module", lambda name: unused)
        with pytest.raises(UnknownPageServer, match=r"can be guarded, got one that starts it in another way; run pip"):
            page_server("127.0.0.1", 0).__enter__()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", started[0].get_port()), timeout=5)
    monkeypatch.setattr(viser, "__version__", "2.0.0")
    with pytest.raises(
        UnknownPageServer, match=r"expected viser 1\.1\.x, whose web server can be guarded, got 2\.0\.0;"
    ):
        page_server("127.0.0.1", 0).__enter__()
    assert len(started) == 1

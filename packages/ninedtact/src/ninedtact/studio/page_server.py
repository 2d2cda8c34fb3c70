"""The web server of our pages: a guarded front that browsers connect to, and viser behind it, at an address that nobody is told.

    browser ──▶ front (Host, Origin, token, sizes, rates, messages) ──▶ viser on a random address of this computer's loopback

viser 1.1 accepts requests from every website, messages of 50 MB, uploads of any size, and a request to publish the page on the
internet, and offers no hook for who may connect. So the front passes on only what the page needs. What it cannot do is keep another
user of this computer out, who can list its open ports; docs/live_page.md says what is promised.
"""

import asyncio
import errno
import json
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from html import escape
from http.client import HTTPConnection
from secrets import token_urlsafe
from typing import Any

import rich
import viser
from websockets.asyncio.client import ClientConnection, connect
from websockets.asyncio.server import Server, ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from ninedtact.errors import DeviceError
from ninedtact.live.socket_guard import (
    GuardedConnection,
    SocketGuard,
    format_peer,
    hidden_loopback_address,
    one_line_logger,
)
from ninedtact.studio.page_messages import CameraMessage, UploadTest, decode_page_message

DEFAULT_PORT, PORTS_TRIED = 8080, 20
"""First port that is tried where none is named, and the number of ports from there on."""
IN_USE = "it in use (another 'ninedtact live'?)"
_LAST_WORDS_S = 0.1
"""Time to wait for the last messages, because viser drops unsent ones when it stops."""
_INTRODUCED_WITHIN_S = 10.0
_FETCHED_WITHIN_S, _CLOSE_S = 30.0, 0.1
_VISER_PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
"""What a page of this version of viser states when it connects."""
_PASSED_ON = ("Content-Type", "Content-Encoding")


@dataclass
class _Passage:
    """What has been passed from viser to one browser."""

    messages: int = 0


class PageServer:
    """viser with a guarded front. viser: server of viser, to which controls and scene are added. port: of the front."""

    def __init__(self, guard: SocketGuard) -> None:
        """Start viser; browsers reach it after `listen`."""
        rich.get_console().quiet = True  # viser prints a banner with the address that nobody is told
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)  # a viewer has just left
        self._guard, self._address = guard, hidden_loopback_address()
        self.viser, self.port = viser.ViserServer(host=self._address, port=0, label="9DTact", verbose=False), 0
        self._front: Server | None = None
        self._passages: dict[int, _Passage] = {}
        self._introduced: asyncio.Future[int] | None = None
        self._introducing = asyncio.Lock()
        loop = self.viser.get_event_loop()
        loop.call_soon_threadsafe(loop.set_exception_handler, partial(_log_failed_task, one_line_logger()))
        self.viser.on_client_connect(self._note_client)

    def listen(self, host: str, port: int) -> None:
        """Open the front; raises `DeviceError`."""
        try:
            self._front = self._run(self._open_front(host, port))
        except (OSError, OverflowError) as trouble:
            is_taken = isinstance(trouble, OSError) and trouble.errno == errno.EADDRINUSE
            got = IN_USE if is_taken else f"'{getattr(trouble, 'strerror', None) or trouble}'"
            raise DeviceError(
                expected=f"port {port} on {host} to be free for the page",
                got=got,
                remedy="choose another with --port, or a host of this machine with --host",
            ) from trouble
        self.port = next(iter(self._front.sockets)).getsockname()[1]

    def passed_messages(self, client: viser.ClientHandle) -> int:
        """Return the number of messages that viser has sent to a browser and that do not wait on the way any more."""
        passage = self._passages.get(client.client_id)
        return 0 if passage is None else passage.messages

    def close(self) -> None:
        """Send what is left, and end."""
        self.viser.flush()
        time.sleep(_LAST_WORDS_S)
        if self._front is not None:
            self._run(_close(self._front))
        self.viser.stop()

    def _run(self, task: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(task, self.viser.get_event_loop()).result()

    async def _open_front(self, host: str, port: int) -> Server:
        return await self._guard.serve(
            self._connect,
            host,
            port,
            is_expected=lambda message: decode_page_message(message) is not None,
            process_request=self._fetch,
            compression=None,  # viser compresses by itself
            select_subprotocol=_select_viser_protocol,
        )

    async def _fetch(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return a file of viser's page; None for a WebSocket."""
        if request.headers.get("Upgrade") == "websocket":
            return None
        encodings = ", ".join(request.headers.get_all("Accept-Encoding"))

        def fetch() -> Response:
            with closing(HTTPConnection(self._address, self.viser.get_port(), timeout=_FETCHED_WITHIN_S)) as page:
                page.request("GET", request.path, headers={"Accept-Encoding": encodings})
                answer = page.getresponse()
                content = answer.read()
            headers = {name: answer.headers[name] for name in _PASSED_ON if answer.headers[name]}
            headers |= {"Content-Length": str(len(content))}
            return Response(answer.status, answer.reason, Headers(headers), content)

        return await asyncio.to_thread(fetch)

    async def _connect(self, browser: GuardedConnection) -> None:
        """Pass the messages of one browser on to viser, and those of viser to the browser, until one of them ends."""
        if browser.subprotocol != _VISER_PROTOCOL:
            got = (browser.subprotocol or "unknown").removeprefix("viser-v")[:20]
            expected = f"expected a page of viser {viser.__version__}, got {got}; load it again"
            browser.logger.warning("refused %s: %s", format_peer(browser), expected)
            await browser.close(1002, f"Version mismatch. Client: {got}, Server: {viser.__version__}")
            return
        async with connect(
            f"ws://{self._address}:{self.viser.get_port()}",
            subprotocols=[_VISER_PROTOCOL],
            compression=None,
            max_size=None,
            max_queue=1,
            proxy=None,
            ping_interval=None,
            close_timeout=_CLOSE_S,
        ) as page:
            passage = _Passage()
            passing = [
                asyncio.create_task(self._pass_to_page(browser, page, passage)),
                asyncio.create_task(_pass_to_browser(page, browser, passage)),
            ]
            _, running = await asyncio.wait(passing, return_when=asyncio.FIRST_COMPLETED)
            for task in running:
                task.cancel()
            for result in await asyncio.gather(*passing, return_exceptions=True):
                if isinstance(result, Exception) and not isinstance(result, ConnectionClosed):
                    raise result

    async def _pass_to_page(self, browser: GuardedConnection, page: ClientConnection, passage: _Passage) -> None:
        uploads, client_id = UploadTest(), None
        try:
            async for message in browser:
                content = decode_page_message(message)
                if client_id is None and isinstance(content, CameraMessage):
                    client_id = await self._introduce(page, message)
                    self._passages[client_id] = passage
                elif uploads.accepts(content):
                    await page.send(message)
        finally:
            if client_id is not None:
                self._passages.pop(client_id, None)

    async def _introduce(self, page: ClientConnection, message: str | bytes) -> int:
        """Pass the first message of a browser on, one browser at a time, and return the number that viser gives it."""
        async with self._introducing, asyncio.timeout(_INTRODUCED_WITHIN_S):
            self._introduced = asyncio.get_running_loop().create_future()
            await page.send(message)
            return await self._introduced

    async def _note_client(self, client: viser.ClientHandle) -> None:
        if self._introduced is not None and not self._introduced.done():
            self._introduced.set_result(client.client_id)


async def _pass_to_browser(page: ClientConnection, browser: GuardedConnection, passage: _Passage) -> None:
    async for message in page:
        await browser.send(message)
        passage.messages += 1


async def _close(front: Server) -> None:
    front.close()
    await front.wait_closed()


def _select_viser_protocol(connection: ServerConnection, offered: "list[Subprotocol]") -> Subprotocol | None:
    """Return the version that a page states, which is refused later, so that the page can say why."""
    return next((each for each in offered if each.startswith("viser-v")), None)


def _log_failed_task(logger: Any, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    logger.warning("%s", context["message"], exc_info=context.get("exception"))


def standalone_scene_html(draw: Callable[[viser.ViserServer], None]) -> str:
    """Return what is drawn in the scene of a new server as a page without a server."""
    server = PageServer(SocketGuard.for_host("127.0.0.1"))
    try:
        draw(server.viser)
        return server.viser.scene.as_html()
    finally:
        server.close()


@contextmanager
def page_server(host: str, port: int | None, guard: SocketGuard | None = None) -> Iterator[PageServer]:
    """Serve until the `with` block ends; raises `DeviceError`.

    port: 0 takes any free port, None the default one or the next that is free. guard: the rules by which requests are accepted;
    without it those of the host, without further allowed origins.
    """
    server = PageServer(guard or SocketGuard.for_host(host))
    try:
        _listen_on_free_port(server, host) if port is None else server.listen(host, port)
        run_in_browsers(server, _PAGE_SCRIPT.replace("PROGRAM", json.dumps(token_urlsafe())))
        yield server
    finally:
        server.close()


def _listen_on_free_port(server: PageServer, host: str) -> None:
    """Listen at the default port, or the next free one; raises `DeviceError` where all that are tried are in use."""
    for port in range(DEFAULT_PORT, DEFAULT_PORT + PORTS_TRIED):
        try:
            server.listen(host, port)
            return
        except DeviceError as refusal:
            if IN_USE not in str(refusal) or port == DEFAULT_PORT + PORTS_TRIED - 1:
                raise


_PAGE_SCRIPT = """
if (!window.pageProgram) {
  window.pageProgram = PROGRAM;
  const drop = window.URL.revokeObjectURL.bind(window.URL);
  window.URL.revokeObjectURL = (address) => setTimeout(() => drop(address), 5000);
} else if (window.pageProgram !== PROGRAM) location.reload();
"""
"""Corrects two errors of the page of viser 1.1.

The page drops the data of an image at once when another one replaces it. Where the browser has not yet loaded it, the browser
reports a missing file (ERR_FILE_NOT_FOUND) and shows no image until the next one. So the data are kept for five seconds.

A browser that was connected to an earlier program at the same address connects to this one with the layout of the earlier page. So
it loads the page again.
"""
_PAGE_ICON = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'%3E%3Crect width='32' height='32' rx='7' "
    "fill='%2308306b'/%3E%3Cpath d='M3 12h6c3 0 3 9 7 9s4-9 7-9h6' fill='none' stroke='%23f7f7f7' stroke-width='3'/%3E%3C/svg%3E"
)
"""A dent in the skin."""


def prepare_page(server: PageServer, title: str) -> None:
    """Give a page its title, in the tab of the browser with an icon, and nothing of viser's own."""
    server.viser.gui.configure_theme(show_logo=False, show_share_button=False)
    server.viser.gui.set_panel_label(title)
    script = (
        f"document.title = {json.dumps(f'{title} · 9DTact')}; const icon = document.querySelector('link[rel~=icon]') || "
        f"document.head.appendChild(document.createElement('link')); icon.rel = 'icon'; icon.href = {json.dumps(_PAGE_ICON)};"
    )
    run_in_browsers(server, script)


def run_in_browsers(server: PageServer, script: str) -> None:
    """Run a script in every browser that is connected or connects later: as what an image that cannot be loaded does."""
    server.viser.gui.add_html(f'<img hidden src="data:," onerror="{escape(script)}">')


def draw_unless_interrupted(draw: Callable[[], None]) -> None:
    """Draw something, again where viser fails in between.

    viser 1.1 wakes the senders to its clients in the thread that changes the page too, which asyncio does not allow: once in many
    hours with many clients that thread gets "deque mutated during iteration". What it has changed by then is kept.
    """
    for _ in range(3):
        try:
            draw()
            return
        except RuntimeError as trouble:
            if "mutated during iteration" not in str(trouble):
                raise

"""The web server of our pages: a guarded front that browsers connect to, and viser behind it, at an address that nobody is told.

    browser ──▶ front (Host, Origin, token, sizes, rates, messages) ──▶ viser on a random address of this computer's loopback

viser 1.1 accepts requests from every website, messages of 50 MB, uploads of any size, and a request to publish the page on the
internet, and offers no hook for who may connect. So the front passes on only what the page needs. What it cannot do is keep another
user of this computer out, who can list its open ports; docs/live_page.md says what is promised.
"""

import asyncio
import errno
import json
import re
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from html import escape
from http.client import HTTPConnection
from importlib.resources import files
from secrets import token_urlsafe
from typing import Any

import rich
import viser
from websockets.asyncio.client import ClientConnection
from websockets.asyncio.server import Server, ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from ninedtact.live.server_log import one_line_logger
from ninedtact.live.socket_guard import (
    GuardedConnection,
    SocketGuard,
    format_peer,
    hidden_loopback_address,
    network_port_errors,
    relay,
)
from ninedtact.studio.accepted_page_messages import CameraMessage, OneUploadPerClient, decode_page_message

DEFAULT_PORTS = range(8080, 8100)
"""Ports that are tried one after the other where none is named."""
_LAST_WORDS_S = 0.1
"""Time to wait for the last messages, because viser drops unsent ones when it stops."""
_INTRODUCED_WITHIN_S = 10.0
_READY_WITHIN_S = 30.0
"""Time that a browser needs to draw the page at first, after which it sends its view, and to load a moment at 50 kB/s."""
_FETCHED_WITHIN_S = 30.0
_VISER_PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
"""What a page of this version of viser states when it connects."""
_DROPPED = "dropped a message of %d bytes of %s that the page does not expect; further ones are dropped silently"
_SILENT_S = 3
"""Time without news after which a browser says so: longer than between two moments of a slow one."""
_DRAWN = "/drawn/"
"""Begins the path with which a browser tells what it has drawn."""
_PASSED_ON = ("Content-Type", "Content-Encoding")


class DrawnMoments:
    """The last moment that each browser has drawn, which the script of the page tells the front with a request.

    The network answers for a browser that is too slow to draw what arrives, so that what has been received tells nothing.
    """

    def __init__(self) -> None:
        self._last: dict[str, int] = {}

    def begin(self) -> str:
        """Return a name for one more browser, which nobody guesses."""
        name = token_urlsafe()
        self._last[name] = 0
        return name

    def end(self, name: str) -> None:
        """Forget a browser that has left."""
        self._last.pop(name, None)

    def last(self, name: str) -> int:
        """Return the number of the last moment that a browser has drawn; 0 for one that has not told any, as a program does."""
        return self._last.get(name, 0)

    def note(self, mark: str) -> None:
        """Note what a browser tells: its name and the number of a moment."""
        name, _, number = mark.partition("/")
        if name in self._last and re.fullmatch("[0-9]{1,15}", number):
            self._last[name] = max(self._last[name], int(number))


class PageServer:
    """viser with a guarded front. viser: server of viser, to which controls and scene are added. port: of the front."""

    def __init__(self, guard: SocketGuard) -> None:
        """Start viser; browsers reach it after `listen`."""
        rich.get_console().quiet = True  # viser prints a banner with the address that nobody is told
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)  # a viewer has just left
        limits = replace(guard.limits, speaks_within_s=_READY_WITHIN_S, send_timeout_s=_READY_WITHIN_S)
        self._guard, self._address = replace(guard, limits=limits), hidden_loopback_address()
        self.viser, self.port = viser.ViserServer(host=self._address, port=0, label="9DTact", verbose=False), 0
        self.drawn_moments = DrawnMoments()
        self._front: Server | None = None
        self._browsers: dict[int, GuardedConnection] = {}
        self._introduced: asyncio.Future[int] | None = None
        self._introducing = asyncio.Lock()
        loop = self.viser.get_event_loop()
        loop.call_soon_threadsafe(loop.set_exception_handler, partial(_log_failed_task, one_line_logger()))
        self.viser.on_client_connect(self._note_client)

    def listen(self, ports: Sequence[int]) -> None:
        """Open the front at the first of these ports that is free; raises `DeviceError`."""
        with network_port_errors(self._guard.host, ports[-1], "the page"):
            for port in ports:
                try:
                    self._front = self._run(self._open_front(port))
                    break
                except OSError as trouble:
                    if trouble.errno != errno.EADDRINUSE or port == ports[-1]:
                        raise
        assert self._front is not None
        self.port = next(iter(self._front.sockets)).getsockname()[1]

    def passed_messages(self, client: viser.ClientHandle) -> int:
        """Return the number of messages that viser has sent to a browser and that do not wait on the way any more."""
        browser = self._browsers.get(client.client_id)
        return 0 if browser is None else browser.sent

    def close(self) -> None:
        """Send what is left, and end."""
        self.viser.flush()
        time.sleep(_LAST_WORDS_S)
        if self._front is not None:
            self._run(_close(self._front))
        self.viser.stop()

    def _run(self, task: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(task, self.viser.get_event_loop()).result()

    async def _open_front(self, port: int) -> Server:
        return await self._guard.serve(
            self._connect,
            port,
            self._fetch,
            compression=None,  # viser compresses by itself
            select_subprotocol=_select_viser_protocol,
        )

    async def _fetch(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return a file of viser's page, or note a moment that a browser has drawn; None for a WebSocket."""
        if request.headers.get("Upgrade") == "websocket":
            return None
        if request.path.startswith(_DRAWN):
            self.drawn_moments.note(request.path.removeprefix(_DRAWN))
            return Response(204, "No Content", Headers({"Content-Length": "0"}))
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
        if browser.subprotocol != _VISER_PROTOCOL:
            got = (browser.subprotocol or "unknown").removeprefix("viser-v")[:20]
            expected = f"expected a page of viser {viser.__version__}, got {got}; load it again"
            browser.logger.warning("refused %s: %s", format_peer(browser), expected)
            await browser.close(1002, f"Version mismatch. Client: {got}, Server: {viser.__version__}")
            return
        address = f"ws://{self._address}:{self.viser.get_port()}"
        await relay(browser, address, _VISER_PROTOCOL, partial(self._pass_to_page, browser))

    async def _pass_to_page(self, browser: GuardedConnection, page: ClientConnection) -> None:
        uploads, client_id, has_dropped = OneUploadPerClient(), None, False
        try:
            async for message in browser:
                content = decode_page_message(message)
                if content is None:
                    if not has_dropped:
                        browser.logger.warning(_DROPPED, len(message), format_peer(browser))
                    has_dropped = True
                elif client_id is None and isinstance(content, CameraMessage):
                    client_id = await self._introduce(page, message)
                    self._browsers[client_id] = browser
                elif uploads.accepts(content):
                    await page.send(message)
        finally:
            if client_id is not None:
                self._browsers.pop(client_id, None)

    async def _introduce(self, page: ClientConnection, message: str | bytes) -> int:
        """Pass the first message of a browser on, one browser at a time, and return the number that viser gives it."""
        async with self._introducing, asyncio.timeout(_INTRODUCED_WITHIN_S):
            self._introduced = asyncio.get_running_loop().create_future()
            await page.send(message)
            return await self._introduced

    async def _note_client(self, client: viser.ClientHandle) -> None:
        if self._introduced is not None and not self._introduced.done():
            self._introduced.set_result(client.client_id)


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
def page_server(guard: SocketGuard, port: int | None = 0) -> Iterator[PageServer]:
    """Serve until the `with` block ends; raises `DeviceError`.

    port: 0 takes any free port, None the first of `DEFAULT_PORTS` that is free.
    """
    server = PageServer(guard)
    try:
        server.listen(DEFAULT_PORTS if port is None else [port])
        run_in_browsers(
            server, _PAGE_SCRIPT.replace("PROGRAM", json.dumps(token_urlsafe())).replace("SILENT_S", str(_SILENT_S))
        )
        yield server
    finally:
        server.close()


_STYLE = files("ninedtact.studio").joinpath("page_style.css")
_PAGE_SCRIPT = """
if (!window.pageProgram) {
  window.pageProgram = PROGRAM;
  const drop = window.URL.revokeObjectURL.bind(window.URL);
  window.URL.revokeObjectURL = (address) => setTimeout(() => drop(address), 5000);
  const painted = () => new Promise(requestAnimationFrame);
  let told = '', heardAt = Date.now();
  const tell = async () => {
    const moment = document.querySelector('[data-moment]')?.dataset.moment;
    if (!moment || moment === told) return;
    told = moment;
    heardAt = Date.now();
    if (moment.startsWith('/')) return;
    await Promise.all([...document.images].filter((image) => !image.complete).map((image) => image.decode().catch(() => 0)));
    await painted();
    fetch(location.pathname.replace(/\\/?$/, '/drawn/') + moment, {cache: 'no-store'}).catch(() => 0);
  };
  new MutationObserver(tell).observe(document.body, {subtree: true, childList: true});
  setInterval(() => {
    const silent_s = Math.round((Date.now() - heardAt) / 1000);
    document.body.toggleAttribute('data-silent', told !== '' && silent_s > SILENT_S);
    document.body.style.setProperty('--silence', `"no news for ${silent_s} s: the program or the network does not answer"`);
  }, 500);
  const isOfGraphics = (notice) => /Software WebGL/.test(notice.querySelector('.mantine-Notification-title')?.innerText);
  setInterval(() => [...document.querySelectorAll('.mantine-Notification-root')].filter(isOfGraphics).forEach((notice) => {
    notice.seen = (notice.seen || 0) + 1;
    if (notice.seen > 8 || innerWidth <= 600) notice.querySelector('button')?.click();
  }), 1000);
} else if (window.pageProgram !== PROGRAM) location.reload();
"""
"""Tells which moment has been drawn, says where none has come for a while, and corrects three errors of the page of viser 1.1.

The page drops the data of an image at once when another one replaces it. Where the browser has not yet loaded it, the browser
reports a missing file (ERR_FILE_NOT_FOUND) and shows no image until the next one. So the data are kept for five seconds.

Its notice that there is no graphics card stays until it is closed by hand, so it is closed after 8 seconds, and on a phone, where
it covers what is used, after one.

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
    server.viser.gui.add_html(f"<style>{_STYLE.read_text()}</style>")
    server.viser.gui.set_panel_label(title)
    script = (
        f"document.title = {json.dumps(f'{title} · 9DTact')}; const icon = document.querySelector('link[rel~=icon]') || "
        f"document.head.appendChild(document.createElement('link')); icon.rel = 'icon'; icon.href = {json.dumps(_PAGE_ICON)};"
    )
    run_in_browsers(server, script)


def run_in_browsers(server: PageServer, script: str) -> None:
    """Run a script in every browser that is connected or connects later: as what an image that cannot be loaded does."""
    server.viser.gui.add_html(f'<img hidden src="data:," onerror="{escape(script)}">')


def moment_mark(number: int, browser: str = "") -> str:
    """Return HTML that names a moment for the script of the page: a browser that is named tells when it has drawn it."""
    return f'<i hidden data-moment="{browser}/{number}"></i>'


def draw_with_retry(draw: Callable[[], None]) -> None:
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

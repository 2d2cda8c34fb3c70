"""What relies on parts of viser that it does not document: another version of viser means changes here and in `page_messages`.

`start_guarded_viser` is the one place where its web server starts. viser 1.1 accepts requests from every website, messages of
50 MB, uploads of any size, and a request to publish the page on the internet; a message that it cannot decode ends in a traceback.
It offers no hook, but its server starts with one call of `websockets.serve`, which is replaced by `SocketGuard.serve`. An error of
viser with many clients and one of its page with images that change fast are corrected, and one upload of each client is kept. What
fails in a callback of the page, which viser prints with its traceback, is a line of the log.

The functions below it do what viser 1.1 has no function for, or what its functions do too slowly for many viewers.
"""

import asyncio
import json
import logging
import warnings
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from functools import partial, wraps
from importlib import import_module
from io import StringIO
from secrets import token_urlsafe
from threading import Lock
from types import SimpleNamespace
from typing import Any

import viser
from numpy import ndarray as Array
from viser._messages import GuiSliderMark, RunJavascriptMessage
from viser.infra import WebsockMessageHandler
from websockets.asyncio.server import ServerConnection, serve

from ninedtact._version import installation_command
from ninedtact.errors import MissingLibraryError
from ninedtact.studio.page_messages import has_no_effect, is_page_message
from ninedtact.studio.socket_guard import SocketGuard, format_peer, one_line_logger

GUARDED_VISER = "1.1."
"""Beginning of the versions of viser whose server can be guarded; pyproject.toml pins the same."""


_IMAGE_KEPT_MS = 5000
"""Time for which a browser keeps an image that another one has replaced; a busy browser begins to load it that late."""
ConnectionHandler = Callable[[ServerConnection], Awaitable[None]]


class UnknownPageServer(MissingLibraryError):
    """Raised where the installed version of viser cannot be guarded."""


_replacing = Lock()


def start_guarded_viser(guard: SocketGuard, host: str, port: int, label: str) -> viser.ViserServer:
    """Start viser under a guard, without the banner that it prints; raises `UnknownPageServer`."""
    require_known_viser()
    _wake_clients_in_event_loop()
    _keep_one_upload_of_each_client()
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)  # a viewer that has just left
    ports, servers, logger = [], list[viser.ViserServer](), one_line_logger()
    find_control = partial(_find_control, servers)

    def guarded_serve(handler: Any, host: str, port: int, **options: Any) -> serve:
        ports.append(port)
        asyncio.get_running_loop().set_exception_handler(partial(_log_failed_task, logger))
        options |= {
            "is_expected": partial(is_page_message, find_control=find_control),
            "is_ignored": partial(has_no_effect, find_control=find_control),
            "logger": logger,
        }
        return guard.serve(partial(_handle_same_version, handler), host, port, **options)

    with _replace_serve(guarded_serve), redirect_stdout(StringIO()):
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
        if not ports:
            server.stop()
            raise UnknownPageServer(_unknown_viser_message("one that starts it in another way"))
    servers.append(server)
    _log_failed_callbacks(server, logger)
    _prepare_browsers(server)
    return server


def _prepare_browsers(server: viser.ViserServer) -> None:
    """Correct two errors of the page of viser 1.1, in every browser that connects.

    The page drops the data of an image at once when another one replaces it. Where the browser has not yet loaded it, the browser
    reports a missing file (ERR_FILE_NOT_FOUND) and shows no image until the next one. So the data are kept for a while.

    A browser that was connected to an earlier program at the same address connects to this one with the layout of the earlier page.
    So it loads the page again.
    """
    program = json.dumps(token_urlsafe())
    source = (
        f"if (!window.pageProgram) {{ window.pageProgram = {program}; const drop = URL.revokeObjectURL.bind(URL); "
        f"URL.revokeObjectURL = (address) => setTimeout(() => drop(address), {_IMAGE_KEPT_MS}); }} "
        f"else if (window.pageProgram !== {program}) location.reload();"
    )
    _run_in_browsers(server, source)


def _run_in_browsers(server: viser.ViserServer, javascript: str) -> None:
    """Run a script in every browser that is connected, and in every one that connects later."""
    server._websock_server.queue_message(RunJavascriptMessage(javascript))


@contextmanager
def _replace_serve(guarded_serve: Callable[..., serve]) -> Iterator[None]:
    """Let viser, and nothing else, find another `websockets.asyncio.server.serve`."""
    viser_internals: Any = import_module("viser.infra._infra")
    with _replacing:
        library = viser_internals.websockets
        server = SimpleNamespace(**vars(library.asyncio.server) | {"serve": guarded_serve})
        viser_internals.websockets = SimpleNamespace(**vars(library) | {"asyncio": SimpleNamespace(server=server)})
        try:
            yield
        finally:
            viser_internals.websockets = library


class _LoopEvent(asyncio.Event):
    """An event that is set in the thread of its event loop only, as asyncio requires."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._own_loop = loop

    def set(self) -> None:
        """Wake all that wait; do nothing in another thread, because viser requests it of the event loop as well."""
        with suppress(RuntimeError):
            if asyncio.get_running_loop() is self._own_loop:
                super().set()


def _wake_clients_in_event_loop() -> None:
    """Correct viser 1.1, which wakes the senders to its clients in the thread that changes the page too.

    With many clients that thread then ends with "deque mutated during iteration" after seconds to minutes.
    """
    message_buffer: Any = import_module("viser.infra._async_message_buffer").AsyncMessageBuffer
    initialise = message_buffer.__init__
    if hasattr(initialise, "__wrapped__"):
        return

    @wraps(initialise)
    def initialise_with_loop_event(
        self: Any, event_loop: asyncio.AbstractEventLoop, *args: Any, **options: Any
    ) -> None:
        initialise(self, event_loop, *args, **options)
        self.message_event = _LoopEvent(event_loop)

    message_buffer.__init__ = initialise_with_loop_event


def _keep_one_upload_of_each_client() -> None:
    """Let viser forget an unfinished upload when the same client begins another, so that a client costs one file of memory."""
    gui_api: Any = viser.GuiApi
    start = gui_api._handle_file_transfer_start
    if hasattr(start, "__wrapped__"):
        return

    @wraps(start)
    def start_alone(self: Any, client_id: Any, message: Any) -> None:
        self._drop_uploads_from_client(client_id)
        start(self, client_id, message)

    gui_api._handle_file_transfer_start = start_alone


def require_known_viser() -> None:
    """Refuse versions of viser whose server the guard does not know; raises `UnknownPageServer`."""
    if not viser.__version__.startswith(GUARDED_VISER):
        raise UnknownPageServer(_unknown_viser_message(viser.__version__))


def _unknown_viser_message(got: str) -> str:
    """Return the sentence about a version of viser that cannot be guarded."""
    return f"expected viser {GUARDED_VISER}x, whose web server can be guarded, got {got}; run {installation_command('studio')}"


async def _handle_same_version(handler: ConnectionHandler, connection: ServerConnection) -> None:
    """Handle a connection of the page of this version of viser; end any other, with the reason that the page shows.

    viser does so too, with two lines on the terminal each time.
    """
    got = (connection.subprotocol or "unknown").removeprefix("viser-v")[:20]
    if got == viser.__version__:
        await handler(connection)
        return
    expected = f"expected a page of viser {viser.__version__}, got {got}; load it again"
    connection.logger.warning("refused %s: %s", format_peer(connection), expected)
    await connection.close(1002, f"Version mismatch. Client: {got}, Server: {viser.__version__}")


def _find_control(servers: Iterable[viser.ViserServer], uuid: str) -> Any:
    """Return the control of a uuid, which all browsers share or one has; None where there is none."""
    for server in servers:
        for gui in (server.gui, *(client.gui for client in server.get_clients().values())):
            if uuid in gui._gui_input_handle_from_uuid:
                return gui._gui_input_handle_from_uuid.get(uuid)
    return None


def _log_failed_task(logger: logging.Logger, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log what went wrong in a task of viser."""
    logger.warning("%s", context["message"], exc_info=context.get("exception"))


def _log_failed_callbacks(server: viser.ViserServer, logger: logging.Logger) -> None:
    """Log what goes wrong in what controls do."""
    executor: Any = server._thread_executor

    def run(callback: Callable[..., Any], *args: Any) -> None:
        try:
            callback(*args)
        except Exception:
            logger.warning("a control of the page failed", exc_info=True)

    executor.submit = partial(executor.submit, run)


_PAGE_ICON = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'%3E%3Crect width='32' height='32' rx='7' "
    "fill='%2308306b'/%3E%3Cpath d='M3 12h6c3 0 3 9 7 9s4-9 7-9h6' fill='none' stroke='%23f7f7f7' stroke-width='3'/%3E%3C/svg%3E"
)
"""A dent in the skin."""


def set_title_and_icon(server: viser.ViserServer, title: str) -> None:
    """Name the tab of the browser, and give it an icon."""
    source = (
        f"document.title = {json.dumps(title)}; let icon = document.querySelector('link[rel~=icon]') || "
        f"document.head.appendChild(document.createElement('link')); icon.rel = 'icon'; icon.href = {json.dumps(_PAGE_ICON)};"
    )
    _run_in_browsers(server, source)


NARROW_PX = 600
"""Width of a browser below which it is a phone: viser then shows its panel at the bottom."""
PHONE_STYLE = (
    f"<style>@media (max-width: {NARROW_PX}px) {{ [style*='max-height: 60%'], [style*='max-height: 60%'] [style*='width: 20em'] "
    "{ width: 100% !important; } }</style>"
)
"""Lets the controls be as wide as the screen of a phone, of which viser gives them a part."""
TALL_PHONE_STYLE = (
    f"<style>@media (max-width: {NARROW_PX}px) {{ [style*='max-height: 60%'] "
    "{ max-height: 100% !important; } }</style>"
)
"""Lets the controls fill the screen of a phone; there is nothing behind them."""


def has_unsent_messages(client: viser.ClientHandle) -> bool:
    """Return whether messages of earlier moments still wait to be sent to a client."""
    return bool(client._websock_connection.get_message_buffer().message_from_id)


def show_encoded_image(image: viser.GuiImageHandle, jpeg: bytes) -> None:
    """Show an image that was encoded once for all viewers; viser itself would encode it for every viewer anew."""
    image._data = jpeg


def set_slider_marks(slider: viser.GuiSliderHandle[float], marks: Iterable[tuple[float, str | None]]) -> None:
    """Mark values of a slider, with texts or without; viser 1.1 takes marks only when a slider is made."""
    slider._marks = tuple(GuiSliderMark(value, text) for value, text in marks)


def send_arrays(node: viser.MeshHandle | viser.PointCloudHandle, **arrays: Array) -> None:
    """Send the arrays of a node that are others than before; they may not change later.

    viser itself would convert, compare and copy them for every viewer, which costs more than to compute them.
    """
    for name, array in arrays.items():
        if getattr(node, name) is not array:
            setattr(node._impl.props, name, array)
            node._queue_update(name, array)


class _NoBuffer:
    """Takes messages that nobody is sent."""

    def push(self, message: object) -> None: ...
    def atomic_start(self) -> None: ...
    def atomic_end(self) -> None: ...


class _DetachedConnection(WebsockMessageHandler):
    """Stands in for the connection of a browser, so that a scene can be recorded that nobody sees."""

    def get_message_buffer(self) -> Any:
        """Return a buffer that keeps nothing."""
        return _NoBuffer()


class _DetachedOwner:
    """Stands in for a browser as the owner of a scene."""

    def __init__(self, server: viser.ViserServer) -> None:
        self.client_id, self._viser_server, self._websock_connection = 0, server, _DetachedConnection()


def standalone_scene_html(server: viser.ViserServer, draw: Callable[[viser.SceneApi], None]) -> str:
    """Return a scene as a page of viser without a server, with the light, camera and background that a new viewer gets."""
    owner: Any = _DetachedOwner(server)
    serializer = owner._websock_connection.get_message_serializer(
        lambda message: message.include_in_scene_serialization
    )
    shared = server._websock_server._broadcast_buffer
    with shared.buffer_lock:
        messages = list(shared.message_from_id.values())
    for message in messages:
        serializer._insert_message(message)
    draw(viser.SceneApi(owner, server._thread_executor, server._event_loop))
    return str(serializer.as_html())

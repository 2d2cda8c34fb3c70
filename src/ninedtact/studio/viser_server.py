"""The guard of viser's web server: which messages it gets, and the one place where it starts.

viser 1.1 accepts requests from every website, messages of 50 MB, uploads of any size, and a request to publish the page on the
internet; a message that it cannot decode ends in a traceback. It offers no hook, but its server starts with one call of
`websockets.serve`, which `start_guarded_viser` replaces by `SocketGuard.serve`. It also corrects an error of viser with many
clients and one of its page with images that change fast, and keeps one upload of each client at a time.
"""

import asyncio
import json
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from functools import wraps
from importlib import import_module
from io import StringIO
from secrets import token_urlsafe
from threading import Lock
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import msgspec
import viser
from viser._messages import RunJavascriptMessage
from websockets.asyncio.server import serve

from ninedtact._version import installation_command
from ninedtact.errors import MissingLibraryError
from ninedtact.studio.socket_guard import SocketGuard

_LOG = logging.getLogger(__name__)
GUARDED_VISER = "1.1."
"""Beginning of the versions of viser whose server can be guarded; pyproject.toml pins the same."""


_IMAGE_KEPT_MS = 5000
"""Time for which a browser keeps an image that another one has replaced; a busy browser begins to load it that late."""


class UnknownPageServer(MissingLibraryError):
    """Raised where the installed version of viser cannot be guarded."""


_Number = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_ShortText = Annotated[str, msgspec.Meta(max_length=200)]
_Vector = tuple[_Number, _Number, _Number]
_Pair = Annotated[list[_Number], msgspec.Meta(min_length=2, max_length=2)]
"""A list, because msgspec mistakes the limits of numbers in a union with a tuple of fixed length."""
_Quaternion = tuple[_Number, _Number, _Number, _Number]
MAX_UPLOAD_BYTES = 16_000_000
PART_BYTES = 512 * 1024
"""Size of the parts in which viser's page sends a file."""
_UploadSize = Annotated[int, msgspec.Meta(ge=0, le=MAX_UPLOAD_BYTES)]
_PartNumber = Annotated[int, msgspec.Meta(ge=0, le=MAX_UPLOAD_BYTES // PART_BYTES + 1)]
_Part = Annotated[bytes, msgspec.Meta(max_length=PART_BYTES)]


class _CameraMessage(msgspec.Struct, tag_field="type", tag="ViewerCameraMessage", forbid_unknown_fields=True):
    """The pose of a browser's view, which viser's page sends."""

    wxyz: _Quaternion
    position: _Vector
    fov: _Number
    near: _Number
    far: _Number
    image_height: _Number
    image_width: _Number
    look_at: _Vector
    up_direction: _Vector


class _ControlMessage(msgspec.Struct, tag_field="type", tag="GuiUpdateMessage", forbid_unknown_fields=True):
    """The new value of a button, a choice, a slider or a pair of numbers. viser would set any other attribute of it too."""

    uuid: _ShortText
    updates: Annotated[dict[Literal["value"], bool | _Number | _ShortText | _Pair], msgspec.Meta(min_length=1)]


class _CommandMessage(msgspec.Struct, tag_field="type", tag="CommandTriggerMessage", forbid_unknown_fields=True):
    """A key that stands for a command, or a command that was chosen."""

    uuid: _ShortText


class _ClickMessage(msgspec.Struct, tag_field="type", tag="ScenePointerMessage", forbid_unknown_fields=True):
    """A click on the scene in 3D."""

    event_type: Literal["click"]
    ray_origin: _Vector
    ray_direction: _Vector
    screen_pos: Annotated[list[tuple[_Number, _Number]], msgspec.Meta(max_length=2)]
    modifier: _ShortText | None


class _HandleMessage(
    msgspec.Struct, tag_field="type", tag="TransformControlsUpdateMessage", forbid_unknown_fields=True
):
    """The pose of the 3D handle."""

    name: _ShortText
    wxyz: _Quaternion
    position: _Vector
    owner: _ShortText = ""


class _HandleStartMessage(
    msgspec.Struct, tag_field="type", tag="TransformControlsDragStartMessage", forbid_unknown_fields=True
):
    """The 3D handle is grasped."""

    name: _ShortText
    owner: _ShortText = ""


class _HandleEndMessage(
    msgspec.Struct, tag_field="type", tag="TransformControlsDragEndMessage", forbid_unknown_fields=True
):
    """The 3D handle is let go."""

    name: _ShortText
    owner: _ShortText = ""


class _UploadMessage(msgspec.Struct, tag_field="type", tag="FileTransferStartUpload", forbid_unknown_fields=True):
    """A file will follow in parts."""

    source_component_uuid: _ShortText
    transfer_uuid: _ShortText
    filename: _ShortText
    mime_type: _ShortText
    part_count: _PartNumber
    size_bytes: _UploadSize


class _PartMessage(msgspec.Struct, tag_field="type", tag="FileTransferPart", forbid_unknown_fields=True):
    """One part of a file."""

    source_component_uuid: _ShortText
    transfer_uuid: _ShortText
    part_index: _PartNumber
    content: _Part


class _KeptMessage(
    msgspec.Struct, tag_field="type", tag="LocalStorageGetItemResponseMessage", forbid_unknown_fields=True
):
    """What the browser has kept for the page: its theme."""

    value: _ShortText | None
    error: _ShortText | None
    request_uuid: _ShortText


_PAGE_MESSAGES = msgspec.msgpack.Decoder(
    _CameraMessage
    | _ControlMessage
    | _CommandMessage
    | _ClickMessage
    | _HandleMessage
    | _HandleStartMessage
    | _HandleEndMessage
    | _UploadMessage
    | _PartMessage
    | _KeptMessage
)


def is_page_message(message: str | bytes) -> bool:
    """Return whether a message is one that the controls of the page send.

    viser has more, which the page has no use for, such as a request to publish the page on the internet.
    """
    try:
        _PAGE_MESSAGES.decode(message if isinstance(message, bytes) else b"")
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
        return False
    return True


_replacing = Lock()


def start_guarded_viser(guard: SocketGuard, host: str, port: int, label: str) -> viser.ViserServer:
    """Start viser under a guard, without the banner that it prints; raises `UnknownPageServer`."""
    require_known_viser()
    _wake_clients_in_event_loop()
    _keep_one_upload_of_each_client()
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)  # a viewer that has just left
    ports = []

    def guarded_serve(handler: Any, host: str, port: int, **options: Any) -> serve:
        ports.append(port)
        asyncio.get_running_loop().set_exception_handler(_log_in_one_line)
        return guard.serve(handler, host, port, is_expected=is_page_message, **options)

    with _replace_serve(guarded_serve), redirect_stdout(StringIO()):
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
        if not ports:
            server.stop()
            raise UnknownPageServer(_unknown_viser_message("one that starts it in another way"))
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
    server._websock_server.queue_message(RunJavascriptMessage(source))


@contextmanager
def _replace_serve(guarded_serve: Callable[..., serve]) -> Iterator[None]:
    """Let viser, and nothing else, find another `websockets.asyncio.server.serve`."""
    viser_server: Any = import_module("viser.infra._infra")
    with _replacing:
        library = viser_server.websockets
        server = SimpleNamespace(**vars(library.asyncio.server) | {"serve": guarded_serve})
        viser_server.websockets = SimpleNamespace(**vars(library) | {"asyncio": SimpleNamespace(server=server)})
        try:
            yield
        finally:
            viser_server.websockets = library


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


def _log_in_one_line(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log what went wrong in a task of viser, without its traceback."""
    _LOG.warning("%s: %r", context["message"], context.get("exception"))

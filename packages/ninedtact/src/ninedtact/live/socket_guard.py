"""The guard of web servers of readings: who may connect, what clients may send, and how much they may cost.

Browsers let every website send requests to servers on the same computer and network. So each request must name a host (`Host`)
and, where the browser states it, a website (`Origin`) that belong to the server; the first closes DNS rebinding, the second
cross-site WebSockets. On a network the path must also begin with the random token of the printed address.

`SocketGuard.serve` takes the place of `websockets.serve`. The live page is served by viser behind such a server.
"""

import asyncio
import ctypes
import gc
import hmac
import logging
import re
import socket
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from http import HTTPStatus
from inspect import isawaitable
from ipaddress import ip_address
from pathlib import Path
from secrets import randbelow, token_urlsafe
from traceback import extract_tb
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response
from websockets.protocol import State

from ninedtact.errors import InputError

_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
_TOKEN_BYTES = 16
_FILES_ORIGIN = "file://"
"""What desktop programs that are made of pages state as their website. Browsers state null for pages in files."""
_NO_ORIGIN = (
    "expected Origin to name the page, got null, which browsers state for a page in a file; serve the page from its folder, "
    "python -m http.server 5500, open http://localhost:5500, and start this program with --allow-origin http://localhost:5500"
)
_RELEASE_AFTER_S = 1.0
"""Time from the departure of a client to the release of its memory, so that a crowd that leaves is one release."""
_CLOSE_S = 1.0
"""Time for a client to answer the end of its connection."""
_OPENING_PER_CLIENT = 4
"""Connections without a finished handshake for each client that may be connected; a browser opens a few in advance."""

MessageTest = Callable[[str | bytes], bool]
RequestHandler = Callable[[ServerConnection, Request], Response | Awaitable[Response | None] | None]


@dataclass(frozen=True)
class SocketLimits:
    """What one server accepts."""

    message_bytes: int = 600 * 1024
    """Largest message of a client: one part of an uploaded file. A message of the page's controls has some 200 bytes."""
    messages_per_s: int = 500
    """Messages, pings and fragments per second above which a client is disconnected; a moved mouse makes 50."""
    clients: int = 32
    """Most clients at a time."""
    send_timeout_s: float = 10.0
    """Time after which a client that does not read what it is sent is disconnected."""
    acknowledged_bytes: int = 16 * 1024
    """Size from which a message is acknowledged by the client, with the answer to a ping."""
    unacknowledged: int = 3
    """Most acknowledged messages on their way to a client. What lies in buffers of the network would be shown late."""


@dataclass(frozen=True)
class SocketGuard:
    """The rules by which one server accepts requests."""

    host: str
    """Address or name that the server listens on."""
    allowed_origins: tuple[str, ...] = ()
    """Websites that may use the server besides its own page, as `http://name:port`."""
    token: str = ""
    """What the path of every request must begin with; empty where everybody who can connect is the user."""
    limits: SocketLimits = SocketLimits()

    @classmethod
    def for_host(cls, host: str, allowed_origins: tuple[str, ...] = ()) -> "SocketGuard":
        """Return the guard of a server, with a random token unless its host is loopback; raises `InputError`."""
        token = "" if _is_loopback(host) else token_urlsafe(_TOKEN_BYTES)
        return cls(host, tuple(_normalise_origin(origin) for origin in allowed_origins), token)

    def page_address(self, port: int) -> str:
        """Return the address to open in a browser, with the token."""
        host = _outward_address(self.host) if _is_wildcard(self.host) else self.host
        return f"http://{_bracket(host)}:{port}" + (f"/{self.token}/" if self.token else "")

    def own_hosts(self, local_address: str, port: int) -> set[str]:
        """Return the values of the `Host` header that name this server.

        local_address: address of this computer at which the connection arrived. It counts where the server listens on all
        addresses: no website has the address of this computer as its name.
        """
        names = {*_LOOPBACK_NAMES, _bracket(self.host.lower())}
        if _is_wildcard(self.host):
            names |= {_bracket(local_address), (name := socket.gethostname().lower()), f"{name}.local"}
        return {f"{name}:{port}" for name in names} | (names if port == 80 else set())

    def find_refusal(self, request: Request, local_address: str, port: int) -> tuple[int, str] | None:
        """Return HTTP status and reason with which a request is refused; None for one that is accepted."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        own = self.own_hosts(local_address, port)
        proxies = {urlsplit(origin).netloc for origin in self.allowed_origins} - {""}
        if len(hosts) != 1 or hosts[0].lower() not in own | proxies:
            return 403, _host_or_origin_refusal("Host", hosts, "http://NAME:PORT")
        allowed = {f"http://{host}" for host in own} | set(self.allowed_origins)
        if origins == ["null"]:
            return 403, _NO_ORIGIN
        if len(origins) > 1 or (origins and origins[0].lower() not in allowed):
            return 403, _host_or_origin_refusal("Origin", origins, "ORIGIN")
        if self.token and not hmac.compare_digest(_first_segment(request.path).encode(), self.token.encode()):
            return 404, "expected the whole address that the program printed, got another; copy it again"
        return None

    def serve(
        self,
        handler: Callable[[Any], Awaitable[None]],
        host: str,
        port: int,
        *,
        is_expected: MessageTest,
        process_request: RequestHandler | None = None,
        **options: Any,
    ) -> serve:
        """Return a guarded server; use it as `websockets.serve`.

        handler, process_request: as in `websockets.serve`; they get accepted requests only, with the token taken off the path.
        is_expected: whether a message of a client can be handled; other messages are dropped.
        """
        options |= {
            "process_request": partial(self._answer_request, process_request),
            "max_size": self.limits.message_bytes,
            "logger": one_line_logger(),
            "create_connection": partial(GuardedConnection, self.limits, is_expected, _MemoryRelease()),
        }
        return serve(handler, host, port, **options)

    async def _answer_request(
        self, process_request: RequestHandler | None, connection: ServerConnection, request: Request
    ) -> Response | None:
        """Answer a request that is refused; hand on all others."""
        refusal = self.find_refusal(request, *connection.local_address[:2])
        if refusal is None and len(connection.server.connections) >= self.limits.clients:
            refusal = 503, f"expected at most {self.limits.clients} browsers on the page, got one more; close others"
        if refusal is not None:
            connection.logger.warning("refused %s: %s", format_peer(connection), refusal[1])
            response: Response | None = connection.respond(refusal[0], refusal[1] + "\n")
        else:
            path = request.path.removeprefix(f"/{self.token}") if self.token else request.path
            answer = process_request and process_request(connection, replace(request, path=path or "/"))
            response = await answer if isawaitable(answer) else answer
        if response is not None:
            response.headers.update(self._response_headers(request))
        return response

    def _response_headers(self, request: Request) -> dict[str, str]:
        """Return headers that keep the page from loading, connecting to, or being framed by anything else.

        viser's page connects to whatever `?websocket=` in its address names and runs scripts that arrive from there.
        """
        everything = "'self' 'unsafe-inline' 'unsafe-eval' data: blob:"
        host = "".join(request.headers.get_all("Host"))
        own = f"ws://{host} wss://{host}" if re.fullmatch(r"[\w.:\[\]-]+", host) else ""
        framed_by = " ".join(("'self'", *self.allowed_origins))
        return {
            "Content-Security-Policy": f"default-src {everything}; connect-src 'self' data: blob: {own}; "
            f"frame-ancestors {framed_by}; base-uri 'none'; form-action 'none'; object-src 'none'",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }


class GuardedConnection(ServerConnection):
    """A connection that drops unexpected messages and ends with a client that floods it or does not read."""

    def __init__(
        self, limits: SocketLimits, is_expected: MessageTest, memory: "_MemoryRelease", *args: Any, **options: Any
    ) -> None:
        super().__init__(*args, **options)
        self._limits, self._is_expected, self._memory = limits, is_expected, memory
        self._second, self._events_in_second, self._has_dropped = 0.0, 0, False
        self._unanswered: deque[Awaitable[float]] = deque()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; of too many without a finished handshake the oldest ends, so that idle ones keep nobody out."""
        super().connection_made(transport)
        begun = [
            one for one in self.server.handlers if one.state is State.CONNECTING and not one.transport.is_closing()
        ]
        if len(begun) > _OPENING_PER_CLIENT * self._limits.clients:
            begun[0].transport.abort()

    def process_event(self, event: Any) -> None:
        """Handle one frame of the client, unless it sends too many."""
        if (now_s := self.loop.time()) - self._second >= 1:
            self._second, self._events_in_second = now_s, 0
        self._events_in_second += 1
        if self._events_in_second <= self._limits.messages_per_s:
            super().process_event(event)
        elif self._events_in_second == self._limits.messages_per_s + 1:
            self._end(f"it sent more than {self._limits.messages_per_s} messages in a second")

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next message that is to be handled."""
        while not self._is_expected(message := await super().recv(decode)):
            if not self._has_dropped:
                self._has_dropped = True
                self.logger.warning(
                    "dropped a message of %d bytes of %s that the page does not expect; further ones are dropped silently",
                    len(message),
                    format_peer(self),
                )
        return message

    async def send(self, message: Any, text: bool | None = None) -> None:
        """Send a message after the client has received the earlier ones; end with a client that does not read."""
        is_acknowledged = isinstance(message, bytes) and len(message) >= self._limits.acknowledged_bytes
        try:
            async with asyncio.timeout(self._limits.send_timeout_s):
                while is_acknowledged and len(self._unanswered) >= self._limits.unacknowledged:
                    await self._unanswered.popleft()
                await super().send(message, text)
                if is_acknowledged:
                    self._unanswered.append(await self.ping())
        except TimeoutError:
            self._end(f"it did not read for {self._limits.send_timeout_s:g} s")
            await self.wait_closed()
            raise self.protocol.close_exc from None

    async def close(self, *args: Any, **options: Any) -> None:
        """Close, without waiting for a client that does not answer."""
        with suppress(TimeoutError):
            async with asyncio.timeout(_CLOSE_S):
                await super().close(*args, **options)
        self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """End, and give the memory of the client back."""
        super().connection_lost(exc)
        if self.response is not None and self.response.status_code == HTTPStatus.SWITCHING_PROTOCOLS:
            self._memory.release_soon(self.loop)

    def _end(self, reason: str) -> None:
        """Disconnect a client at once."""
        self.logger.warning("disconnected %s: %s", format_peer(self), reason)
        self.transport.abort()


class _MemoryRelease:
    """Gives the memory of departed clients back, once for a crowd that leaves."""

    def __init__(self) -> None:
        self._timer: asyncio.TimerHandle | None = None

    def release_soon(self, loop: asyncio.AbstractEventLoop) -> None:
        """Release unused memory when no client has left for a moment."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = loop.call_later(_RELEASE_AFTER_S, self._release)

    def _release(self) -> None:
        """Collect what clients leave behind in reference cycles, and return free memory to the operating system."""
        gc.collect()
        with suppress(OSError, AttributeError, TypeError):  # only the GNU C library has it
            ctypes.CDLL(None).malloc_trim(0)


def hidden_loopback_address() -> str:
    """Return a random one of the 16 million loopback addresses, which no website can guess; 127.0.0.1 where it is the only one.

    A server that has no guard of its own listens there, behind a guarded one.
    """
    address = f"127.{randbelow(254) + 1}.{randbelow(254) + 1}.{randbelow(254) + 1}"
    try:
        socket.create_server((address, 0)).close()
    except OSError:
        return "127.0.0.1"
    return address


def _is_loopback(host: str) -> bool:
    """Return whether only this computer can reach a host."""
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host.lower() == "localhost"


def _is_wildcard(host: str) -> bool:
    """Return whether a host stands for all addresses of this computer."""
    with suppress(ValueError):
        return ip_address(host).is_unspecified
    return not host


def _outward_address(wildcard: str) -> str:
    """Return the address under which other computers most likely reach this one; nothing is sent.

    wildcard: a server at "::" is reached over IPv6 alone; where this computer has no such address, its own is returned.
    """
    is_ipv6 = ":" in wildcard
    family, elsewhere = (socket.AF_INET6, "2001:db8::1") if is_ipv6 else (socket.AF_INET, "192.0.2.1")
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect((elsewhere, 9))
        return str(probe.getsockname()[0])
    return "::1" if is_ipv6 else socket.gethostname()


def _bracket(host: str) -> str:
    """Return a host as it stands in an address."""
    return f"[{host}]" if ":" in host else host


def _first_segment(path: str) -> str:
    """Return the first part of the path of a request; it may hold any bytes."""
    return ascii(path.partition("?")[0].removeprefix("/").partition("/")[0])[1:-1]


def _normalise_origin(origin: str) -> str:
    """Return an origin as browsers send it; raises `InputError`."""
    if origin.lower() == _FILES_ORIGIN:
        return _FILES_ORIGIN
    parts = re.fullmatch(r"https?://(?:[\w.-]+|\[[0-9a-f:]+\])(?::(\d{1,5}))?", origin.lower().rstrip("/"))
    if parts is None or not 0 < int(parts[1] or 80) <= 65535:
        raise InputError(
            expected=f"--allow-origin as http://NAME:PORT, https://NAME or {_FILES_ORIGIN}",
            got=f"{origin!r}",
            remedy="leave out path and user, and name a port of at most 65535",
        )
    return re.sub(r"(?<=^http:)(//.*):80$|(?<=^https:)(//.*):443$", r"\1\2", origin.lower().rstrip("/"))


def _host_or_origin_refusal(header: str, got: list[str], remedy: str) -> str:
    """Return the sentence about a header that names something else than the page."""
    return (
        f"expected {header} to name the page, got {ascii(', '.join(got))[:100]}; open the address that the program printed, "
        f"or start it with --allow-origin {remedy}"
    )


def format_peer(connection: ServerConnection) -> str:
    """Return the address of a client."""
    peer = connection.remote_address
    return "a client" if not peer else f"{_bracket(str(peer[0]))}:{peer[1]}"


_LINES_PER_MINUTE = 20
"""Most lines that a server logs per minute."""
_CHARACTERS_PER_LINE = 400


def one_line_logger() -> logging.Logger:
    """Return a logger for one server: a line each and no traceback, and not more than a person can read."""
    logger, recent = logging.Logger(f"{__name__}.server"), deque[float](maxlen=_LINES_PER_MINUTE)
    logger.parent = logging.getLogger(__name__)

    def is_worth_a_line(record: logging.LogRecord) -> bool:
        if record.levelno < logging.WARNING or record.msg == "opening handshake failed":
            return False  # browsers open connections in advance and drop them
        if record.exc_info and (failure := record.exc_info[1]) is not None:
            place = extract_tb(failure.__traceback__)[-1:]
            where = "".join(f" at {Path(each.filename).name}:{each.lineno}" for each in place)
            said = " ".join(repr(failure).split())[:_CHARACTERS_PER_LINE]
            record.msg, record.args = f"{record.getMessage()}: {said}{where}", None
            record.exc_info = record.exc_text = None
        if len(recent) == _LINES_PER_MINUTE and record.created - recent[0] < 60:
            return False
        recent.append(record.created)
        return True

    logger.addFilter(is_worth_a_line)
    return logger

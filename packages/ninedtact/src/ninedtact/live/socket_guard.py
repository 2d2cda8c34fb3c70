"""The guard of web servers of readings: who may connect, what clients may send, and how much they may cost.

Browsers let every website send requests to servers on the same computer and network. So each request must name a host (`Host`)
and, where the browser states it, a website (`Origin`) that belong to the server; the first closes DNS rebinding, the second
cross-site WebSockets. On a network the path must also begin with the random token of the printed address.

`SocketGuard.serve` takes the place of `websockets.serve`. A server that has no guard of its own listens at a
`hidden_loopback_address` behind such a front, which passes on what it accepts (`relay`).
"""

import asyncio
import errno
import hmac
import re
import socket
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from ipaddress import ip_address
from secrets import randbelow, token_urlsafe
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.frames import DATA_OPCODES
from websockets.http11 import Request, Response
from websockets.protocol import State

from ninedtact.errors import DeviceError, InputError
from ninedtact.live.server_log import one_line_logger

_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
_TOKEN_BYTES = 16
_FILES_ORIGIN = "file://"
"""What desktop programs that are made of pages state as their website. Browsers state null for pages in files."""
_NO_ORIGIN = (
    "expected Origin to name the page, got null, which browsers state for a page in a file; serve the page from its folder, "
    "python -m http.server 5500, open http://localhost:5500, and start this program with --allow-origin http://localhost:5500"
)
_CLOSE_S = 1.0
"""Time for a client to answer the end of its connection."""

RequestHandler = Callable[[ServerConnection, Request], Awaitable[Response | None]]


@dataclass(frozen=True)
class SocketLimits:
    """What one server accepts."""

    message_bytes: int = 600 * 1024
    """Largest message of a client: one part of an uploaded file. A message of the page's controls has some 200 bytes."""
    messages_per_s: int = 500
    """Messages, pings and fragments per second above which a client is disconnected; a moved mouse makes 50."""
    clients: int = 32
    """Most clients at a time."""
    speaks_within_s: float | None = None
    """Time within which a client sends its first message, as a page does when it is ready; those that have sent none make room for
    others. None for servers whose clients only read.
    """
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

    def websocket_address(self, port: int) -> str:
        """Return the address for WebSocket clients, with the token."""
        return self.page_address(port).replace("http://", "ws://", 1)

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
        first_segment = re.split("[/?]", request.path.removeprefix("/"), maxsplit=1)[0]
        if self.token and not hmac.compare_digest(ascii(first_segment), ascii(self.token)):
            return 404, "expected the whole address that the program printed, got another; copy it again"
        return None

    def serve(
        self,
        handler: Callable[[Any], Awaitable[None]],
        port: int,
        process_request: RequestHandler | None = None,
        **options: Any,
    ) -> serve:
        """Return a guarded server on the host; use it as `websockets.serve`.

        handler, process_request: as in `websockets.serve`; they get accepted requests only, with the token taken off the path.
        """
        options |= {
            "process_request": partial(self._answer_request, process_request),
            "max_size": self.limits.message_bytes,
            "logger": one_line_logger(),
            "create_connection": partial(GuardedConnection, self.limits),
        }
        return serve(handler, self.host, port, **options)

    async def _answer_request(
        self, process_request: RequestHandler | None, connection: ServerConnection, request: Request
    ) -> Response | None:
        """Answer a request that is refused; hand on all others."""
        refusal = self.find_refusal(request, *connection.local_address[:2])
        if refusal is None and not self._has_room(connection):
            refusal = 503, f"expected at most {self.limits.clients} browsers on the page, got one more; close others"
        if refusal is not None:
            connection.logger.warning("refused %s: %s", format_peer(connection), refusal[1])
            response: Response | None = connection.respond(refusal[0], refusal[1] + "\n")
        else:
            path = request.path.removeprefix(f"/{self.token}") if self.token else request.path
            response = (
                await process_request(connection, replace(request, path=path or "/")) if process_request else None
            )
        if response is not None:
            response.headers.update(self._response_headers(request))
        return response

    def _has_room(self, newcomer: ServerConnection) -> bool:
        """Return whether there is room for one more client, which the one makes that has been silent since the longest time."""
        clients = newcomer.server.connections
        if len(clients) < self.limits.clients:
            return True
        silent = [one for one in clients if isinstance(one, GuardedConnection) and one.owes_message]
        if silent:
            min(silent, key=lambda one: one.opened_s).disconnect("it has sent nothing, and another client came")
        return bool(silent)

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
    """A connection that ends with a client that floods it or does not read."""

    def __init__(self, limits: SocketLimits, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._limits = limits
        self.sent = 0
        """Number of messages that do not wait on their way to the client any more."""
        self._second, self._events_in_second = 0.0, 0
        self._unanswered: deque[Awaitable[float]] = deque()
        self.opened_s, self._has_spoken = self.loop.time(), False
        if limits.speaks_within_s is not None:
            self.loop.call_later(limits.speaks_within_s, self._disconnect_if_silent, limits.speaks_within_s)

    @property
    def owes_message(self) -> bool:
        """Whether the client has still to send the first message that is expected of it."""
        return self._limits.speaks_within_s is not None and not self._has_spoken

    def _disconnect_if_silent(self, seconds: float) -> None:
        if self.owes_message and self.state is State.OPEN:
            self.disconnect(f"it sent nothing in {seconds:g} s")

    def process_event(self, event: Any) -> None:
        """Handle one frame of the client, unless it sends too many."""
        if (now_s := self.loop.time()) - self._second >= 1:
            self._second, self._events_in_second = now_s, 0
        self._events_in_second += 1
        self._has_spoken = self._has_spoken or getattr(event, "opcode", None) in DATA_OPCODES
        if self._events_in_second <= self._limits.messages_per_s:
            super().process_event(event)
        elif self._events_in_second == self._limits.messages_per_s + 1:
            self.disconnect(f"it sent more than {self._limits.messages_per_s} messages in a second")

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
                self.sent += 1
        except TimeoutError:
            self.disconnect(f"it did not read for {self._limits.send_timeout_s:g} s")
            await self.wait_closed()
            raise self.protocol.close_exc from None

    async def close(self, *args: Any, **options: Any) -> None:
        """Close, without waiting for a client that does not answer."""
        with suppress(TimeoutError):
            async with asyncio.timeout(_CLOSE_S):
                await super().close(*args, **options)
        self.transport.abort()

    def disconnect(self, reason: str) -> None:
        """Disconnect a client at once."""
        self.logger.warning("disconnected %s: %s", format_peer(self), reason)
        self.transport.abort()


async def relay(
    client: ServerConnection,
    address: str,
    subprotocol: str,
    to_server: Callable[[ClientConnection], Awaitable[None]],
) -> None:
    """Connect a client to the WebSocket server at an address behind this one, until one of them ends.

    to_server: passes the messages of the client on.
    """
    options: dict[str, Any] = {"compression": None, "max_size": None, "max_queue": 1, "ping_interval": None}
    options |= {"subprotocols": [subprotocol], "proxy": None, "close_timeout": 0.1}

    async def to_client(server: ClientConnection) -> None:
        async for message in server:
            await client.send(message)

    async with connect(address, **options) as server:
        both = [asyncio.ensure_future(to_server(server)), asyncio.ensure_future(to_client(server))]
        _, running = await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        for task in running:
            task.cancel()
        for result in await asyncio.gather(*both, return_exceptions=True):
            if isinstance(result, Exception) and not isinstance(result, ConnectionClosed):
                raise result


@contextmanager
def network_port_errors(host: str, port: int, what: str, option: str = "--port") -> Iterator[None]:
    """Raise `DeviceError` where a port cannot be listened on; what: is served there."""
    try:
        yield
    except (OSError, OverflowError) as trouble:
        is_taken = getattr(trouble, "errno", 0) == errno.EADDRINUSE
        raise DeviceError(
            expected=f"port {port} on {host} to be free for {what}",
            got="one in use" if is_taken else f"'{getattr(trouble, 'strerror', None) or trouble}'",
            remedy=f"choose another with {option}, or a host of this machine with --host",
        ) from trouble


def hidden_loopback_address() -> str:
    """Return a random one of the 16 million loopback addresses, which no website can guess; 127.0.0.1 where it is the only one."""
    address = f"127.{randbelow(254) + 1}.{randbelow(254) + 1}.{randbelow(254) + 1}"
    try:
        socket.create_server((address, 0)).close()
    except OSError:
        return "127.0.0.1"
    return address


def _is_loopback(host: str) -> bool:
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host.lower() == "localhost"


def _is_wildcard(host: str) -> bool:
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
    return f"[{host}]" if ":" in host else host


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
    return (
        f"expected {header} to name the page, got {ascii(', '.join(got))[:100]}; open the address that the program printed, "
        f"or start it with --allow-origin {remedy}"
    )


def format_peer(connection: ServerConnection) -> str:
    """Return the address of a client."""
    peer = connection.remote_address
    return "a client" if not peer else f"{_bracket(str(peer[0]))}:{peer[1]}"

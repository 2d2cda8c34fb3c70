"""Readings for programs in any language: one JSON object a line over TCP, and the same objects over WebSocket for browsers.

    sensor thread ──Reading──▶ ReadingServer.publish ──▶ server thread: a short queue for each client ──▶ TCP, WebSocket

`publish` never waits: a client that reads too slowly misses readings, which its next message counts (`missed`), and is
disconnected after ten seconds without reading. Who may connect is decided as for the live page (`studio.socket_guard`).
The messages are the classes below; their JSON schema is served at `/schema.json`.
"""

import asyncio
import base64
import errno
import hmac
import json
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from functools import cached_property, partial
from threading import Thread
from time import monotonic_ns
from types import TracebackType
from typing import Any, Literal, cast, get_args
from urllib.parse import parse_qs, urlsplit

import cv2
import msgspec
import numpy as np
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from ninedtact.errors import DeviceError
from ninedtact.quantities import WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.sensor import Sensor
from ninedtact.studio.sensor_poller import SensorPhase, SensorPoller
from ninedtact.studio.socket_guard import SocketGuard

STREAM_FORMAT = 1
"""Number of the message format, raised when a field changes its meaning."""
ImageFormat = Literal["none", "jpeg", "png"]
_QUEUED_MESSAGES = 8
"""Messages that wait for one client at most; further ones replace the oldest."""
_REQUEST_BYTES, _REQUEST_S = 4096, 10.0
"""Size of a TCP client's request, and the time in which it must arrive."""
_POLL_S = 0.1


class StreamPortRefused(DeviceError):
    """Raised for a port that is in use, or an address that this computer does not have."""


class StreamRequest(msgspec.Struct, forbid_unknown_fields=True):
    """What a client asks for: over TCP its first line, over WebSocket the query of the address (`?images=jpeg`)."""

    token: str = ""
    """The printed token, where there is one; over WebSocket it is part of the address."""
    images: ImageFormat = "none"


class StreamedWrench(msgspec.Struct):
    """The estimated wrench of the object on the skin, about the skin centre."""

    force_n: list[float]
    torque_nm: list[float]
    force_std_n: list[float | None]
    """One standard deviation; null where none is stated."""
    torque_std_nm: list[float | None]
    touching: bool


class StreamedImage(msgspec.Struct):
    """The raw camera image."""

    format: ImageFormat
    width: int
    height: int
    base64: str
    """The compressed image, base64."""


class StreamedReading(msgspec.Struct, tag="reading", tag_field="type"):
    """One reading."""

    sensor: str
    format: int
    """Number of this message format."""
    index: int
    """Number of the image in its source."""
    stamp_ns: int
    """Arrival of the image, wall time in ns since 1970."""
    age_ms: float
    """Time from the arrival of the image to this message."""
    max_indentation_mm: float
    contact_area_mm2: float
    wrench: StreamedWrench | None
    """Null where no force is estimated."""
    warnings: list[str]
    """Why the reading should not be trusted; empty where there is no reason."""
    missed: int = 0
    """Readings that this client missed since its last message, because it was slow."""
    image: StreamedImage | None = None


class StreamError(msgspec.Struct, tag="error", tag_field="type"):
    """Why the stream ends."""

    message: str


def stream_schema() -> dict[str, Any]:
    """Return the JSON schema of the messages."""
    found = msgspec.json.schema(StreamedReading | StreamError)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "ninedtact reading stream", **found}


class _SharedReading:
    """One reading on its way to the clients; each form of it is encoded once, when the first client is sent it."""

    def __init__(self, reading: Reading, sensor: str) -> None:
        self._reading, self._sensor = reading, sensor
        self._images: dict[ImageFormat, StreamedImage] = {}

    def encode(self, images: ImageFormat, missed: int) -> bytes:
        """Return the message for a client that missed so many readings before it."""
        message = self._message
        message.missed, message.image = missed, None if images == "none" else self._image(images)
        message.age_ms = round(self._reading.age_ms(monotonic_ns()), 3)
        return msgspec.json.encode(message)

    @cached_property
    def _message(self) -> StreamedReading:
        reading = self._reading
        return StreamedReading(
            sensor=self._sensor,
            format=STREAM_FORMAT,
            index=reading.frame.index,
            stamp_ns=reading.stamp_ns + time.time_ns() - monotonic_ns(),
            age_ms=0.0,
            max_indentation_mm=reading.max_indentation_mm,
            contact_area_mm2=reading.contact_area_mm2,
            wrench=None if reading.force is None else _streamed_wrench(reading.force),
            warnings=[warning.value for warning in reading.warnings],
        )

    def _image(self, images: ImageFormat) -> StreamedImage:
        if images not in self._images:
            rows, cols = self._reading.image.shape[:2]
            encoded = cv2.imencode(f".{images}", self._reading.image)[1]
            self._images[images] = StreamedImage(images, cols, rows, base64.b64encode(encoded.tobytes()).decode())
        return self._images[images]


def _streamed_wrench(estimate: WrenchEstimate) -> StreamedWrench:
    wrench = estimate.about(np.zeros(3)).wrench
    std = [float(value) if np.isfinite(value) else None for value in estimate.about(np.zeros(3)).std]
    return StreamedWrench(wrench.force_n.tolist(), wrench.torque_nm.tolist(), std[:3], std[3:], estimate.touching)


class _Client:
    """The readings that wait for one client."""

    def __init__(self, images: ImageFormat) -> None:
        self._images: ImageFormat = images
        self._waiting: deque[_SharedReading] = deque()
        self._missed, self._arrived = 0, asyncio.Event()

    def add(self, reading: _SharedReading) -> None:
        """Queue a reading; where too many wait, the oldest is missed."""
        if len(self._waiting) == _QUEUED_MESSAGES:
            self._waiting.popleft()
            self._missed += 1
        self._waiting.append(reading)
        self._arrived.set()

    async def messages(self) -> AsyncIterator[bytes]:
        """Yield the messages for this client, without end."""
        while True:
            await self._arrived.wait()
            while self._waiting:
                missed, self._missed = self._missed, 0
                yield self._waiting.popleft().encode(self._images, missed)
            self._arrived.clear()


class ReadingServer:
    """Serves readings over TCP and WebSocket in a thread of its own while it is open (`with`).

    sensor: its name in the messages. host, allowed_origins: as for `SocketGuard.for_host`. Port 0 takes any free port.
    """

    def __init__(self, sensor: str, host: str, port: int, tcp_port: int, allowed_origins: tuple[str, ...] = ()) -> None:
        self.guard = SocketGuard.for_host(host, allowed_origins)
        self.port, self.tcp_port = port, tcp_port
        """Ports of WebSocket and TCP; those in use, once the server is open."""
        self._sensor, self._clients = sensor, set[_Client]()
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, name="serve readings", daemon=True)
        self._servers = AsyncExitStack()
        self._connections = set[asyncio.Task[None]]()

    @property
    def websocket_address(self) -> str:
        """Address for WebSocket clients, with the token."""
        return self.guard.page_address(self.port).replace("http://", "ws://", 1)

    @property
    def tcp_address(self) -> str:
        """Host and port for TCP clients."""
        return urlsplit(self.guard.page_address(self.tcp_port)).netloc

    def publish(self, reading: Reading) -> None:
        """Hand a reading to all clients; returns at once."""
        self._loop.call_soon_threadsafe(self._distribute, reading)

    def __enter__(self) -> "ReadingServer":
        """Listen on both ports; raises `StreamPortRefused`."""
        self._thread.start()
        try:
            self._call(self._listen())
        except BaseException:
            self._end_thread()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._end_thread()

    def _call(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine in the server thread and wait for it."""
        asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _end_thread(self) -> None:
        self._call(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _close(self) -> None:
        for connection in self._connections:
            connection.cancel()
        await self._servers.aclose()

    async def _listen(self) -> None:
        host = self.guard.host
        with _port_errors(host, self.port, "--port"):
            guarded = self.guard.serve(
                self._feed_websocket, host, self.port, is_expected=lambda _: False, process_request=_answer_request
            )
            websocket = await self._servers.enter_async_context(guarded)
        with _port_errors(host, self.tcp_port, "--tcp-port"):
            tcp = await asyncio.start_server(self._feed_tcp, host, self.tcp_port, limit=_REQUEST_BYTES)
            await self._servers.enter_async_context(_closing(tcp))
        self.port = next(iter(websocket.sockets)).getsockname()[1]
        self.tcp_port = tcp.sockets[0].getsockname()[1]

    def _distribute(self, reading: Reading) -> None:
        if self._clients:
            shared = _SharedReading(reading, self._sensor)
            for client in self._clients:
                client.add(shared)

    async def _feed(self, images: ImageFormat, send: Callable[[bytes], Awaitable[None]]) -> None:
        """Send readings to a client until it leaves."""
        client = _Client(images)
        self._clients.add(client)
        try:
            async for message in client.messages():
                await send(message)
        finally:
            self._clients.discard(client)

    async def _feed_websocket(self, connection: ServerConnection) -> None:
        request = connection.request
        images = _asked_images(request.path) if request is not None else None
        if images is None:  # refused before the handshake
            return
        feeding = asyncio.ensure_future(self._feed(images, partial(connection.send, text=True)))
        leaving = asyncio.ensure_future(connection.wait_closed())  # noticed also while there are no readings
        await asyncio.wait({feeding, leaving}, return_when=asyncio.FIRST_COMPLETED)
        feeding.cancel()
        with suppress(ConnectionClosed, asyncio.CancelledError):
            await feeding

    async def _feed_tcp(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer a TCP client: a request of one line, then readings; an error line where the request is refused."""
        connection = asyncio.current_task()
        assert connection is not None
        self._connections.add(connection)

        async def send(line: bytes) -> None:
            writer.write(line + b"\n")
            async with asyncio.timeout(self.guard.limits.send_timeout_s):
                await writer.drain()

        try:
            request = await self._tcp_request(reader)
            if isinstance(request, StreamError):
                await send(msgspec.json.encode(request))
                writer.close()
            else:
                await self._feed(request.images, send)
        except (OSError, TimeoutError):  # the client has left, or does not read
            pass
        except asyncio.CancelledError:
            if not self._loop.is_running():
                raise
        finally:
            self._connections.discard(connection)
            if not writer.is_closing():
                writer.transport.abort()

    async def _tcp_request(self, reader: asyncio.StreamReader) -> StreamRequest | StreamError:
        """Return the request of a TCP client, or why it is refused."""
        if len(self._connections) > self.guard.limits.clients:
            return StreamError(f"expected at most {self.guard.limits.clients} clients, got one more; close others")
        try:
            async with asyncio.timeout(_REQUEST_S):
                line = await reader.readline()
            request = msgspec.json.decode(line, type=StreamRequest)
        except TimeoutError:
            return StreamError(f"expected a request within {_REQUEST_S:g} s, got none; send {{}} and a line break")
        except (ValueError, msgspec.DecodeError):
            return StreamError(
                'expected one line of JSON such as {"images": "jpeg"}, got something else; send {} for no images'
            )
        if not hmac.compare_digest(request.token.encode(), self.guard.token.encode()):
            return StreamError('expected "token" to be the one that the server printed, got another; copy it again')
        return request


def serve_sensor(server: ReadingServer, sensor: Sensor, should_stop: Callable[[], bool]) -> int:
    """Read a sensor and publish every reading until `should_stop` is true or its source ends; return how many.

    Raises what the sensor raises.
    """
    served = 0

    def publish(reading: Reading) -> None:
        nonlocal served
        server.publish(reading)
        served += 1

    with SensorPoller(sensor, publish) as poller:
        while not should_stop():
            poller.wait_for_change(_POLL_S)
            now = poller.snapshot(monotonic_ns())
            if now.phase is SensorPhase.FAILED and now.trouble is not None:
                raise now.trouble
            if now.phase is SensorPhase.ENDED:
                break
    return served


def _answer_request(connection: ServerConnection, request: Request) -> Response | None:
    """Serve the schema, refuse unknown addresses, and let WebSockets through."""
    path = urlsplit(request.path).path
    if path == "/schema.json":
        return connection.respond(200, json.dumps(stream_schema(), indent=2))
    if path != "/" or _asked_images(request.path) is None:
        return connection.respond(404, "expected /, /?images=jpeg, /?images=png or /schema.json; correct the address\n")
    return None


def _asked_images(path: str) -> ImageFormat | None:
    """Return the images that the query of an address asks for; None for a query that is not understood."""
    query = parse_qs(urlsplit(path).query, keep_blank_values=True)
    images = query.pop("images", ["none"])[-1]
    return None if query or images not in get_args(ImageFormat) else cast(ImageFormat, images)


@contextmanager
def _port_errors(host: str, port: int, option: str) -> Iterator[None]:
    """Raise `StreamPortRefused` where a port cannot be listened on."""
    try:
        yield
    except (OSError, OverflowError) as trouble:
        got = "one in use" if getattr(trouble, "errno", 0) == errno.EADDRINUSE else f"'{trouble}'"
        raise StreamPortRefused(
            f"expected port {port} on {host} to be free for readings, got {got}; choose another with {option}, or a host of "
            "this machine with --host"
        ) from trouble


@asynccontextmanager
async def _closing(server: asyncio.Server) -> AsyncIterator[None]:
    """Close a server at the end, without waiting for its clients."""
    yield
    server.close()

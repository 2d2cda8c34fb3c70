"""Readings for programs in any language: one JSON object a line over TCP, and the same objects over WebSocket for browsers.

A client that reads too slowly misses readings, which its next message counts (`missed`), and is disconnected after ten seconds
without reading. Who may connect is decided as for the live page (`studio.socket_guard`). The messages are the classes below; their
JSON schema is served at `/schema.json`.
"""

import asyncio
import base64
import hmac
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import cached_property, partial
from time import monotonic_ns
from typing import Any, Literal, cast, get_args
from urllib.parse import parse_qs, urlsplit

import cv2
import msgspec
import numpy as np
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from ninedtact.interop.reading_broadcast import BroadcastServer, feed_until_closed, port_errors
from ninedtact.quantities import WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.metadata import wall_time_ns
from ninedtact.studio.sensor_poller import SensorSnapshot
from ninedtact.studio.socket_guard import SocketGuard

STREAM_FORMAT = 1
"""Number of the message format, raised when a field changes its meaning."""
ImageFormat = Literal["none", "jpeg", "png"]
_QUEUED_READINGS = 8
"""Readings that wait for one client at most."""
_CONNECTIONS_PER_CLIENT = 4
"""Connections without a request yet are counted too. Beyond this number the oldest of them ends, so that they keep nobody out."""
_REQUEST_BYTES, _REQUEST_S = 4096, 10.0
"""Size of a TCP client's request, and the time in which it must arrive."""


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


class StreamedStatus(msgspec.Struct, tag="status", tag_field="type"):
    """What the sensor does, where that changes; who connects while it does not simply read gets it first."""

    sensor: str
    format: int
    """Number of this message format."""
    phase: str
    """Such as "taking the reference", "no images for 3 s" or "reading"."""
    trouble: str
    """Why there are no readings, and what to do; empty where there is no reason, or no longer."""


class StreamedError(msgspec.Struct, tag="error", tag_field="type"):
    """Why the stream ends or is refused; the last message to a client."""

    message: str


def reading_stream_json_schema() -> dict[str, Any]:
    """Return the JSON schema of the messages."""
    found = msgspec.json.schema(StreamedReading | StreamedStatus | StreamedError)
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
            stamp_ns=wall_time_ns(reading.stamp_ns),
            age_ms=0.0,
            max_indentation_mm=reading.max_indentation_mm,
            contact_area_mm2=reading.contact_area_mm2,
            wrench=None if reading.force is None else _streamed_wrench(reading.force),
            warnings=list(reading.warnings),
        )

    def _image(self, images: ImageFormat) -> StreamedImage:
        if images not in self._images:
            rows, cols = self._reading.image.shape[:2]
            encoded = cv2.imencode(f".{images}", self._reading.image)[1]
            self._images[images] = StreamedImage(images, cols, rows, base64.b64encode(encoded.tobytes()).decode())
        return self._images[images]


class _SharedStatus:
    """A status on its way to the clients."""

    def __init__(self, status: SensorSnapshot, sensor: str) -> None:
        self._status, self._sensor = status, sensor

    def encode(self, images: ImageFormat, missed: int) -> bytes:
        """Return the message for a client."""
        phase = self._status.phase_text(monotonic_ns())
        return msgspec.json.encode(StreamedStatus(self._sensor, STREAM_FORMAT, phase, self._status.trouble_sentence))


def _share(message: Reading | SensorSnapshot, sensor: str) -> _SharedReading | _SharedStatus:
    """Return a reading or a status as what all clients are handed."""
    return _SharedReading(message, sensor) if isinstance(message, Reading) else _SharedStatus(message, sensor)


def _streamed_wrench(estimate: WrenchEstimate) -> StreamedWrench:
    centred = estimate.about_skin_centre()
    wrench, std = centred.wrench, [float(value) if np.isfinite(value) else None for value in centred.std]
    return StreamedWrench(wrench.force_n.tolist(), wrench.torque_nm.tolist(), std[:3], std[3:], estimate.touching)


class ReadingServer(BroadcastServer[_SharedReading | _SharedStatus]):
    """Serves readings over TCP and WebSocket in a thread of its own while it is open (`with`).

    sensor: its name in the messages. host, allowed_origins: as for `SocketGuard.for_host`. Port 0 takes any free port.
    """

    def __init__(self, sensor: str, host: str, port: int, tcp_port: int, allowed_origins: tuple[str, ...] = ()) -> None:
        self.guard = SocketGuard.for_host(host, allowed_origins)
        self.port, self.tcp_port = port, tcp_port
        """Ports of WebSocket and TCP; those in use, once the server is open."""
        super().__init__(partial(_share, sensor=sensor), _QUEUED_READINGS)
        self._connections = set[asyncio.Task[None]]()
        self._silent = dict[asyncio.Task[None], None]()
        """The TCP connections without a request yet, in their order."""
        self._clients = dict[asyncio.Task[None], asyncio.StreamReader]()
        """The TCP connections whose request was accepted, in their order."""

    @property
    def websocket_address(self) -> str:
        """Address for WebSocket clients, with the token."""
        return self.guard.page_address(self.port).replace("http://", "ws://", 1)

    @property
    def tcp_address(self) -> str:
        """Host and port for TCP clients."""
        return urlsplit(self.guard.page_address(self.tcp_port)).netloc

    async def _listen(self) -> None:
        host, servers = self.guard.host, self._servers
        with port_errors(host, self.port, "--port"):
            guarded = self.guard.serve(
                self._feed_websocket, host, self.port, is_expected=lambda _: False, process_request=_answer_request
            )
            websocket = await servers.enter_async_context(guarded)
        with port_errors(host, self.tcp_port, "--tcp-port"):
            tcp = await asyncio.start_server(self._feed_tcp, host, self.tcp_port, limit=_REQUEST_BYTES)
            await servers.enter_async_context(_closing(tcp))
        servers.callback(self._end_connections)
        self.port = next(iter(websocket.sockets)).getsockname()[1]
        self.tcp_port = tcp.sockets[0].getsockname()[1]

    def _end_connections(self) -> None:
        for connection in self._connections:
            connection.cancel()

    async def _feed(self, images: ImageFormat, send: Callable[[bytes], Awaitable[None]]) -> None:
        """Send readings and statuses to a client until it leaves."""
        with self._queue() as queue:
            async for message, missed in queue.arrivals():
                await send(message.encode(images, missed))

    async def _feed_websocket(self, connection: ServerConnection) -> None:
        request = connection.request
        images = _asked_images(request.path) if request is not None else None
        if images is None:  # refused before the handshake
            return
        await feed_until_closed(connection, self._feed(images, partial(connection.send, text=True)))

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
            request = self._refuse_or_add_client(connection, reader, await self._tcp_request(connection, reader))
            if isinstance(request, StreamedError):
                await send(msgspec.json.encode(request))
                writer.close()
            else:
                await self._feed(request.images, send)
        except (OSError, TimeoutError):  # the client has left, or does not read
            pass
        except asyncio.CancelledError:
            if not self._is_running:
                raise
        finally:
            self._connections.discard(connection)
            self._clients.pop(connection, None)
            if not writer.is_closing():
                writer.transport.abort()

    async def _tcp_request(
        self, connection: "asyncio.Task[None]", reader: asyncio.StreamReader
    ) -> StreamRequest | StreamedError:
        """Return the request of a TCP client, or why it is refused; while it is awaited, newer clients may end the connection."""
        if len(self._connections) > _CONNECTIONS_PER_CLIENT * self.guard.limits.clients:
            if not self._silent:
                return self._one_too_many()
            oldest = next(iter(self._silent))
            del self._silent[oldest]
            oldest.cancel()
        self._silent[connection] = None
        try:
            async with asyncio.timeout(_REQUEST_S):
                line = await reader.readline()
            request = msgspec.json.decode(line, type=StreamRequest)
        except TimeoutError:
            return StreamedError(f"expected a request within {_REQUEST_S:g} s, got none; send {{}} and a line break")
        except msgspec.ValidationError as fault:
            return StreamedError(
                f'expected a request such as {{"images": "jpeg"}} or {{}}, got a fault in it: {fault}; correct it'
            )
        except (ValueError, msgspec.DecodeError):
            return StreamedError(
                'expected one line of JSON such as {"images": "jpeg"}, got something else; send {} for no images'
            )
        finally:
            self._silent.pop(connection, None)
        if not hmac.compare_digest(request.token.encode(), self.guard.token.encode()):
            return StreamedError('expected "token" to be the one that the server printed, got another; copy it again')
        return request

    def _refuse_or_add_client(
        self, connection: "asyncio.Task[None]", reader: asyncio.StreamReader, request: StreamRequest | StreamedError
    ) -> StreamRequest | StreamedError:
        """Add a TCP client whose request is accepted, unless there are too many.

        A client that has ended its side may have left, which shows only once it is sent something, or may read on. So as many of
        these as of others are kept, and the oldest are ended.
        """
        if isinstance(request, StreamedError):
            return request
        most, ended = self.guard.limits.clients, [each for each, sent in self._clients.items() if sent.at_eof()]
        if len(self._clients) - len(ended) >= most:
            return self._one_too_many()
        for oldest in ended[: max(len(ended) - most + 1, 0)]:
            oldest.cancel()
        self._clients[connection] = reader
        return request

    def _one_too_many(self) -> StreamedError:
        return StreamedError(f"expected at most {self.guard.limits.clients} clients, got one more; close others")


def _answer_request(connection: ServerConnection, request: Request) -> Response | None:
    """Serve the schema, refuse unknown addresses, and let WebSockets through."""
    path = urlsplit(request.path).path
    if path == "/schema.json":
        return connection.respond(200, json.dumps(reading_stream_json_schema(), indent=2))
    if path != "/" or _asked_images(request.path) is None:
        return connection.respond(404, "expected /, /?images=jpeg, /?images=png or /schema.json; correct the address\n")
    return None


def _asked_images(path: str) -> ImageFormat | None:
    """Return the images that the query of an address asks for; None for a query that is not understood."""
    query = parse_qs(urlsplit(path).query, keep_blank_values=True)
    images = query.pop("images", ["none"])[-1]
    return None if query or images not in get_args(ImageFormat) else cast(ImageFormat, images)


@asynccontextmanager
async def _closing(server: asyncio.Server) -> AsyncIterator[None]:
    """Close a server at the end, without waiting for its clients."""
    yield
    server.close()

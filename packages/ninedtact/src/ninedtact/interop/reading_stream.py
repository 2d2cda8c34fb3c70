"""Readings for programs in any language: one JSON object a line over TCP, and the same objects over WebSocket for browsers.

    sensor thread ──Reading or SensorSnapshot──▶ ReadingServer.publish ──▶ server thread: a short queue for each client

A client that reads too slowly misses readings, which its next message counts (`missed`), and is disconnected after ten seconds
without reading. Who may connect is decided as for the live page (`live.socket_guard`). The messages are the classes below; their
JSON schema is served at `/schema.json`.
"""

import asyncio
import base64
import hmac
import itertools
import json
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import cached_property, partial
from time import monotonic_ns
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import cv2
import msgspec
import numpy as np
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from ninedtact.interop.sensor_sharing import ServerThread, watch_sensor
from ninedtact.live.sensor_poller import SensorPhase, SensorSnapshot
from ninedtact.live.socket_guard import SocketGuard, network_port_errors
from ninedtact.quantities import WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.metadata import wall_time_ns
from ninedtact.sensor import Sensor
from ninedtact.tracking import ContactTracker, TrackedContacts

STREAM_FORMAT = 2
"""Number of the message format, raised when a field changes its meaning."""
ImageFormat = Literal["none", "jpeg", "png"]
_QUEUED_READINGS = 8
"""Readings that wait for one client at most."""
_REQUEST_BYTES, _REQUEST_S = 4096, 10.0
"""Size of a TCP client's request, and the time in which it must arrive."""


class StreamRequest(msgspec.Struct, forbid_unknown_fields=True):
    """What a client asks for: over TCP its first line, over WebSocket the query of the address (`?images=jpeg`)."""

    token: str = ""
    """The printed token, where there is one; over WebSocket it is part of the address."""
    images: ImageFormat = "none"
    tracking: bool = False
    """Whether readings have contacts, motion and slip; over WebSocket `?tracking=true`."""


class StreamedContact(msgspec.Struct):
    """One connected contact."""

    number: int
    """The same in every reading in which the contact is followed."""
    centre_mm: list[float]
    area_mm2: float
    force_n: list[float] | None
    """Its share of the force; null where none is known."""


class StreamedMotion(msgspec.Struct):
    """Motion of the object that touches since it touched first."""

    path: int
    """Rises where another object touches, or the same one beyond recognition."""
    moved_mm: list[float]
    rotation_vector_rad: list[float]
    """Axis of the rotation times its angle, in the axes of the sensor."""
    std: list[float]
    """One standard deviation of the three displacements in mm and of the rotation about x, y and z in rad."""


class StreamedSlip(msgspec.Struct):
    """How much of what touches slides; numbers are null where they are not known."""

    state: str
    """static, incipient, gross or unknown."""
    p_incipient: float | None
    p_gross: float | None
    sticking_share: float | None
    speed_mm_s: float | None
    friction: float | None
    friction_std: float | None


class StreamedWrench(msgspec.Struct):
    """The estimated wrench of the object on the skin, about the skin centre."""

    force_n: list[float]
    torque_nm: list[float]
    force_std_n: list[float | None]
    """One standard deviation; null where none is stated."""
    torque_std_nm: list[float | None]
    touching: bool


class StreamedTracking(msgspec.Struct):
    """What touches, followed from reading to reading since a client first asked for it."""

    contacts: list[StreamedContact]
    motion: StreamedMotion | None
    """Null where the object is not followed."""
    slip: StreamedSlip


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
    """Null where no force is estimated; with tracking, the torque about z is also that of the object's turn."""
    warnings: list[str]
    """Why the reading should not be trusted; empty where there is no reason."""
    missed: int = 0
    """Readings that this client missed since its last message, because it was slow."""
    image: StreamedImage | None = None
    tracking: StreamedTracking | None = None
    """Null unless the client asked for it."""


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


class _SharedMessage:
    """A reading or a status on its way to the clients; what they have in common is encoded once, when one is sent it."""

    def __init__(self, source: Reading | SensorSnapshot, sensor: str, tracked: TrackedContacts | None = None) -> None:
        self.source, self._sensor, self._tracked = source, sensor, tracked
        self._images: dict[ImageFormat, StreamedImage] = {}

    def encode(self, wanted: StreamRequest, missed: int) -> bytes:
        """Return the message for a client that missed so many readings before it."""
        if isinstance(self.source, SensorSnapshot):
            phase = self.source.phase_text(monotonic_ns())
            return msgspec.json.encode(StreamedStatus(self._sensor, STREAM_FORMAT, phase, self.source.trouble_sentence))
        message, reading = self._message, self.source
        message.missed = missed
        message.image = None if wanted.images == "none" else self._image(wanted.images, reading)
        message.tracking = self._tracking if wanted.tracking else None
        force = (self._tracked.reading if self._tracked is not None and wanted.tracking else reading).force
        message.wrench = None if force is None else _streamed_wrench(force)
        message.age_ms = round(reading.age_ms(monotonic_ns()), 3)
        return msgspec.json.encode(message)

    @cached_property
    def _message(self) -> StreamedReading:
        reading = self.source
        assert isinstance(reading, Reading)
        return StreamedReading(
            sensor=self._sensor,
            format=STREAM_FORMAT,
            index=reading.frame.index,
            stamp_ns=wall_time_ns(reading.stamp_ns),
            age_ms=0.0,
            max_indentation_mm=reading.max_indentation_mm,
            contact_area_mm2=reading.contact_area_mm2,
            wrench=None,
            warnings=list(reading.warnings),
        )

    @cached_property
    def _tracking(self) -> StreamedTracking | None:
        return None if self._tracked is None else _streamed_tracking(self._tracked)

    def _image(self, images: ImageFormat, reading: Reading) -> StreamedImage:
        if images not in self._images:
            rows, cols = reading.image.shape[:2]
            encoded = cv2.imencode(f".{images}", reading.image)[1]
            self._images[images] = StreamedImage(images, cols, rows, base64.b64encode(encoded.tobytes()).decode())
        return self._images[images]


def _streamed_wrench(estimate: WrenchEstimate) -> StreamedWrench:
    centred = estimate.about_skin_centre()
    wrench, std = centred.wrench, [float(value) if np.isfinite(value) else None for value in centred.std]
    return StreamedWrench(wrench.force_n.tolist(), wrench.torque_nm.tolist(), std[:3], std[3:], estimate.touching)


def _streamed_tracking(found: TrackedContacts) -> StreamedTracking:
    contacts = [
        StreamedContact(
            one.number,
            one.centre_mm.tolist(),
            one.area_mm2,
            None if one.force is None else one.force.wrench.force_n.tolist(),
        )
        for one in found.contacts
    ]
    motion, slip = found.motion, found.slip
    moved = StreamedMotion(
        motion.path, motion.moved_mm.tolist(), motion.motion.rotation_vector_rad.tolist(), motion.std.tolist()
    )
    numbers = (slip.p_incipient, slip.p_gross, slip.sticking_share, slip.speed, slip.friction, slip.friction_std)
    known = [float(one) if np.isfinite(one) else None for one in numbers]
    return StreamedTracking(contacts, moved if motion.is_known else None, StreamedSlip(str(slip.state), *known))


class _ClientQueue:
    """The messages that wait for one client; where too many wait, the oldest are missed."""

    def __init__(self, wanted: StreamRequest) -> None:
        self.wanted = wanted
        self._waiting: asyncio.Queue[_SharedMessage] = asyncio.Queue(_QUEUED_READINGS)
        self._missed = 0

    def add(self, message: _SharedMessage) -> None:
        if self._waiting.full():
            self._missed += isinstance(self._waiting.get_nowait().source, Reading)
        self._waiting.put_nowait(message)

    async def next_message(self) -> bytes:
        """Wait for the next message, a reading with the number of those that this client missed before it."""
        message = await self._waiting.get()
        missed = self._missed if isinstance(message.source, Reading) else 0
        self._missed -= missed
        return message.encode(self.wanted, missed)


class ReadingServer:
    """Serves readings over TCP and WebSocket in a thread of its own while it is open (`with`); raises `DeviceError`.

    sensor: its name in the messages. host, allowed_origins: as for `SocketGuard.for_host`. Port 0 takes any free port.
    """

    def __init__(self, sensor: str, host: str, port: int, tcp_port: int, allowed_origins: tuple[str, ...] = ()) -> None:
        self.guard = SocketGuard.for_host(host, allowed_origins)
        self.port, self.tcp_port = port, tcp_port
        """Ports of WebSocket and TCP; those in use, once the server is open."""
        self._sensor = sensor
        self._queues = set[_ClientQueue]()
        self._tcp_tasks = set["asyncio.Task[None]"]()
        self._status: _SharedMessage | None = None
        """The status while the sensor does not simply read."""
        self._thread = ServerThread("serve readings")
        self._tracker: ContactTracker | None = None
        """None while no client asks for tracking."""

    @property
    def tcp_address(self) -> str:
        """Host and port for TCP clients."""
        return urlsplit(self.guard.page_address(self.tcp_port)).netloc

    @property
    def clients(self) -> int:
        """Number of the clients whose requests were accepted."""
        return len(self._queues)

    def publish(self, message: Reading | SensorSnapshot) -> None:
        """Hand a reading or a changed status to all clients, with what touches where one of them asks for it."""
        tracked = self._follow(message) if isinstance(message, Reading) else None
        self._thread.loop.call_soon_threadsafe(self._distribute, message, tracked)

    def _follow(self, reading: Reading) -> TrackedContacts | None:
        if not any(queue.wanted.tracking for queue in tuple(self._queues)):
            self._tracker = None
            return None
        self._tracker = self._tracker or ContactTracker()
        return self._tracker.update(reading)

    def serve(self, sensor: Sensor, should_stop: Callable[[], bool], notify: Callable[[str], None]) -> int:
        """Publish every reading of a sensor, and its status where that changes; return the number of readings.

        See `sensor_sharing.watch_sensor`.
        """
        served = itertools.count()

        def publish_reading(reading: Reading) -> None:
            self.publish(reading)
            next(served)

        for moment in watch_sensor(sensor, should_stop, notify, publish_reading):
            if moment.has_changed:
                self.publish(moment.snapshot)
        return next(served)

    def __enter__(self) -> "ReadingServer":
        self._thread.start(self._listen())
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.close()

    async def _listen(self) -> None:
        host, servers = self.guard.host, self._thread.servers
        with network_port_errors(host, self.port, "readings"):
            guarded = self.guard.serve(self._feed_websocket, self.port, _answer_request)
            websocket = await servers.enter_async_context(guarded)
        with network_port_errors(host, self.tcp_port, "readings", "--tcp-port"):
            tcp = await asyncio.start_server(self._feed_tcp, host, self.tcp_port, limit=_REQUEST_BYTES)
            servers.callback(self._end_tcp, tcp)
        self.port = next(iter(websocket.sockets)).getsockname()[1]
        self.tcp_port = tcp.sockets[0].getsockname()[1]

    def _end_tcp(self, server: asyncio.Server) -> None:
        server.close()
        for task in self._tcp_tasks:
            task.cancel()

    def _distribute(self, source: Reading | SensorSnapshot, tracked: TrackedContacts | None) -> None:
        message = _SharedMessage(source, self._sensor, tracked)
        if isinstance(source, SensorSnapshot):
            is_plain = source.phase is SensorPhase.READING and source.trouble is None
            self._status = None if is_plain else message
        for queue in self._queues:
            queue.add(message)

    async def _feed(self, wanted: StreamRequest, send: Callable[[bytes], Awaitable[None]]) -> None:
        """Send readings and statuses to a client until it leaves, at first the status where the sensor does not simply read."""
        queue = _ClientQueue(wanted)
        self._queues.add(queue)
        if self._status is not None:
            queue.add(self._status)
        try:
            while True:
                await send(await queue.next_message())
        finally:
            self._queues.discard(queue)

    async def _feed_websocket(self, connection: ServerConnection) -> None:
        request = connection.request
        wanted = _parse_query(request.path) if request is not None else None
        if wanted is None:  # refused before the handshake
            return
        feed = asyncio.ensure_future(self._feed(wanted, partial(connection.send, text=True)))
        leaving = asyncio.ensure_future(connection.wait_closed())  # noticed also while there are no readings
        await asyncio.wait({feed, leaving}, return_when=asyncio.FIRST_COMPLETED)
        leaving.cancel()
        feed.cancel()
        with suppress(ConnectionClosed, asyncio.CancelledError):
            await feed

    async def _feed_tcp(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer a TCP client: a request of one line, then readings; an error line where the request is refused."""
        task = asyncio.current_task()
        assert task is not None

        async def send(line: bytes) -> None:
            writer.write(line + b"\n")
            async with asyncio.timeout(self.guard.limits.send_timeout_s):
                await writer.drain()

        try:
            request = await self._tcp_request(reader)
            if len(self._tcp_tasks) >= self.guard.limits.clients:
                request = StreamedError(
                    f"expected at most {self.guard.limits.clients} clients, got one more; close others"
                )
            if isinstance(request, StreamedError):
                await send(msgspec.json.encode(request))
                writer.close()
            else:
                self._tcp_tasks.add(task)
                await self._feed(request, send)
        except (
            OSError,
            TimeoutError,
            asyncio.CancelledError,
        ):  # the client has left or does not read, or the server ends
            pass
        finally:
            self._tcp_tasks.discard(task)
            if not writer.is_closing():
                writer.transport.abort()

    async def _tcp_request(self, reader: asyncio.StreamReader) -> StreamRequest | StreamedError:
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
        if not hmac.compare_digest(request.token.encode(), self.guard.token.encode()):
            return StreamedError('expected "token" to be the one that the server printed, got another; copy it again')
        return request


async def _answer_request(connection: ServerConnection, request: Request) -> Response | None:
    """Serve the schema, refuse unknown addresses, and let WebSockets through."""
    path = urlsplit(request.path).path
    if path == "/schema.json":
        return connection.respond(200, json.dumps(reading_stream_json_schema(), indent=2))
    if path != "/" or _parse_query(request.path) is None:
        expected = "/, /?images=jpeg, /?images=png, /?tracking=true or /schema.json"
        return connection.respond(404, f"expected {expected}; correct the address\n")
    return None


def _parse_query(path: str) -> StreamRequest | None:
    """Return what the query of an address asks for; None for one that is not understood. The token is no part of it."""
    query = {name: values[-1] for name, values in parse_qs(urlsplit(path).query, keep_blank_values=True).items()}
    try:
        return None if "token" in query else msgspec.convert(query, StreamRequest, strict=False)
    except msgspec.ValidationError:
        return None

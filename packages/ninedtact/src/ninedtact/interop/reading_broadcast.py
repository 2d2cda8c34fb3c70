"""Readings of one sensor, and its status where that changes, to the clients of a server that runs in a thread of its own.

    sensor thread ──Reading or SensorSnapshot──▶ BroadcastServer.publish ──▶ server thread: a short queue for each client

`publish` never waits: a client that is too slow misses readings, the oldest first. `reading_stream` (JSON) and `foxglove` are
such servers.
"""

import asyncio
import errno
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from threading import Thread
from time import monotonic_ns
from types import TracebackType
from typing import Any, Generic, TypeVar

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from ninedtact.errors import DeviceError
from ninedtact.reading import Reading
from ninedtact.sensor import Sensor
from ninedtact.studio.sensor_poller import SensorOutageNotifier, SensorPhase, SensorPoller, SensorSnapshot

_POLL_S = 0.1

Shared = TypeVar("Shared")
Opened = TypeVar("Opened", bound="BroadcastServer[Any]")


class StreamPortRefused(DeviceError):
    """Raised for a port that is in use, or an address that this computer does not have."""


class ReadingQueue(Generic[Shared]):
    """The readings and statuses that wait for one client; where more than `most` wait, the oldest are missed."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._waiting: deque[tuple[Shared, bool]] = deque()
        """With each whether it is a reading, which counts where it is missed."""
        self._missed, self._arrived = 0, asyncio.Event()

    def add(self, shared: Shared, is_reading: bool = True) -> None:
        """Queue a reading or a status; where too many wait, the oldest is missed."""
        if len(self._waiting) == self._most:
            self._missed += self._waiting.popleft()[1]
        self._waiting.append((shared, is_reading))
        self._arrived.set()

    async def arrivals(self) -> AsyncIterator[tuple[Shared, int]]:
        """Yield readings and statuses without end, each reading with the number of those that this client missed before it."""
        while True:
            await self._arrived.wait()
            while self._waiting:
                shared, is_reading = self._waiting.popleft()
                missed = self._missed if is_reading else 0
                self._missed -= missed
                yield shared, missed
            self._arrived.clear()


class BroadcastServer(ABC, Generic[Shared]):
    """The base of the servers that hand readings to all clients: a thread, which runs while it is open (`with`), and queues.

    share: makes of a reading or a status what all clients are handed, such as an object that encodes it once; called in the
    server thread, and only while there are clients. queued: messages that wait for one client at most.
    """

    def __init__(self, share: Callable[[Reading | SensorSnapshot], Shared], queued: int) -> None:
        self._queued = queued
        self._queues = set[ReadingQueue[Shared]]()
        self._servers = AsyncExitStack()
        """What is closed when the server ends."""
        self._share = share
        self._status: SensorSnapshot | None = None
        """The status while the sensor does not simply read."""
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, name="serve readings", daemon=True)

    @abstractmethod
    async def _listen(self) -> None:
        """Open the ports; called in the server thread."""

    def __enter__(self: Opened) -> Opened:
        """Start the thread and listen, or end everything again; raises `StreamPortRefused`."""
        self._thread.start()
        try:
            self._call(self._listen())
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stop()

    def publish(self, message: Reading | SensorSnapshot) -> None:
        """Hand a reading or a changed status to all clients; returns at once."""
        self._loop.call_soon_threadsafe(self._distribute, message)

    @contextmanager
    def _queue(self) -> Iterator[ReadingQueue[Shared]]:
        """Yield the queue of a new client, which begins with the status where the sensor does not simply read."""
        queue = ReadingQueue[Shared](self._queued)
        self._queues.add(queue)
        self._add_status(queue)
        try:
            yield queue
        finally:
            self._queues.discard(queue)

    def _repeat_status(self) -> None:
        """Hand all clients the status again where the sensor does not simply read; called in the server thread."""
        self._add_status(*self._queues)

    def _add_status(self, *queues: ReadingQueue[Shared]) -> None:
        if self._status is not None:
            shared = self._share(self._status)
            for queue in queues:
                queue.add(shared, is_reading=False)

    def _distribute(self, message: Reading | SensorSnapshot) -> None:
        is_reading = isinstance(message, Reading)
        if isinstance(message, SensorSnapshot):
            is_plain = message.phase is SensorPhase.READING and message.trouble is None
            self._status = None if is_plain else message
        if self._queues:
            shared = self._share(message)
            for queue in self._queues:
                queue.add(shared, is_reading)

    @property
    def _is_running(self) -> bool:
        """Whether the server thread runs."""
        return self._loop.is_running()

    def _call(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine in the server thread and wait for it."""
        asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _stop(self) -> None:
        """Close the server and end its thread."""
        self._call(self._servers.aclose())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def feed_until_closed(connection: ServerConnection, *feeds: Awaitable[None]) -> None:
    """Run what sends to, and what receives from, a WebSocket client until one of them ends or the client leaves."""
    tasks = [asyncio.ensure_future(feed) for feed in feeds]
    leaving = asyncio.ensure_future(connection.wait_closed())  # noticed also while there are no readings
    await asyncio.wait({*tasks, leaving}, return_when=asyncio.FIRST_COMPLETED)
    for task in (*tasks, leaving):
        task.cancel()
    for task in tasks:
        with suppress(ConnectionClosed, asyncio.CancelledError):
            await task


def publish_readings(
    publish: Callable[[Reading | SensorSnapshot], None],
    sensor: Sensor,
    should_stop: Callable[[], bool],
    notify: Callable[[str], None] = lambda sentence: None,
) -> int:
    """Read a sensor and publish every reading, and every change of its status, until `should_stop` is true or its source ends.

    Returns the number of readings. notify: receives a sentence where no readings arrive any more, and where they do again.
    Raises what the sensor raises.
    """
    served, watch = 0, SensorOutageNotifier(notify)

    def count_and_publish(reading: Reading) -> None:
        nonlocal served
        publish(reading)
        served += 1

    with SensorPoller(sensor, count_and_publish) as poller:
        while not should_stop():
            poller.wait_for_change(_POLL_S)
            now = poller.snapshot(monotonic_ns())
            if now.phase is SensorPhase.FAILED and now.trouble is not None:
                raise now.trouble
            if watch.has_changed(now):
                publish(now)
            if now.phase is SensorPhase.ENDED:
                break
    return served


@contextmanager
def port_errors(host: str, port: int, option: str) -> Iterator[None]:
    """Raise `StreamPortRefused` where a port cannot be listened on."""
    try:
        yield
    except (OSError, OverflowError) as trouble:
        got = "one in use" if getattr(trouble, "errno", 0) == errno.EADDRINUSE else f"'{trouble}'"
        raise StreamPortRefused(
            f"expected port {port} on {host} to be free for readings, got {got}; choose another with {option}, or a host of "
            "this machine with --host"
        ) from trouble

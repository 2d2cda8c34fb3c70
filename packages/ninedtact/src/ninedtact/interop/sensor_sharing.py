"""What `ros2`, `foxglove` and `serve` share: the sensor thread that they watch, and a thread in which servers run."""

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from contextlib import AsyncExitStack
from threading import Thread
from time import monotonic_ns
from typing import Any, NamedTuple

from ninedtact.live.sensor_poller import SensorPhase, SensorPoller, SensorSnapshot
from ninedtact.reading import Reading
from ninedtact.sensor import Sensor

_POLL_S = 0.05


class SensorMoment(NamedTuple):
    """What a watched sensor does now."""

    poller: SensorPoller
    snapshot: SensorSnapshot
    new_reading: Reading | None
    """The newest reading, if it is another than at the moment before."""
    has_changed: bool
    """Whether phase or trouble of the sensor are others than at the moment before."""


def watch_sensor(
    sensor: Sensor,
    should_stop: Callable[[], bool],
    notify: Callable[[str], None] = lambda sentence: None,
    on_reading: Callable[[Reading], None] = lambda reading: None,
) -> Iterator[SensorMoment]:
    """Open a sensor and yield its moments, at least every 50 ms, until `should_stop` is true or its source ends.

    notify: receives a sentence where no readings arrive any more, and where they do again. on_reading: is called in the sensor
    thread with every reading; who takes the newest one at each moment never delays the sensor. Raises what the sensor raises.
    """
    last: Reading | None = None
    before: tuple[SensorPhase, type] = SensorPhase.READING, type(None)
    with SensorPoller(sensor, on_reading) as poller:
        while not should_stop():
            poller.wait_for_change(_POLL_S)
            now = poller.snapshot(monotonic_ns())
            if now.phase is SensorPhase.FAILED and now.trouble is not None:
                raise now.trouble
            state = now.phase, type(now.trouble)
            if state != before and now.trouble is not None:
                notify(now.trouble_sentence)
            elif state != before and before[1] is not type(None):
                notify("readings arrive again")
            yield SensorMoment(poller, now, None if now.reading is last else now.reading, state != before)
            last, before = now.reading, state
            if now.phase is SensorPhase.ENDED:
                return


class ServerThread:
    """A thread with an event loop in which servers run until it is closed."""

    def __init__(self, name: str) -> None:
        self.servers = AsyncExitStack()
        """What is closed when the thread ends."""
        self.loop = asyncio.new_event_loop()
        self._thread = Thread(target=self.loop.run_forever, name=name, daemon=True)

    def start(self, listen: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine that opens ports, or end everything again and raise what it raises."""
        self._thread.start()
        try:
            self._call(listen)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the servers and end the thread."""
        self._call(self.servers.aclose())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()

    def _call(self, work: Coroutine[Any, Any, None]) -> None:
        asyncio.run_coroutine_threadsafe(work, self.loop).result()

"""What `ros2`, `foxglove` and `serve` share: the sensor thread that they watch, and the error of a port that is taken."""

import errno
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic_ns
from typing import NamedTuple

from ninedtact.errors import DeviceError
from ninedtact.reading import Reading
from ninedtact.sensor import Sensor
from ninedtact.studio.sensor_poller import SensorOutageNotifier, SensorPhase, SensorPoller, SensorSnapshot

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
    last, watch = None, SensorOutageNotifier(notify)
    with SensorPoller(sensor, on_reading) as poller:
        while not should_stop():
            poller.wait_for_change(_POLL_S)
            now = poller.snapshot(monotonic_ns())
            if now.phase is SensorPhase.FAILED and now.trouble is not None:
                raise now.trouble
            yield SensorMoment(poller, now, None if now.reading is last else now.reading, watch.has_changed(now))
            last = now.reading
            if now.phase is SensorPhase.ENDED:
                return


@contextmanager
def port_errors(host: str, port: int, option: str) -> Iterator[None]:
    """Raise `DeviceError` where a port cannot be listened on."""
    try:
        yield
    except (OSError, OverflowError) as trouble:
        got = "one in use" if getattr(trouble, "errno", 0) == errno.EADDRINUSE else f"'{trouble}'"
        raise DeviceError(
            f"expected port {port} on {host} to be free for readings, got {got}; choose another with {option}, or a host of "
            "this machine with --host"
        ) from trouble

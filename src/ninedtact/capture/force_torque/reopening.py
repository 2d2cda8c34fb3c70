"""A force/torque sensor that survives an unplugged cable: the loss is told once, and reading goes on when it is back."""

from collections.abc import Callable
from threading import Event, Lock

from ninedtact.capture.force_torque.refusals import WrenchSensorNotFound
from ninedtact.capture.source import SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSensorLost, WrenchSource
from ninedtact.quantities import Wrench


class Reopening(WrenchSource):
    """Reads another source and reopens it after `WrenchSensorLost`; meanwhile `read` waits.

    `on_lost` and `on_back` are called in the thread that reads. A sensor that is absent at the first opening raises. What a
    device read when nothing touched may be another after its power was off: tare again.
    """

    def __init__(
        self,
        source: WrenchSource,
        on_lost: Callable[[WrenchSensorLost], None],
        on_back: Callable[[], None] = lambda: None,
        retry_ms: float = 500.0,
    ) -> None:
        self.name = source.name
        self.losses = 0
        self._source = source
        self._on_lost, self._on_back = on_lost, on_back
        self._retry_s = retry_ms / 1000
        self._closing, self._opening = Event(), Lock()

    def open(self) -> None:
        """Open the source; raises what it raises."""
        with self._opening:
            self._closing.clear()
            self._source.open()
            self.losses = 0

    def read(self) -> Wrench:
        """The next sample, however long the device is away."""
        while True:
            try:
                return self._source.read()
            except WrenchSensorLost as loss:
                self._wait_for_return(loss)

    def close(self) -> None:
        """Close the source, and end a wait for its return."""
        self._closing.set()
        with self._opening:
            self._source.close()

    def _wait_for_return(self, loss: WrenchSensorLost) -> None:
        if self._closing.is_set():
            raise SourceNotOpen(self.name)
        self.losses += 1
        self._on_lost(loss)
        self._source.close()
        while not self._returned():
            pass
        self._on_back()

    def _returned(self) -> bool:
        """Pause, then try once; opening and closing exclude each other, so that none is left open."""
        self._closing.wait(self._retry_s)
        with self._opening:
            if self._closing.is_set():
                raise SourceNotOpen(self.name)
            try:
                self._source.open()
            except WrenchSensorNotFound:
                return False
        return True

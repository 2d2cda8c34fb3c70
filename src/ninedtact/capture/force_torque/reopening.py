"""A force/torque sensor that survives an unplugged cable: the loss is told once, and reading goes on when it is back."""

from collections.abc import Callable

from ninedtact.capture.force_torque.refusals import WrenchSensorNotFound
from ninedtact.capture.returning import Returning
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
        self._source = source
        self._returning = Returning(source, WrenchSensorNotFound, on_lost, on_back, retry_ms)

    @property
    def losses(self) -> int:
        """Since it was opened."""
        return self._returning.losses

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._returning.open()

    def read(self) -> Wrench:
        """The next sample, however long the device is away."""
        while True:
            try:
                return self._source.read()
            except WrenchSensorLost as loss:
                self._returning.wait(loss)

    def close(self) -> None:
        """Close the source, and end a wait for its return."""
        self._returning.close()

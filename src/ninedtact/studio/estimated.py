"""Estimated wrenches as a source like any other, so that the page shows them beside measured ones."""

from queue import Empty, SimpleQueue
from threading import Event

from ninedtact.capture.frame_source import SourceEnded, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.force.estimator import ForceEstimator
from ninedtact.quantities import Wrench, WrenchEstimate
from ninedtact.reading import Reading

WAIT_S = 0.2
"""Between two looks at whether it was closed."""
MOST_WAITING = 256
"""Wrenches that nobody fetches are not kept for ever."""


class Overheard(ForceEstimator):
    """An estimator whose answers can also be read as a `WrenchSource`."""

    def __init__(self, estimator: ForceEstimator) -> None:
        self.name, self.estimator = estimator.name, estimator
        self.wrenches = EstimatedWrenches(estimator.name)

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """As the estimator answers."""
        found = self.estimator.estimate(reading)
        self.wrenches.tell(found.wrench)
        return found

    def forget(self) -> None:
        """As the estimator forgets."""
        self.estimator.forget()


class EstimatedWrenches(WrenchSource):
    """What an estimator tells, in its order, while it is open."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._told: SimpleQueue[Wrench] = SimpleQueue()
        self._opened, self._closed = Event(), Event()

    def tell(self, wrench: Wrench) -> None:
        """One more; dropped where nobody listens."""
        if self._opened.is_set() and self._told.qsize() < MOST_WAITING:
            self._told.put(wrench)

    def open(self) -> None:
        """Listen from now on."""
        self._closed.clear()
        self._opened.set()

    def read(self) -> Wrench:
        """The next one; raises `SourceNotOpen`, and `SourceEnded` when it is closed meanwhile."""
        if not self._opened.is_set():
            raise SourceNotOpen(self.name)
        while not self._closed.is_set():
            try:
                return self._told.get(timeout=WAIT_S)
            except Empty:
                continue
        raise SourceEnded(f"expected another estimate, got the end of {self.name}; stop here")

    def close(self) -> None:
        """Whoever waits is told that it ended."""
        self._opened.clear()
        self._closed.set()

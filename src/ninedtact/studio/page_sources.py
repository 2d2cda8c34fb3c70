"""A recording that starts over when it ends.

Estimated wrenches as a source like any other, so that the page shows them beside measured ones.
"""

from dataclasses import replace
from queue import Empty, SimpleQueue
from threading import Event, Lock

from ninedtact.capture.frame_source import FrameSource, SourceEnded, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.force.estimator import ForceEstimator
from ninedtact.quantities import Frame, Wrench, WrenchEstimate
from ninedtact.reading import Reading


class RepeatingSource(FrameSource):
    """Plays another source again and again; indices go on counting."""

    def __init__(self, source: FrameSource) -> None:
        self.name = source.name
        self._source = source
        self._first_index = self._next_index = 0
        self._is_open = False
        self._opening = Lock()

    def open(self) -> None:
        """Open the source; raises what it raises."""
        with self._opening:
            self._source.open()
            self._is_open = True
        self.recorded_hz = self._source.recorded_hz
        self._first_index = self._next_index = 0

    def read(self) -> Frame:
        """The next image; after the last comes the first."""
        try:
            frame = self._source.read()
        except SourceEnded:
            self._start_over()
            frame = self._source.read()
        self._next_index = self._first_index + frame.index + 1
        return replace(frame, index=self._next_index - 1)

    def close(self) -> None:
        """Close the source."""
        with self._opening:
            self._is_open = False
            self._source.close()

    def _start_over(self) -> None:
        with self._opening:
            if not self._is_open:
                raise SourceNotOpen(self.name)
            self._source.close()
            self._source.open()
        self._first_index = self._next_index


WAIT_S = 0.2
"""Between two looks at whether it was closed."""
MOST_WAITING = 256
"""Wrenches that nobody fetches are not kept for ever."""


class PublishingEstimator(ForceEstimator):
    """An estimator whose answers can also be read as a `WrenchSource`."""

    def __init__(self, estimator: ForceEstimator) -> None:
        self.name, self.estimator = estimator.name, estimator
        self.wrenches = _EstimateSource(estimator.name)

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """As the estimator answers."""
        found = self.estimator.estimate(reading)
        self.wrenches.tell(found.wrench)
        return found

    def forget(self) -> None:
        """As the estimator forgets."""
        self.estimator.forget()


class _EstimateSource(WrenchSource):
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

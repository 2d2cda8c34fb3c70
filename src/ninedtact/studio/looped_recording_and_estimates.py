"""Sources that only the live page needs: a recording that repeats, and the estimates of the running estimator as wrenches."""

from dataclasses import replace
from queue import Empty, SimpleQueue
from threading import Event, Lock

from ninedtact.capture.frame_source import FrameSource, SourceEnded, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.force.estimator_interface import ForceEstimator
from ninedtact.quantities import Frame, Wrench, WrenchEstimate
from ninedtact.reading import Reading


class RepeatingSource(FrameSource):
    """Wraps a source and starts it again when it ends; frame indices continue to count."""

    def __init__(self, source: FrameSource) -> None:
        self.name, self.is_live = source.name, source.is_live
        self._source = source
        self._first_index = self._next_index = 0
        self._is_open = False
        self._opening = Lock()

    def open(self) -> None:
        """Open the source; raises what the source raises."""
        with self._opening:
            self._source.open()
            self._is_open = True
        self.recorded_hz = self._source.recorded_hz
        self._first_index = self._next_index = 0

    def read(self) -> Frame:
        """Return the next image; the first one follows the last."""
        try:
            frame = self._source.read()
        except SourceEnded:
            self._start_over()
            frame = self._source.read()
        self._next_index = self._first_index + frame.index + 1
        return replace(frame, index=self._next_index - 1)

    def close(self) -> None:
        """Close the source that is repeated."""
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
"""Interval at which a waiting reader checks whether the source was closed."""
MOST_WAITING = 256
"""Largest number of wrenches that wait for a reader."""


class PublishingEstimator(ForceEstimator):
    """An estimator whose estimates can also be read from a `WrenchSource`, `wrenches`."""

    def __init__(self, estimator: ForceEstimator) -> None:
        self.name, self.estimator = estimator.name, estimator
        self.wrenches = EstimateSource(estimator.name)

    @property
    def notices(self) -> tuple[str, ...]:
        """The notices of the estimator."""
        return self.estimator.notices

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the estimate for a reading, and publish its wrench."""
        found = self.estimator.estimate(reading)
        self.wrenches.publish(found.wrench)
        return found

    def forget(self) -> None:
        """Discard what the estimator has stored of earlier readings."""
        self.estimator.forget()


class EstimateSource(WrenchSource):
    """The wrenches that an estimator publishes while the source is open, in their order."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._queue: SimpleQueue[Wrench] = SimpleQueue()
        self._opened, self._closed = Event(), Event()

    def publish(self, wrench: Wrench) -> None:
        """Add a wrench; it is dropped while the source is closed or its queue is full."""
        if self._opened.is_set() and self._queue.qsize() < MOST_WAITING:
            self._queue.put(wrench)

    def open(self) -> None:
        """Accept wrenches from now on."""
        self._closed.clear()
        self._opened.set()

    def read(self) -> Wrench:
        """Wait for the next wrench; raises `SourceNotOpen`, and `SourceEnded` when the source is closed meanwhile."""
        if not self._opened.is_set():
            raise SourceNotOpen(self.name)
        while not self._closed.is_set():
            try:
                return self._queue.get(timeout=WAIT_S)
            except Empty:
                continue
        raise SourceEnded(f"expected another estimate, got the end of {self.name}; stop here")

    def close(self) -> None:
        """Close the source; a waiting reader gets `SourceEnded`."""
        self._opened.clear()
        self._closed.set()

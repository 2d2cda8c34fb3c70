"""A source read in a thread of its own, so that nothing is lost while something else is done.

Images and samples in one stream: live ones as they come, those of recordings and stepped twins in turn.
"""

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass
from threading import Condition, Thread
from time import monotonic_ns
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.capture.wrench_source import WrenchSampleRejected, WrenchSource
from ninedtact.quantities import Frame, Wrench

Item = TypeVar("Item", covariant=True)


@runtime_checkable
class Source(Protocol[Item]):
    """A `FrameSource` or a `WrenchSource`."""

    name: str

    def open(self) -> None: ...  # noqa: D102
    def read(self) -> Item: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


@dataclass(frozen=True)
class Arrival(Generic[Item]):
    """What a source delivered, and when it did."""

    item: Item
    at_ns: int


class BackgroundReader(Generic[Item]):
    """Reads a source on and on while it is open (`with`); what nobody took in time is lost and counted."""

    def __init__(self, source: Source[Item], most: int, *excused: type[Exception]) -> None:
        """most: items that wait to be taken. excused: troubles that are handed over like items, the source going on."""
        self.source, self.lost = source, 0
        self._most, self._excused = most, excused
        self._items: deque[Arrival[Item]] = deque()
        self._trouble: BaseException | None = None
        self._news = Condition()
        self._closing = False
        self._thread = Thread(target=self._listen, name=f"listen to {source.name}", daemon=True)

    def take(self, wait_s: float = 0.0) -> Arrival[Item] | None:
        """The oldest item, or None when none came in time; after the last one raises what ended the source."""
        with self._news:
            self._news.wait_for(lambda: self._items or self._trouble, wait_s)
            if self._items:
                return self._items.popleft()
            if self._trouble is not None:
                raise self._trouble
            return None

    def __enter__(self) -> "BackgroundReader[Item]":
        """Open the source, raising what it raises."""
        self.source.open()
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._closing = True
        self.source.close()
        self._thread.join()

    def _listen(self) -> None:
        try:
            while not self._closing:
                self._hear(self._next())
        except BaseException as trouble:  # whoever takes is who can handle it
            with self._news:
                self._trouble = trouble
                self._news.notify_all()

    def _next(self) -> Any:
        try:
            return self.source.read()
        except self._excused as trouble:
            return trouble

    def _hear(self, item: Any) -> None:
        with self._news:
            if len(self._items) < self._most:
                self._items.append(Arrival(item, monotonic_ns()))
                self._news.notify_all()
            else:
                self.lost += 1


AHEAD_NS = 300_000_000
"""By which samples are read before the next image is."""
IMAGES_AT_MOST, SAMPLES_AT_MOST = 128, 100_000
WAIT_S = 0.02

MergedArrival = Arrival[Frame | Wrench | WrenchSampleRejected] | None
"""None: nothing came for a moment."""


def merge_live_streams(camera: FrameSource, force_torque: WrenchSource) -> Generator[MergedArrival, None, None]:
    """What two devices deliver, each read in a thread of its own; raises what they raise, ends with a recording."""
    with (
        BackgroundReader[Wrench](force_torque, SAMPLES_AT_MOST, WrenchSampleRejected) as samples,
        BackgroundReader[Frame](camera, IMAGES_AT_MOST) as images,
    ):
        try:
            while True:
                while (sample := samples.take()) is not None:
                    yield sample
                yield images.take(WAIT_S)
        except SourceEnded:
            return


def merge_recorded_streams(camera: FrameSource, force_torque: WrenchSource) -> Generator[MergedArrival, None, None]:
    """Every image and every sample in the order of their stamps, as fast as they are asked for, until one ends."""
    newest_ns = 0
    with force_torque, camera:
        try:
            while True:
                frame = camera.read()
                yield Arrival(frame, frame.stamp_ns)
                while newest_ns < frame.stamp_ns + AHEAD_NS:
                    sample = next_sample(force_torque)
                    newest_ns = max(newest_ns, sample.stamp_ns if isinstance(sample, Wrench) else 0)
                    yield Arrival(sample, newest_ns)
        except SourceEnded:
            return


def next_sample(force_torque: WrenchSource) -> Wrench | WrenchSampleRejected:
    """The next one, or why it must not be used."""
    try:
        return force_torque.read()
    except WrenchSampleRejected as reason:
        return reason

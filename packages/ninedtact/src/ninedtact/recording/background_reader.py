"""Reads a live source in a background thread, so that whoever takes its items delays no source, and says when it stalls."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, Full, Queue
from threading import Thread
from time import monotonic, monotonic_ns
from typing import Any, Generic, TypeVar

from ninedtact.capture.frame_source import FrameSource, require_frame
from ninedtact.capture.wrench_source import WrenchSource

_WAIT_S = 0.05
STALL_S = 3.0
"""Time without an item after which a live source counts as stalled. Cameras and streams report a loss on their own after 2 s; this
covers a source that does neither."""

Item = TypeVar("Item", covariant=True)


@dataclass(frozen=True)
class Arrival(Generic[Item]):
    """An item that a source delivered, with the time of its arrival."""

    item: Item
    at_ns: int


class BackgroundReader(Generic[Item]):
    """Reads a source continuously in a thread while it is open (`with`); items that were not taken in time are lost."""

    def __init__(
        self,
        source: FrameSource | WrenchSource,
        capacity: int,
        *delivered_errors: type[Exception],
        on_stall: Callable[[str], None] = lambda sentence: None,
        stall_s: float = STALL_S,
    ) -> None:
        """capacity: items that wait to be taken. delivered_errors: errors that are delivered like items; reading continues.

        on_stall: called by `take` with a sentence, once each time that nothing has arrived for `stall_s`.
        """
        self.source, self._stall_s = source, stall_s
        self._on_stall, self._stall_at = on_stall, float("inf")
        self._delivered_errors = delivered_errors
        self._items: Queue[Arrival[Any]] = Queue(capacity)
        self._error: BaseException | None = None
        self._closing = False
        self._thread = Thread(target=self._read_all, name=f"listen to {source.name}", daemon=True)

    @property
    def waiting(self) -> int:
        """Number of items that were read and not yet taken."""
        return self._items.qsize()

    def take(self, wait_s: float = 0.0) -> Arrival[Item] | None:
        """Return the oldest item, or None when none arrives in time; after the last one raises what ended the source."""
        has_ended = self._error is not None  # before the look into the queue, whose last item precedes the end
        with suppress(Empty):
            arrival = self._items.get(timeout=wait_s)
            self._stall_at = monotonic() + self._stall_s
            return arrival
        if has_ended and self._error is not None:
            raise self._error
        if monotonic() > self._stall_at:
            self._stall_at = float("inf")
            self._on_stall(
                f"nothing has arrived from {self.source.name} for {self._stall_s:g} s; check it and its cable"
            )
        return None

    def __enter__(self) -> "BackgroundReader[Item]":
        """Open the source, raising what it raises."""
        self.source.open_for(self)
        self._stall_at = monotonic() + self._stall_s
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self.source.close_for(self)
        self._thread.join()

    def _put(self, arrival: Arrival[Any]) -> None:
        """Keep an item until it is taken. Where no more have room, a device loses it, and a file waits, which goes on by itself."""
        waits = isinstance(self.source, FrameSource) and not self.source.is_live
        while not self._closing:
            with suppress(Full):
                self._items.put(arrival, block=waits, timeout=_WAIT_S)
                break
            if not waits:
                break

    def _read_all(self) -> None:
        try:
            while not self._closing:
                item: Any
                try:
                    item = self.source.read()
                    if isinstance(self.source, FrameSource):
                        require_frame(item, self.source.name)
                except self._delivered_errors as error:
                    item = error
                self._put(Arrival(item, monotonic_ns()))
        except BaseException as error:  # handed to the thread that takes items
            self._error = error

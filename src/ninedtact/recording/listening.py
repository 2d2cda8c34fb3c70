"""A source read in a thread of its own, so that nothing is lost while something else is done."""

from collections import deque
from dataclasses import dataclass
from threading import Condition, Thread
from time import monotonic_ns
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

Item = TypeVar("Item", covariant=True)


@runtime_checkable
class Source(Protocol[Item]):
    """A `FrameSource` or a `WrenchSource`."""

    name: str

    def open(self) -> None: ...  # noqa: D102
    def read(self) -> Item: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


@dataclass(frozen=True)
class Heard(Generic[Item]):
    """What a source delivered, and when it did."""

    item: Item
    at_ns: int


class Listening(Generic[Item]):
    """Reads a source on and on while it is open (`with`); what nobody took in time is lost and counted."""

    def __init__(self, source: Source[Item], most: int, *excused: type[Exception]) -> None:
        """most: items that wait to be taken. excused: troubles that are handed over like items, the source going on."""
        self.source, self.lost = source, 0
        self._most, self._excused = most, excused
        self._items: deque[Heard[Item]] = deque()
        self._trouble: BaseException | None = None
        self._news = Condition()
        self._closing = False
        self._thread = Thread(target=self._listen, name=f"listen to {source.name}", daemon=True)

    def take(self, wait_s: float = 0.0) -> Heard[Item] | None:
        """The oldest item, or None when none came in time; after the last one raises what ended the source."""
        with self._news:
            self._news.wait_for(lambda: self._items or self._trouble, wait_s)
            if self._items:
                return self._items.popleft()
            if self._trouble is not None:
                raise self._trouble
            return None

    def __enter__(self) -> "Listening[Item]":
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
                self._items.append(Heard(item, monotonic_ns()))
                self._news.notify_all()
            else:
                self.lost += 1

"""How a device that went away is waited for: the loss is told once, it is opened again and again until it is back."""

from collections.abc import Callable
from threading import Event, Lock
from typing import Generic, TypeVar

from ninedtact.capture.openable import Openable
from ninedtact.capture.source import SourceNotOpen

Loss = TypeVar("Loss", bound=Exception)


class Returning(Generic[Loss]):
    """The opening and closing of a source that may go away. Calls `on_lost` and `on_back` in the thread that waits."""

    def __init__(
        self,
        source: Openable,
        absent: type[Exception],
        on_lost: Callable[[Loss], None],
        on_back: Callable[[], None],
        retry_ms: float,
    ) -> None:
        """absent: what the source raises on opening as long as its device is away."""
        self.losses = 0
        self._source, self._absent = source, absent
        self._on_lost, self._on_back = on_lost, on_back
        self._retry_s = retry_ms / 1000
        self._closing, self._opening = Event(), Lock()

    def open(self) -> None:
        """Open the source; raises what it raises."""
        with self._opening:
            self._closing.clear()
            self._source.open()
            self.losses = 0

    def close(self) -> None:
        """Close the source, and end a wait for its return."""
        self._closing.set()
        with self._opening:
            self._source.close()

    def wait(self, loss: Loss) -> None:
        """Until it is back; raises `SourceNotOpen` when it is closed meanwhile."""
        if self._closing.is_set():
            raise SourceNotOpen(self._source.name)
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
                raise SourceNotOpen(self._source.name)
            try:
                self._source.open()
            except self._absent:
                return False
        return True

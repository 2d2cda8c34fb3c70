"""A source that survives an unplugged cable: the loss is reported once, and reading goes on when the camera is back."""

from collections.abc import Callable
from dataclasses import replace
from threading import Event, Lock

from ninedtact.capture.source import CameraLost, CameraNotFound, FrameSource, SourceNotOpen
from ninedtact.quantities import Frame


class Reconnecting(FrameSource):
    """Reads another source and reopens it after `CameraLost`; meanwhile `read` waits, so put `Freshest` around it.

    `on_lost` and `on_back` are called in the thread that reads. A camera that is absent at the first opening raises:
    a wrong name should be told at once.
    """

    def __init__(
        self,
        source: FrameSource,
        on_lost: Callable[[CameraLost], None],
        on_back: Callable[[], None] = lambda: None,
        retry_ms: float = 500.0,
    ) -> None:
        self.name = source.name
        self.losses = 0
        self._source = source
        self._on_lost, self._on_back = on_lost, on_back
        self._retry_s = retry_ms / 1000
        self._closing = Event()
        self._opening = Lock()
        self._first_index = self._next_index = 0

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._closing.clear()
        self._source.open()
        self.recorded_hz = self._source.recorded_hz
        self.losses = self._first_index = self._next_index = 0

    def read(self) -> Frame:
        """The next picture, however long the camera is away; indices go on counting over the gap."""
        while True:
            try:
                frame = self._source.read()
            except CameraLost as loss:
                self._wait_for_return(loss)
            else:
                self._next_index = self._first_index + frame.index + 1
                return replace(frame, index=self._next_index - 1)

    def close(self) -> None:
        """Close the source, and end a wait for its return."""
        self._closing.set()
        with self._opening:
            self._source.close()

    def _wait_for_return(self, loss: CameraLost) -> None:
        if self._closing.is_set():
            raise SourceNotOpen(self.name)
        self.losses += 1
        self._on_lost(loss)
        self._source.close()
        while not self._returned():
            pass
        self._first_index = self._next_index
        self._on_back()

    def _returned(self) -> bool:
        """Pause, then try once; opening and closing exclude each other, so that none is left open."""
        self._closing.wait(self._retry_s)
        with self._opening:
            if self._closing.is_set():
                raise SourceNotOpen(self.name)
            try:
                self._source.open()
            except CameraNotFound:
                return False
        return True

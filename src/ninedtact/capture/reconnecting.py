"""How a device that went away is waited for: the loss is told once, it is opened again and again until it is back.

A source that survives an unplugged cable: the loss is reported once, and reading goes on when the camera is back.

A force/torque sensor that survives an unplugged cable: the loss is told once, and reading goes on when it is back.
"""

from collections.abc import Callable
from dataclasses import replace
from threading import Event, Lock
from typing import Generic, TypeVar

from ninedtact.capture.frame_source import CameraLost, CameraNotFound, FrameSource, Openable, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSensorLost, WrenchSensorNotFound, WrenchSource
from ninedtact.quantities import Frame, Wrench

Loss = TypeVar("Loss", bound=Exception)


class Reconnector(Generic[Loss]):
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


class ReconnectingFrameSource(FrameSource):
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
        self._source = source
        self._returning = Reconnector(source, CameraNotFound, on_lost, on_back, retry_ms)
        self._first_index = self._next_index = 0

    @property
    def losses(self) -> int:
        """Since it was opened."""
        return self._returning.losses

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._returning.open()
        self.recorded_hz = self._source.recorded_hz
        self._first_index = self._next_index = 0

    def read(self) -> Frame:
        """The next image, however long the camera is away; indices go on counting over the gap."""
        while True:
            try:
                frame = self._source.read()
            except CameraLost as loss:
                self._returning.wait(loss)
                self._first_index = self._next_index
            else:
                self._next_index = self._first_index + frame.index + 1
                return replace(frame, index=self._next_index - 1)

    def close(self) -> None:
        """Close the source, and end a wait for its return."""
        self._returning.close()


class ReconnectingWrenchSource(WrenchSource):
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
        self._returning = Reconnector(source, WrenchSensorNotFound, on_lost, on_back, retry_ms)

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

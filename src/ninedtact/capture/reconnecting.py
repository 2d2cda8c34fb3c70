"""Sources that survive an unplugged cable: they report the loss once and continue when the device is back."""

from collections.abc import Callable
from dataclasses import replace
from threading import Event, Lock
from typing import Generic, TypeVar

from ninedtact.capture.frame_source import CameraLost, CameraNotFound, FrameSource, Openable, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSensorLost, WrenchSensorNotFound, WrenchSource
from ninedtact.quantities import Frame, Wrench

Loss = TypeVar("Loss", bound=Exception)


class _Reconnector(Generic[Loss]):
    """Opens and closes a device that may disappear; calls `on_lost` and `on_back` in the thread that waits for it."""

    def __init__(
        self,
        source: Openable,
        absent: type[Exception],
        on_lost: Callable[[Loss], None],
        on_back: Callable[[], None],
        retry_ms: float,
    ) -> None:
        """absent: the error that the source raises on opening while its device is missing."""
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
        """Close the source, and end a wait for the device."""
        self._closing.set()
        with self._opening:
            self._source.close()

    def wait_until_back(self, loss: Loss) -> None:
        """Report the loss and return when the device is open again; raises `SourceNotOpen` when closed meanwhile."""
        if self._closing.is_set():
            raise SourceNotOpen(self._source.name)
        self.losses += 1
        self._on_lost(loss)
        self._source.close()
        while not self._try_to_open():
            pass
        self._on_back()

    def _try_to_open(self) -> bool:
        """Pause, then try once to open. Opening and closing exclude each other, so that no device stays open."""
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
    """Reads another source and reopens it after `CameraLost`.

    Meanwhile `read` waits, so put `LatestFrameSource` around it. `on_lost` and `on_back` are called in the thread that reads.
    A camera that is absent at the first opening raises, because a wrong name should be reported at once.
    """

    def __init__(
        self,
        source: FrameSource,
        on_lost: Callable[[CameraLost], None],
        on_back: Callable[[], None] = lambda: None,
        retry_ms: float = 500.0,
    ) -> None:
        self.name, self.is_live = source.name, source.is_live
        self._source = source
        self._reconnector = _Reconnector(source, CameraNotFound, on_lost, on_back, retry_ms)
        self._first_index = self._next_index = 0

    @property
    def losses(self) -> int:
        """How often the camera was lost since the source was opened."""
        return self._reconnector.losses

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._reconnector.open()
        self.recorded_hz = self._source.recorded_hz
        self._first_index = self._next_index = 0

    def read(self) -> Frame:
        """Wait for the next frame, however long the camera is away; indices continue over the gap."""
        while True:
            try:
                frame = self._source.read()
            except CameraLost as loss:
                self._reconnector.wait_until_back(loss)
                self._first_index = self._next_index
            else:
                self._next_index = self._first_index + frame.index + 1
                return replace(frame, index=self._next_index - 1)

    def close(self) -> None:
        """Close the source, and end a wait for the camera."""
        self._reconnector.close()


class ReconnectingWrenchSource(WrenchSource):
    """Reads another source and reopens it after `WrenchSensorLost`; meanwhile `read` waits.

    `on_lost` and `on_back` are called in the thread that reads. A sensor that is absent at the first opening raises. The zero
    of a device may change while its power is off, so tare again after `on_back`.
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
        self._reconnector = _Reconnector(source, WrenchSensorNotFound, on_lost, on_back, retry_ms)

    @property
    def losses(self) -> int:
        """How often the sensor was lost since the source was opened."""
        return self._reconnector.losses

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._reconnector.open()

    def read(self) -> Wrench:
        """Wait for the next sample, however long the sensor is away."""
        while True:
            try:
                return self._source.read()
            except WrenchSensorLost as loss:
                self._reconnector.wait_until_back(loss)

    def close(self) -> None:
        """Close the source, and end a wait for the sensor."""
        self._reconnector.close()

"""Sources that survive an unplugged cable, reporting the loss once, and recordings that start again when they end."""

from collections.abc import Callable
from dataclasses import replace
from threading import Event, Lock
from typing import ClassVar, Generic, TypeVar

from ninedtact.capture.frame_source import (
    CameraLost,
    FrameSource,
    FrameSourceWrapper,
    Inner,
    SourceEnded,
    SourceNotOpen,
    SourceWrapper,
)
from ninedtact.capture.wrench_source import WrenchSensorLost, WrenchSource, WrenchSourceWrapper
from ninedtact.errors import CameraError, DeviceError
from ninedtact.quantities import Frame, Wrench

Loss = TypeVar("Loss", bound=Exception)


class _ReconnectingSource(SourceWrapper[Inner], Generic[Inner, Loss]):
    """Wraps a source whose device may disappear, and waits until it is back.

    `on_lost` and `on_back` are called in the thread that reads. A device that is absent at the first opening raises, because a
    wrong name should be reported at once.
    """

    _absence: ClassVar[type[Exception] | tuple[()]]
    """The error that the source raises on opening while its device is missing; none where it cannot be missing."""

    def __init__(
        self,
        source: Inner,
        on_lost: Callable[[Loss], None],
        on_back: Callable[[], None] = lambda: None,
        retry_ms: float = 500.0,
    ) -> None:
        super().__init__(source)
        self._on_lost, self._on_back = on_lost, on_back
        self._retry_s = retry_ms / 1000
        self._closing, self._opening = Event(), Lock()
        self._is_open = False

    def open(self) -> None:
        with self._opening:
            if self._is_open:
                return
            self._closing.clear()
            self._source.open_for(self)
            self._is_open = True
            self._first_index = self._next_index = 0

    def close(self) -> None:
        """Close the source, and end a wait for the device."""
        self._closing.set()
        with self._opening:
            self._is_open = False
            self._source.close_for(self)

    def _wait_until_back(self, loss: Loss) -> None:
        """Report the loss and return when the device is open again; raises `SourceNotOpen` when closed meanwhile."""
        if self._closing.is_set():
            raise SourceNotOpen(self.name)
        self._on_lost(loss)
        self._source.close_for(self)
        while not self._try_to_open():
            pass
        self._on_back()

    def _try_to_open(self) -> bool:
        """Pause, then try once to open. Opening and closing exclude each other, so that no device stays open."""
        self._closing.wait(self._retry_s)
        with self._opening:
            if self._closing.is_set():
                raise SourceNotOpen(self.name)
            try:
                self._source.open_for(self)
            except self._absence:
                return False
        return True


class ReconnectingFrameSource(_ReconnectingSource[FrameSource, CameraError], FrameSourceWrapper):
    """Reads another source and reopens it after `CameraLost`; meanwhile `read` waits, so put `LatestFrameSource` around it."""

    _loss: ClassVar[type[CameraError]] = CameraLost
    _absence: ClassVar[type[Exception] | tuple[()]] = CameraError

    def read(self) -> Frame:
        """Wait for the next frame, however long the camera is away; indices continue over the gap."""
        while True:
            try:
                frame = self._read_source()
            except self._loss as loss:
                self._wait_until_back(loss)
                self._first_index = self._next_index
            else:
                self._next_index = self._first_index + frame.index + 1
                return replace(frame, index=self._next_index - 1)


class RepeatingSource(ReconnectingFrameSource):
    """Reads a recording and starts it again when it ends; frame indices continue to count."""

    _loss, _absence = SourceEnded, ()

    def __init__(self, source: FrameSource) -> None:
        super().__init__(source, self._require_images, retry_ms=0.0)

    def _require_images(self, end: CameraError) -> None:
        """Raise the end of a recording that has no image."""
        if self._next_index == self._first_index:
            raise end


class ReconnectingWrenchSource(_ReconnectingSource[WrenchSource, WrenchSensorLost], WrenchSourceWrapper):
    """Reads another source and reopens it after `WrenchSensorLost`; meanwhile `read` waits.

    The zero of a device may change while its power is off, so tare again after `on_back`.
    """

    _absence = DeviceError

    def read(self) -> Wrench:
        """Wait for the next sample, however long the sensor is away."""
        while True:
            try:
                return self._source.read()
            except WrenchSensorLost as loss:
                self._wait_until_back(loss)

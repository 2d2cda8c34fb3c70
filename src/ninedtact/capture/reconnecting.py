"""A source that survives an unplugged cable: the loss is reported once, and reading goes on when the camera is back."""

from collections.abc import Callable
from dataclasses import replace

from ninedtact.capture.returning import Returning
from ninedtact.capture.source import CameraLost, CameraNotFound, FrameSource
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
        self._source = source
        self._returning = Returning(source, CameraNotFound, on_lost, on_back, retry_ms)
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

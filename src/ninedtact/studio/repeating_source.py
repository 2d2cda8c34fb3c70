"""A recording that starts again when it ends, for the live page."""

from dataclasses import replace
from threading import Lock

from ninedtact.capture.frame_source import FrameSource, SourceEnded, SourceNotOpen
from ninedtact.quantities import Frame


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

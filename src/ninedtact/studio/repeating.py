"""A recording that starts over when it ends."""

from dataclasses import replace
from threading import Lock

from ninedtact.capture.frame_source import FrameSource, SourceEnded, SourceNotOpen
from ninedtact.quantities import Frame


class Repeating(FrameSource):
    """Plays another source again and again; indices go on counting."""

    def __init__(self, source: FrameSource) -> None:
        self.name = source.name
        self._source = source
        self._first_index = self._next_index = 0
        self._is_open = False
        self._opening = Lock()

    def open(self) -> None:
        """Open the source; raises what it raises."""
        with self._opening:
            self._source.open()
            self._is_open = True
        self.recorded_hz = self._source.recorded_hz
        self._first_index = self._next_index = 0

    def read(self) -> Frame:
        """The next image; after the last comes the first."""
        try:
            frame = self._source.read()
        except SourceEnded:
            self._start_over()
            frame = self._source.read()
        self._next_index = self._first_index + frame.index + 1
        return replace(frame, index=self._next_index - 1)

    def close(self) -> None:
        """Close the source."""
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

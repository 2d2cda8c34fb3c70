"""A recording as if it were now."""

import time
from dataclasses import replace
from threading import Event

from ninedtact.capture.source import FrameSource
from ninedtact.quantities import Frame


class AsIfNow(FrameSource):
    """A recording at its own pace, its images stamped when they are read, as a camera's would be: its own stamps are too
    old to be shown live. A source that is live passes unchanged.
    """

    def __init__(self, source: FrameSource) -> None:
        self.name = source.name
        self._source = source
        self._closing = Event()
        self._due_at = 0.0

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._source.open()
        self._closing.clear()
        self._due_at = time.monotonic()

    def read(self) -> Frame:
        """The next image when it is due."""
        if self._source.recorded_hz is None:
            return self._source.read()
        self._closing.wait(self._due_at - time.monotonic())
        frame, pace_s = self._source.read(), 1 / self._source.recorded_hz
        self._due_at = max(self._due_at + pace_s, time.monotonic() - pace_s)
        return replace(frame, stamp_ns=time.monotonic_ns())

    def close(self) -> None:
        """Close the source."""
        self._closing.set()
        self._source.close()

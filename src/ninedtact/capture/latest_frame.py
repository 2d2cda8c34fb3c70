"""The newest image of a source, fetched in the background, so that a slow reader is late by one image at most.

A recording as if it were now.
"""

import time
from dataclasses import replace
from threading import Condition, Event, Thread
from types import TracebackType

from ninedtact.capture.frame_source import FrameSource, SourceNotOpen
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame


class NoRecentFrame(NinedtactError):
    """No image came that is both new to the reader and young enough."""


class LatestFrameSource(FrameSource):
    """Serves each image at most once and none older than `max_age_ms`; counts those that nobody read as dropped.

    A recording plays at its `recorded_hz` and a slow reader misses images of it, as it would of a camera; read the
    recording itself to get every one. Trouble of the source is raised to the reader, after the last fresh image.
    """

    def __init__(self, source: FrameSource, max_age_ms: float = 200.0, timeout_ms: float = 2000.0) -> None:
        self.name = source.name
        self.dropped = 0
        self._source = source
        self._max_age_ms, self._timeout_ms = max_age_ms, timeout_ms
        self._news = Condition()
        self._unread: Frame | None = None
        self._trouble: BaseException | None = None
        self._trouble_from: TracebackType | None = None
        self._closing = Event()
        self._thread: Thread | None = None

    def open(self) -> None:
        """Open the source and start fetching; raises what the source raises."""
        if self._thread is not None:
            return
        self._source.open()
        self.dropped, self._unread, self._trouble = 0, None, None
        self._closing = Event()
        self._thread = Thread(target=self._fetch, name=f"fetch {self.name}", daemon=True)
        self._thread.start()

    def read(self) -> Frame:
        """Wait for an image that is new and fresh; `NoRecentFrame` after `timeout_ms`, or the source's own trouble."""
        if self._thread is None:
            raise SourceNotOpen(self.name)
        give_up_at = time.monotonic() + self._timeout_ms / 1000
        with self._news:
            while (frame := self._take_fresh()) is None:
                if self._trouble is not None:
                    raise self._trouble.with_traceback(self._trouble_from)
                if time.monotonic() >= give_up_at:
                    raise self._stale()
                self._news.wait(give_up_at - time.monotonic())
        return frame

    def close(self) -> None:
        """Stop fetching and close the source; no thread is left behind."""
        thread, self._thread = self._thread, None
        self._closing.set()
        self._source.close()
        if thread is not None:
            thread.join()

    def _take_fresh(self) -> Frame | None:
        frame, self._unread = self._unread, None
        if frame is not None and time.monotonic_ns() - frame.stamp_ns > self._max_age_ms * 1e6:
            self.dropped += 1
            return None
        return frame

    def _stale(self) -> NoRecentFrame:
        return NoRecentFrame(
            f"expected a new image younger than {self._max_age_ms:g} ms from {self.name}, got none within "
            f"{self._timeout_ms:g} ms; see that the camera is plugged in, and not slower than that"
        )

    def _fetch(self) -> None:
        try:
            self._fetch_until_closed()
        except BaseException as trouble:  # the reader's thread is where it can be handled
            self._end_with(SourceNotOpen(self.name) if self._closing.is_set() else trouble)
        else:
            self._end_with(SourceNotOpen(self.name))

    def _fetch_until_closed(self) -> None:
        pace_s = 1 / self._source.recorded_hz if self._source.recorded_hz else 0.0
        due_at = time.monotonic()
        while not self._closing.wait(due_at - time.monotonic()):
            self._publish(self._source.read())
            due_at = max(due_at + pace_s, time.monotonic() - pace_s)

    def _publish(self, frame: Frame) -> None:
        with self._news:
            self.dropped += self._unread is not None
            self._unread = frame
            self._news.notify_all()

    def _end_with(self, trouble: BaseException) -> None:
        with self._news:
            self._trouble, self._trouble_from = trouble, trouble.__traceback__
            self._news.notify_all()


class LivePlayback(FrameSource):
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

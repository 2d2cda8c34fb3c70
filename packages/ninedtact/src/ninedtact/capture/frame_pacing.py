"""Wrappers that pace a source: `LatestFrameSource` returns the newest frame of a live source, `LivePlayback` plays a recording
at its own rate. `DelayCorrectedSource` subtracts the camera's delay from the stamps.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from threading import Condition, Event, Thread
from typing import Annotated

from msgspec import Meta

from ninedtact.bounds import checks_arguments
from ninedtact.capture.frame_source import FrameSource, FrameSourceWrapper, SourceIncomplete, SourceNotOpen
from ninedtact.errors import CameraError
from ninedtact.quantities import Frame

_LONGEST_DELAY_NS = 100_000_000
"""Delay of a frame that is played from which on the following ones are delayed as much; a live view drops what is 200 ms old."""
_LONGEST_PAUSE_NS = 1_000_000_000
"""Time between two frames of a recording after which a player goes on; a live view counts a camera as lost after 2 s."""
_Milliseconds = Annotated[float, Meta(gt=0)]


class NoRecentFrame(CameraError):
    """Raised where no frame arrived that is both new to the reader and recent enough."""


@checks_arguments
class LatestFrameSource(FrameSourceWrapper):
    """Reads another source in the background and returns its newest frame, so that a slow reader lags by one frame at most.

    Each frame is returned at most once and none older than `max_age_ms`; frames that nobody read are counted as dropped.
    An error of the source is raised to the reader, after the last recent frame. A recording should be paced (`LivePlayback`).

        with LatestFrameSource(camera_or_file_source("0")) as camera:
            frame = camera.read()
    """

    def __init__(
        self,
        source: FrameSource,
        max_age_ms: _Milliseconds = 200.0,
        timeout_ms: _Milliseconds = 2000.0,
    ) -> None:
        super().__init__(source)
        self.dropped = 0
        """Frames that were too old or replaced by a newer one before anybody read them."""
        self.newest_frame: Frame | None = None
        """The newest frame of the source, read or not, also one that is too old to be read; None before the first."""
        self._max_age_ms, self._timeout_ms = max_age_ms, timeout_ms
        self._changed = Condition()
        self._unread: Frame | None = None
        self._error: BaseException | None = None
        self._closing = Event()
        self._thread: Thread | None = None

    def open(self) -> None:
        """Open the source and start reading it in the background; raises what the source raises."""
        if self._thread is not None:
            return
        self._source.open_for(self)
        self.dropped, self._unread, self._error, self.newest_frame = 0, None, None, None
        self._closing = Event()
        self._thread = Thread(target=self._fetch, name=f"fetch {self.name}", daemon=True)
        self._thread.start()

    def read(self) -> Frame:
        """Wait for a new and recent frame; raises `NoRecentFrame` after `timeout_ms`, or the error of the source."""
        if self._thread is None:
            raise SourceNotOpen(self.name)
        give_up_at, dropped_before = time.monotonic() + self._timeout_ms / 1000, self.dropped
        with self._changed:
            while (frame := self._take_recent()) is None:
                if self._error is not None:
                    raise self._error.with_traceback(None)
                if time.monotonic() >= give_up_at:
                    raise self._no_recent_frame(self.dropped - dropped_before)
                self._changed.wait(give_up_at - time.monotonic())
        return frame

    def close(self) -> None:
        """Stop the background thread and close the source."""
        thread, self._thread = self._thread, None
        self._closing.set()
        super().close()
        if thread is not None:
            thread.join()

    def _no_recent_frame(self, too_old: int) -> NoRecentFrame:
        """Return the error after a wait in which this many images arrived too late."""
        got, remedy = "none", "check that the camera is plugged in, and not slower than that"
        if too_old:
            got = f"{too_old} that came more than {self._max_age_ms / 1000:g} s late"
            remedy = "the camera works, and the computer is too slow: end other programs, or set a lower rate or size"
        elif "://" in self.name:
            remedy = "check the camera and the network"
        return NoRecentFrame(
            expected=f"a new image from {self.name}",
            got=f"{got} within {self._timeout_ms / 1000:g} s",
            remedy=remedy,
        )

    def _take_recent(self) -> Frame | None:
        frame, self._unread = self._unread, None
        if frame is not None and time.monotonic_ns() - frame.stamp_ns > self._max_age_ms * 1e6:
            self.dropped += 1
            return None
        return frame

    def _fetch(self) -> None:
        end: BaseException = SourceNotOpen(self.name)
        try:
            while not self._closing.is_set():
                frame = self._read_source()
                with self._changed:
                    self.dropped += self._unread is not None
                    self._unread = self.newest_frame = frame
                    self._changed.notify_all()
        except BaseException as error:  # handed to the thread that reads
            end = end if self._closing.is_set() else error
        with self._changed:
            self._error = end
            self._changed.notify_all()


class LivePlayback(FrameSourceWrapper):
    """Plays a recording from now on: each frame is delivered, and stamped, as long after the first as it was recorded after it.

    The stamps of the recording itself are too old to be shown live. Where the stamps run back (a recording that starts again) or
    pause, the next frame follows after one period. The frames of a live source pass unchanged, and its notices are told.
    """

    def __init__(
        self, source: FrameSource, notify: Callable[[str], None] | None = None, keeps_times: bool = False
    ) -> None:
        """notify: receives a sentence, once, where images of a file are missing or damaged, which then ends as a whole one does;
        without it, this is raised. It also receives the first notices of a live source. keeps_times: frames that a slow computer
        delivers late keep their times, as a recording needs them; otherwise what follows is delayed as much, so that a person sees
        what is as new as its stamp."""
        super().__init__(source)
        self._notify, self._has_notified = notify, False
        self._keeps_times = keeps_times
        self._closing = Event()
        self._last: tuple[int, int] | None = None
        """Stamp of the last frame in the recording and here, ns."""

    def open(self) -> None:
        """Open the source; raises what it raises."""
        super().open()
        self._closing.clear()
        self._last = None

    def read(self) -> Frame:
        """Return the next frame when it is due."""
        if self._source.recorded_hz is None:
            frame = self._read_source()
            if self._notify is not None and not self._has_notified and (notices := self._source.notices):
                self._has_notified = True
                self._notify("; ".join(notices))
            return frame
        frame = self._read_file()
        due_ns = self._due_ns(frame.stamp_ns)
        self._closing.wait((due_ns - time.monotonic_ns()) / 1e9)
        if not self._keeps_times and (now_ns := time.monotonic_ns()) - due_ns > _LONGEST_DELAY_NS:
            due_ns = now_ns
        self._last = frame.stamp_ns, due_ns
        return replace(frame, stamp_ns=due_ns)

    def _due_ns(self, recorded_ns: int) -> int:
        if self._last is None:
            return time.monotonic_ns()
        step_ns = recorded_ns - self._last[0]
        if step_ns <= 0 or (step_ns > _LONGEST_PAUSE_NS and not self._keeps_times):
            assert self._source.recorded_hz is not None
            step_ns = round(1e9 / self._source.recorded_hz)
        return self._last[1] + step_ns

    def _read_file(self) -> Frame:
        try:
            return self._read_source()
        except SourceIncomplete as damage:
            if self._notify is None:
                raise
            if not self._has_notified:
                self._has_notified = True
                self._notify(str(damage))
            return self._read_source()  # which ends the file

    def close(self) -> None:
        """Close the source and end a wait for the next frame."""
        self._closing.set()
        super().close()


class DelayCorrectedSource(FrameSourceWrapper):
    """Wraps a source and subtracts the delay of its camera from every stamp, which then is the time of the exposure."""

    def __init__(self, source: FrameSource, delay_ms: float) -> None:
        super().__init__(source)
        self._delay_ns = round(delay_ms * 1e6)

    def read(self) -> Frame:
        """Return the next frame with its corrected stamp."""
        frame = self._read_source()
        return replace(frame, stamp_ns=frame.stamp_ns - self._delay_ns)

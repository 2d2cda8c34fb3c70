"""An opened cv2.VideoCapture that several threads may use, and the capture of text that C libraries print on their own.

`ThreadSafeVideoCapture` never releases a device while another thread reads it. `capture_output` keeps the printed text off the
terminal, so that every problem is reported once, as an error of this package.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any, Protocol, TypeVar, runtime_checkable

from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.quantities import Frame

_ONE_AT_A_TIME = Lock()
"""Lock for the standard streams, which belong to the process: two threads that redirect one at once could lose it permanently."""
_SILENT = 0
"""Log level of OpenCV at which it prints nothing."""


def silence_video_libraries() -> None:
    """Stop OpenCV and FFmpeg from printing problems that a source raises; environment variables set by the user win."""
    import cv2

    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    if "OPENCV_LOG_LEVEL" not in os.environ:
        # OpenCV moved this function in 4.13.
        set_log_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
        set_log_level(_SILENT)


class CapturedLibraryOutput:
    """The text that was printed while the stream was captured; it is complete when the block ends."""

    text: str = ""


@contextmanager
def capture_output(descriptor: int) -> Iterator[CapturedLibraryOutput]:
    """Capture what is written to standard output (1) or standard error (2) inside the block, C libraries included."""
    stream = sys.stdout if descriptor == 1 else sys.stderr
    captured = CapturedLibraryOutput()
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as file:
        if stream is not None:
            stream.flush()
        try:
            original = os.dup(descriptor)
        except OSError:  # the process has no such stream
            original = None
        else:
            os.dup2(file.fileno(), descriptor)
        try:
            yield captured
        finally:
            if original is not None:
                if stream is not None:
                    stream.flush()
                os.dup2(original, descriptor)
                os.close(original)
            captured.text = os.pread(file.fileno(), os.fstat(file.fileno()).st_size, 0).decode(errors="replace")


Result = TypeVar("Result")


@runtime_checkable
class VideoCaptureProtocol(Protocol):
    """The methods of cv2.VideoCapture that are used; the simulated devices of the tests have the same methods."""

    def isOpened(self) -> bool: ...  # noqa: N802, D102
    def get(self, prop: int, /) -> float: ...  # noqa: D102
    def set(self, prop: int, value: float, /) -> bool: ...  # noqa: D102
    def read(self) -> tuple[bool, Any]: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


class ThreadSafeVideoCapture:
    """Reads, stamps and counts the images of one capture; only one thread at a time accesses the device."""

    def __init__(
        self,
        name: str,
        capture: VideoCaptureProtocol,
        stamp_ns: Callable[[VideoCaptureProtocol], int] = lambda capture: time.monotonic_ns(),
    ) -> None:
        """stamp_ns: gives the stamp of the image that was just read, in ns of the monotonic clock."""
        self.next_index = 0
        self._name = name
        self._capture = capture
        self._stamp_ns = stamp_ns
        self._released = False
        self._lock = Lock()

    def read(self) -> Frame | None:
        """Return the next image in its own memory, or None where the driver gave none; raises `SourceNotOpen`."""
        with self._lock:
            if self._released:
                raise SourceNotOpen(self._name)
            delivered, image = self._capture.read()
            if not delivered:
                return None
            self.next_index += 1
            return Frame(image, self._stamp_ns(self._capture), self.next_index - 1)

    def query(self, question: Callable[[VideoCaptureProtocol], Result]) -> Result:
        """Call a function with the device between two reads and return its result; raises `SourceNotOpen`."""
        with self._lock:
            if self._released:
                raise SourceNotOpen(self._name)
            return question(self._capture)

    def release(self) -> None:
        """Close the device after a read in progress has ended."""
        with self._lock:
            self._released = True
            self._capture.release()

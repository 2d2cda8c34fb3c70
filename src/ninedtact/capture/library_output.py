"""Text that C libraries print on their own, kept off the terminal: every problem is reported once, as an error of this package."""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

_ONE_AT_A_TIME = Lock()
"""The standard streams belong to the process: two threads that redirect one at once could lose it for good."""


def silence_video_libraries() -> None:
    """Stop OpenCV and FFmpeg from printing problems that a source raises; environment variables set by the user win."""
    import cv2

    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    if "OPENCV_LOG_LEVEL" not in os.environ:
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


class CapturedOutput:
    """What was printed while the stream was captured; filled when the block ends."""

    text: str = ""


@contextmanager
def capture_output(descriptor: int) -> Iterator[CapturedOutput]:
    """Capture what is written to standard output (1) or standard error (2) inside the block, C libraries included."""
    stream = sys.stdout if descriptor == 1 else sys.stderr
    captured = CapturedOutput()
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

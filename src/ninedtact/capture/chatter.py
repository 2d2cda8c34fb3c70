"""What the image libraries print on their own, kept off the screen: every trouble is told once, as our error."""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

import cv2

_ONE_AT_A_TIME = Lock()
"""Standard error belongs to the process: two threads that swap it at once would swap it away for good."""


def hush_video() -> None:
    """Stop OpenCV and FFmpeg from printing the troubles that a source raises; the user's own settings of these win."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    if "OPENCV_LOG_LEVEL" not in os.environ:
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


class Overheard:
    """What was printed meanwhile; filled when the block ends."""

    text: str = ""


@contextmanager
def stderr_held() -> Iterator[Overheard]:
    """Catch what C libraries write to standard error inside the block, to judge it instead of showing it."""
    overheard = Overheard()
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as caught:
        kept = _redirected(caught.fileno())
        try:
            yield overheard
        finally:
            if kept is not None:
                os.dup2(kept, 2)
                os.close(kept)
            caught.seek(0)
            overheard.text = caught.read().decode(errors="replace")


def _redirected(target: int) -> int | None:
    """Point standard error at `target`; the old one, or None where the process has no standard error."""
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:
        return None
    os.dup2(target, 2)
    return kept

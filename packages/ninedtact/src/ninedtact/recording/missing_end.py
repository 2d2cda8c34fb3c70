"""The end that a recording lacks: whether a program still writes the file, or it was cut short, as by a crash or a broken copy.

A writer holds a lock on its file (flock), which the operating system takes back when the program ends, whatever ends it; a copy has
none. Where files cannot be locked, a file that was changed within the last seconds counts as being written.
"""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from ninedtact.capture.frame_source import SourceIncomplete
from ninedtact.recording.errors import RecordingRefused

if TYPE_CHECKING:
    from ninedtact.recording.reader import Recording

_WRITTEN_WITHIN_S = 5.0
"""Age below which an unfinished file may be being written: its writer adds to it every half second."""


class RecordingCutShort(SourceIncomplete):
    """Raised, once, after the last image of a recording that has no end; what followed is missing."""


def lock_while_writing(descriptor: int) -> None:
    """Mark an open file as being written, until its descriptor is closed; does nothing where files cannot be locked."""
    with suppress(OSError, ImportError):
        import fcntl  # not on Windows

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_being_written(recording: "Recording") -> bool:
    """Return whether a program still writes a recording."""
    if recording.is_finished:
        return False
    is_locked = _is_locked(recording)
    return _seconds_since_change(recording) < _WRITTEN_WITHIN_S if is_locked is None else is_locked


def require_ended_recording(recording: "Recording", then: str) -> None:
    """Raise `RecordingRefused` for a recording that may still be being written; then: what can be done after its end.

    Another computer may write it, whose lock is not seen here.
    """
    if is_being_written(recording):
        raise RecordingRefused(
            f"expected a recording that has ended, got {recording.path}, which is still being written; wait, and {then} then"
        )
    age_s = _seconds_since_change(recording)
    if not recording.is_finished and age_s < _WRITTEN_WITHIN_S:
        raise RecordingRefused(
            f"expected a recording that has not changed for {_WRITTEN_WITHIN_S:g} s, got {recording.path}, which another computer "
            f"may be writing: it changed {age_s:.1f} s ago; wait, and {then} then"
        )


def missing_end_error(recording: "Recording", seconds: float, pairs: int | None = None) -> RecordingCutShort:
    """Return the error for the end that an unfinished recording lacks.

    seconds: duration of what is there. pairs: number of training pairs in it, None where they are not read.
    """
    if is_being_written(recording):
        state, remedy = "that is still being written", "read it again after its end"
    else:
        state, remedy = "that was cut short, so that the rest is missing", "copy it again whole"
    counted = "" if pairs is None else f" and {pairs} {'pair' if pairs == 1 else 'pairs'}"
    return RecordingCutShort(
        f"expected all of {recording.path}, got {seconds:.1f} s{counted} of a recording {state}; use what was read, or {remedy}"
    )


def notify_of_missing_end(recording: "Recording", notify: Callable[[str], None]) -> None:
    """Report that a recording has no end, where it has none."""
    if not recording.is_finished:
        notify(str(missing_end_error(recording, recording.duration_s)))


def _is_locked(recording: "Recording") -> bool | None:
    """Return whether a writer holds the lock of a recording; None where files cannot be locked."""
    try:
        import fcntl
    except ImportError:
        return None
    try:
        descriptor = os.open(recording.path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return None
    finally:
        os.close(descriptor)
    return False


def _seconds_since_change(recording: "Recording") -> float:
    """Return the age of a file; it counts both ways, because the clock may have been set back."""
    return abs(time.time() - recording.path.stat().st_mtime)

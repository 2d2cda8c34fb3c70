"""`ninedtact` and `python -m ninedtact`: the command line, with Ctrl-C answered from the first moment on.

A termination (SIGTERM, as `kill` and service managers send it) ends it as Ctrl-C does: nothing is left half-written.
"""

import ctypes
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from types import FrameType

_M_ARENA_MAX = -8
"""The parameter of glibc's `mallopt` that limits the number of arenas (malloc.h)."""


def main() -> int:
    """Load and run the command line; 1 when Ctrl-C stopped it.

    Linear algebra runs on one thread unless the environment says otherwise (OPENBLAS_NUM_THREADS): its matrices are small here, so
    that several threads mostly wait for each other, which takes three times the processor time.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if "MALLOC_ARENA_MAX" not in os.environ:
        limit_memory_arenas()
    _replace_closed_outputs()
    interruption = _InterruptHandler()
    try:
        signal.signal(signal.SIGINT, interruption)
        signal.signal(signal.SIGTERM, interruption)
        from ninedtact import cli

        code = cli.main()
    except BaseException:
        # A library interrupted while it loads may turn the interruption into an error of its own (OpenCV does).
        if not interruption.happened:
            raise
        print("ninedtact: stopped by Ctrl-C before it began; run the command again", file=sys.stderr)  # noqa: T201
        code = 1
    return interruption.left_with(code)


def limit_memory_arenas() -> None:
    """Let all threads allocate from two arenas of memory; does nothing where the C library is not glibc.

    By default, glibc opens up to eight arenas for each processor core, and every arena keeps the memory of freed images. A command
    that opens sensors and pages for hours grew to 580 MB in this way; with two arenas it stays at 370 MB (`make soak`).
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 2)


def _replace_closed_outputs() -> None:
    """Throw away what is printed where standard output or standard error was closed (`2>&-`); Python has none then."""
    if sys.stdout is None:
        sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115 - open until the end
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115


class _InterruptHandler:
    """Raises `KeyboardInterrupt` as Python does, and remembers that it did."""

    def __init__(self) -> None:
        self.happened = False
        self.process = os.getpid()

    def __call__(self, number: int, at: FrameType | None) -> None:
        """The signal handler; a process that was forked off has nothing to put in order when it is terminated."""
        if number == signal.SIGTERM and os.getpid() != self.process:
            os._exit(128 + number)
        self.happened = True
        raise KeyboardInterrupt

    def left_with(self, code: int) -> int:
        """Return the exit code, after which interruptions are ignored: the command has said how it ended.

        An interpreter that was interrupted inside an import kills itself by the signal at its end, even though the interruption
        was answered (CPython's `unhandled_keyboard_interrupt`); so it is not given that end.
        """
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if self.happened:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        return code


if __name__ == "__main__":
    sys.exit(main())

"""Keys of a person, read while something else goes on: single ones at a terminal, characters of a pipe without one."""

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

ANY = 64


class Keys:
    """Standard input, looked at without waiting."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor

    def pressed(self) -> str:
        """What was typed since the last look; empty for nothing, and after the end of the input."""
        if self._descriptor is None or not select.select([self._descriptor], [], [], 0)[0]:
            return ""
        typed = os.read(self._descriptor, ANY)
        if not typed:
            self._descriptor = None
        return typed.decode(errors="ignore")


@contextmanager
def keys() -> Iterator[Keys]:
    """Read keys one by one while the block runs; the terminal is as before when it ends."""
    try:
        descriptor = sys.stdin.fileno()
    except (OSError, ValueError, AttributeError):  # no input at all, or one that a test took away
        yield Keys(None)
        return
    if not os.isatty(descriptor):
        yield Keys(descriptor)
        return
    import termios
    import tty

    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield Keys(descriptor)
    finally:
        with suppress(termios.error):
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)

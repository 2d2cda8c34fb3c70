"""Bota's driver prints on standard output: held while it starts and stops, so that ours stays clean."""

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

COLOUR = re.compile(r"\x1b\[[0-9;]*m")
DRIVERS_OWN = "[bota_"
_ONE_AT_A_TIME = Lock()
"""Standard output belongs to the process: two threads that swap it at once would swap it away for good."""


class Said:
    """What the driver printed meanwhile, line by line without colours; filled when the block ends."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    @property
    def errors(self) -> list[str]:
        """What it printed as errors."""
        return [line.partition("] ")[2] for line in self.lines if line.startswith(f"{DRIVERS_OWN}ERROR]")]


@contextmanager
def stdout_held() -> Iterator[Said]:
    """Catch what Bota's driver prints inside the block; what others print meanwhile is passed on afterwards."""
    said = Said()
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as caught:
        kept = _redirected(caught.fileno())
        try:
            yield said
        finally:
            caught_lines = _heard(caught.fileno(), kept)
            said.lines = [line for line in caught_lines if line.startswith(DRIVERS_OWN)]
            others = [line for line in caught_lines if not line.startswith(DRIVERS_OWN)]
            if kept is not None and others:
                os.write(1, ("\n".join(others) + "\n").encode())


def _redirected(target: int) -> int | None:
    """Point standard output at `target`; the old one, or None where the process has no standard output."""
    if sys.stdout is not None:
        sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:
        return None
    os.dup2(target, 1)
    return kept


def _heard(caught: int, kept: int | None) -> list[str]:
    """Give standard output back; what was written to it meanwhile."""
    if kept is not None:
        if sys.stdout is not None:
            sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
    text = os.pread(caught, os.fstat(caught).st_size, 0).decode(errors="replace")
    return COLOUR.sub("", text).splitlines()

"""The terminal of `ninedtact collect`: single keys, and how many pairs of which forces were saved, are missing, or are refused."""

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import monotonic
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy import ndarray as Array

    from ninedtact.recording.collecting.collector import Collector
    from ninedtact.recording.collecting.pair_selection import PairCounts

_BAR_SYMBOLS = "·▁▂▃▄▅▆▇█"
_KEY_HELP = "n next object   u undo last contact   t tare   q end"
_TERMINAL_PERIOD_S, _LOG_PERIOD_S = 0.2, 5.0
"""Between two updates of a terminal, and between two lines without one."""
_MISSING_SHOWN = 4
_READ_BYTES = 64


class KeyReader:
    """Reads standard input without waiting: single keys at a terminal, characters of a pipe without one."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor

    def read_keys(self) -> str:
        """Return what was typed since the last call; empty for nothing, and after the end of the input."""
        if self._descriptor is None or not select.select([self._descriptor], [], [], 0)[0]:
            return ""
        typed = os.read(self._descriptor, _READ_BYTES)
        if not typed:
            self._descriptor = None
        return typed.decode(errors="ignore")


@contextmanager
def open_key_reader() -> Iterator[KeyReader]:
    """Read keys one by one while the block runs; restore the terminal when it ends."""
    try:
        descriptor = sys.stdin.fileno()
    except (OSError, ValueError, AttributeError):  # no input at all, or one that a test took away
        yield KeyReader(None)
        return
    if not os.isatty(descriptor):
        yield KeyReader(descriptor)
        return
    import termios
    import tty

    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield KeyReader(descriptor)
    finally:
        with suppress(termios.error):
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


class CollectScreen:
    """Updates a few lines on standard error at a terminal; prints one line now and then elsewhere."""

    def __init__(self) -> None:
        self._is_terminal = sys.stderr.isatty()
        self._height, self._due_at = 0, 0.0
        self._message = ""

    def show_message(self, text: str) -> None:
        """Show a message at once, and keep it on the screen."""
        self._message = text
        if not self._is_terminal:
            print(f"ninedtact: {text}", file=sys.stderr, flush=True)

    def show(self, collector: "Collector", at_once: bool = False) -> None:
        """Show the progress if it is time, or at once."""
        if monotonic() < self._due_at and not at_once:
            return
        self._due_at = monotonic() + (_TERMINAL_PERIOD_S if self._is_terminal else _LOG_PERIOD_S)
        if not self._is_terminal:
            print(progress_line(collector), file=sys.stderr, flush=True)
            return
        missing = _missing_line(collector.counts)
        lines = [progress_line(collector), *histogram_lines(collector), missing, self._message, _KEY_HELP]
        up = f"\x1b[{self._height}A" if self._height else ""
        print(up + "\n".join(f"\x1b[2K{line}" for line in lines), file=sys.stderr, flush=True)
        self._height = len(lines)


def progress_line(collector: "Collector") -> str:
    """Return the present object, the number of pairs, and what is wrong, as one line."""
    kinds = collector.counts.kinds
    numbers = f"{kinds['rule']} by rule, {kinds['light_touch']} light, {kinds['no_contact']} without contact"
    line = f"{collector.object or '-'}: {len(collector.counts.pairs)} pairs ({numbers})"
    if collector.tare_in_progress is not None:
        return f"{line}; taring: {collector.tare_in_progress.advice}"
    if collector.fault is not None:
        return f"{line}; NOT SAVING: {collector.fault_text(collector.fault)}"
    return f"{line}; refused {collector.rejected.total()}"


def histogram_lines(collector: "Collector") -> list[str]:
    """Return one line for each axis: its range, a bar for each bin, and the present value."""
    from ninedtact.recording.collecting.pair_selection import AXES, AXIS_SCALES, AXIS_UNITS

    low, high = collector.counts.limits * AXIS_SCALES
    now = collector.newest.wrench.six * AXIS_SCALES if collector.newest is not None else low * 0
    lines = []
    for axis in range(6):
        digits = 2 if axis < 3 else 1
        limits = [f"{limit[axis]:+6.{digits}f}" for limit in (low, high)]
        bars = _bars(collector.counts.counts[axis])
        lines.append(
            f"  {AXES[axis]} {limits[0]} {bars} {limits[1]} {AXIS_UNITS[axis]:4} now {now[axis]:+8.{digits + 1}f}"
        )
    return lines


def _bars(counts: "Array") -> str:
    """Return a row of numbers as a row of bars; a dot is zero."""
    most = max(int(counts.max()), 1)
    return "".join(_BAR_SYMBOLS[-(-int(count) * (len(_BAR_SYMBOLS) - 1) // most)] for count in counts)


def _missing_line(counts: "PairCounts") -> str:
    """Return the force ranges to collect next."""
    ranges = counts.missing_ranges()
    more = f" and {len(ranges) - _MISSING_SHOWN} more" if len(ranges) > _MISSING_SHOWN else ""
    return f"  missing: {', '.join(ranges[:_MISSING_SHOWN])}{more}" if ranges else "  every range has pairs"

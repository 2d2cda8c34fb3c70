"""Keys of a person, read while something else goes on: single ones at a terminal, characters of a pipe without one.

What a person sees while collecting: how many pairs of which forces there are, which are missing, and what is wrong.
"""

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
    from ninedtact.recording.collecting.pair_counts import PairCounts


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


BARS = "·▁▂▃▄▅▆▇█"
KEYS = "n next object   u undo last contact   t tare   q end"
TERMINAL_S, LINES_S = 0.2, 5.0
"""Between two looks at a terminal, and between two lines without one."""
MISSING_AT_MOST = 4


class Screen:
    """Rewrites a few lines on standard error at a terminal; writes one now and then elsewhere."""

    def __init__(self) -> None:
        self._rewrites = sys.stderr.isatty()
        self._height, self._due_at = 0, 0.0
        self._remark = ""

    def remark(self, words: str) -> None:
        """Something to tell at once, and to leave standing."""
        self._remark = words
        if not self._rewrites:
            print(f"ninedtact: {words}", file=sys.stderr, flush=True)

    def show(self, collector: "Collector", at_once: bool = False) -> None:
        """How it goes, if it is time."""
        if monotonic() < self._due_at and not at_once:
            return
        self._due_at = monotonic() + (TERMINAL_S if self._rewrites else LINES_S)
        if not self._rewrites:
            print(headline(collector), file=sys.stderr, flush=True)
            return
        lines = [headline(collector), *histograms(collector), missing(collector.counters), self._remark, KEYS]
        up = f"\x1b[{self._height}A" if self._height else ""
        print(up + "\n".join(f"\x1b[2K{line}" for line in lines), file=sys.stderr, flush=True)
        self._height = len(lines)


def headline(collector: "Collector") -> str:
    """One line: what is done now, how much there is, and what is wrong."""
    counters = collector.counters
    kinds = f"{counters.kinds['rule']} by rule, {counters.kinds['light_touch']} light, {counters.kinds['no_contact']} untouched"
    line = f"{collector.object or '-'}: {len(counters.saved)} pairs ({kinds})"
    if collector.taring is not None:
        return f"{line}; taring: {collector.taring.advice}"
    if collector.told is not None:
        return f"{line}; NOT SAVING: {collector.sentence(collector.told)}"
    return f"{line}; refused {collector.refused.total()}"


def histograms(collector: "Collector") -> list[str]:
    """One line for each axis: where the pairs are, and what acts now."""
    from ninedtact.recording.collecting.pair_counts import AXES, UNITS

    low, high = collector.counters.spans
    now = collector.now.wrench.six if collector.now is not None else low * 0
    return [
        f"  {AXES[axis]} {low[axis]:+6.2f} {bars(collector.counters.counts[axis])} {high[axis]:+6.2f} {UNITS[axis]:4} "
        f"now {now[axis]:+7.3f}"
        for axis in range(6)
    ]


def bars(counts: "Array") -> str:
    """A row of numbers as a row of bars; a dot is nothing at all."""
    most = max(int(counts.max()), 1)
    return "".join(BARS[-(-int(count) * (len(BARS) - 1) // most)] for count in counts)


def missing(counters: "PairCounts") -> str:
    """The ranges to go for next."""
    ranges = counters.missing()
    more = f" and {len(ranges) - MISSING_AT_MOST} more" if len(ranges) > MISSING_AT_MOST else ""
    return f"  missing: {', '.join(ranges[:MISSING_AT_MOST])}{more}" if ranges else "  every range has pairs"

"""What a command says on standard output: one JSON object for scripts, or lines for a person.

Ctrl-C, or a termination, that ends a recording well: what is being written is written to its end.
"""

import json
import signal
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from time import monotonic
from types import FrameType
from typing import Any


def print_result(as_json: bool, figures: Mapping[str, Any], lines: Iterable[str]) -> int:
    """Print one or the other; the exit code of work that is done."""
    if as_json:
        print(json.dumps(figures, indent=2, ensure_ascii=False))
    else:
        print("\n".join(lines))
    return 0


@dataclass
class StopSignal:
    """When to stop: asked by Ctrl-C, or after some time."""

    seconds: float | None = None
    asked: bool = False
    began_at: float = 0.0

    @property
    def now(self) -> bool:
        """Whether it is time."""
        return self.asked or (self.seconds is not None and self.elapsed_s >= self.seconds)

    @property
    def elapsed_s(self) -> float:
        """Since it began."""
        return monotonic() - self.began_at

    def ask(self, number: int, at: FrameType | None) -> None:
        """The signal handler: once is asked politely, twice is Ctrl-C as ever."""
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


@contextmanager
def stop_on_signal(seconds: float | None = None) -> Iterator[StopSignal]:
    """While the block runs, the first Ctrl-C or termination only asks."""
    until = StopSignal(seconds, began_at=monotonic())
    before = {number: signal.signal(number, until.ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield until
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

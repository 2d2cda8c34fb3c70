"""A source whose every sample the test writes down, so that nothing depends on how fast the machine is."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ninedtact.capture.frame_source import SourceEnded
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.quantities import Wrench

MS = 1_000_000


class Played(WrenchSource):
    """These wrenches or six numbers, one after the other, so many ms apart; exceptions among them are raised."""

    def __init__(self, six: Sequence[object], period_ms: float = 1.0) -> None:
        self.name = "a played sensor"
        self.opened = 0
        self._six, self._period_ms, self._next = list(six), period_ms, 0

    def open(self) -> None:
        self.opened, self._next = 1, 0

    def read(self) -> Wrench:
        if self._next == len(self._six):
            raise SourceEnded("expected another sample, got the end; play more")
        six, self._next = self._six[self._next], self._next + 1
        if isinstance(six, Exception):
            raise six
        stamp_ns = round(self._next * self._period_ms * MS)
        if isinstance(six, Wrench):
            return replace(six, stamp_ns=stamp_ns)
        return Wrench(np.array(six[:3], float), np.array(six[3:], float), stamp_ns=stamp_ns)

    def close(self) -> None:
        self.opened = 0


def noisy(count: int, mean: Sequence[float] = (0,) * 6, noise: float = 0.02, seed: int = 0) -> np.ndarray:
    """So many samples of a load at rest; torques a hundredth as noisy."""
    rng = np.random.default_rng(seed)
    return np.array(mean) + rng.normal(0, noise, (count, 6)) * ([1] * 3 + [0.01] * 3)

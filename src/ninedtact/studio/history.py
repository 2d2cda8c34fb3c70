"""The last seconds: how deep it was, at every reading, and how fast images came."""

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

NS_PER_S = 1e9
HISTORY_S = 20.0
RATE_OVER_S = 2.0
"""Long enough for a steady figure, short enough to show a camera that slows down."""


class Tick(NamedTuple):
    """One event of several, `number` counting them all from the first."""

    at_ns: int
    number: int


class Rate:
    """Events per second over the last two seconds."""

    def __init__(self) -> None:
        self._ticks: deque[Tick] = deque()

    def tick(self, at_ns: int, number: int) -> None:
        """Event `number` happened; numbers may skip what was not seen."""
        self._ticks.append(Tick(at_ns, number))
        self._forget(at_ns)

    def hz(self, now_ns: int) -> float:
        """The rate, 0 where fewer than two events are that young."""
        self._forget(now_ns)
        if len(self._ticks) < 2:
            return 0.0
        first, last = self._ticks[0], self._ticks[-1]
        return (last.number - first.number) / max((last.at_ns - first.at_ns) / NS_PER_S, 1e-9)

    def _forget(self, now_ns: int) -> None:
        while self._ticks and now_ns - self._ticks[0].at_ns > RATE_OVER_S * NS_PER_S:
            self._ticks.popleft()


class History:
    """Deepest indentation of every reading of the last `span_s` seconds, also of those that no page showed."""

    def __init__(self, span_s: float = HISTORY_S) -> None:
        self.span_s = span_s
        self._depths: deque[tuple[int, float]] = deque()

    def add(self, at_ns: int, deepest_mm: float) -> None:
        """Append one reading."""
        self._depths.append((at_ns, deepest_mm))
        while at_ns - self._depths[0][0] > self.span_s * NS_PER_S:
            self._depths.popleft()

    def until(self, now_ns: int) -> Float64[Array, "2 n"]:
        """Seconds before now (negative), and mm."""
        depths = np.array(self._depths, np.float64).reshape(-1, 2)
        return np.stack([(depths[:, 0] - now_ns) / NS_PER_S, depths[:, 1]])

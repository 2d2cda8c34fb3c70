"""The last seconds of a force/torque sensor, and its wrench at any moment of them."""

from bisect import bisect_left
from collections import deque
from collections.abc import Iterator

import numpy as np

from ninedtact.quantities import Wrench

KEPT_NS = 5_000_000_000


class WrenchTrack:
    """Samples about the skin's centre in the order of their stamps."""

    def __init__(self) -> None:
        self.samples: deque[Wrench] = deque()

    def add(self, wrench: Wrench) -> None:
        """A sample younger than all before."""
        self.samples.append(wrench)
        while wrench.stamp_ns - self.samples[0].stamp_ns > KEPT_NS:
            self.samples.popleft()

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample, 0 before the first."""
        return self.samples[-1].stamp_ns if self.samples else 0

    def since(self, from_ns: int) -> Iterator[Wrench]:
        """All samples that are not older."""
        return (wrench for wrench in self.samples if wrench.stamp_ns >= from_ns)

    def distance_ns(self, at_ns: int) -> float:
        """How far the farther of the two samples around a moment is from it; infinite where one is missing."""
        before, after = self._around(at_ns)
        if before is None or after is None:
            return np.inf
        return max(at_ns - before.stamp_ns, after.stamp_ns - at_ns)

    def at(self, at_ns: int) -> Wrench | None:
        """The wrench at a moment, straight between the samples around it; None where one is missing."""
        before, after = self._around(at_ns)
        if before is None or after is None:
            return None
        part = (at_ns - before.stamp_ns) / max(after.stamp_ns - before.stamp_ns, 1)
        force_n, torque_nm = ((1 - part) * before.six + part * after.six).reshape(2, 3)
        return Wrench(force_n, torque_nm, stamp_ns=at_ns)

    def _around(self, at_ns: int) -> tuple[Wrench | None, Wrench | None]:
        after = bisect_left(self.samples, at_ns, key=lambda wrench: wrench.stamp_ns)
        if after < len(self.samples) and self.samples[after].stamp_ns == at_ns:
            return self.samples[after], self.samples[after]
        before = self.samples[after - 1] if after > 0 else None
        return before, self.samples[after] if after < len(self.samples) else None

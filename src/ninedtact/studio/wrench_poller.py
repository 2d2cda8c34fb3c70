"""The force thread of the live page: reads a wrench source continuously and keeps the last seconds; the page never delays it."""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from threading import Event, Lock, Thread
from types import TracebackType

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.frame_source import SourceEnded
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.quantities import Wrench
from ninedtact.studio.sensor_poller import HISTORY_S, NS_PER_S

MOST_HZ = 60.0
"""Number of samples kept per second, which is more than a person can see."""


@dataclass(frozen=True)
class WrenchSnapshot:
    """The state of one wrench source at one moment."""

    name: str
    wrench: Wrench | None
    """The wrench about the skin's centre at the time of the shown reading; None before the first."""
    history: Float64[Array, "7 n"]
    """Seconds before now (negative); F_x, F_y, F_z in N; T_x, T_y, T_z in N·m."""
    trouble: BaseException | None = None
    """Why no more wrenches will arrive."""
    notices: tuple[str, ...] = ()
    """Sentences that hold for every wrench of the source."""


class WrenchPoller:
    """Reads a wrench source in its own thread while it is open (`with`)."""

    def __init__(self, source: WrenchSource, name: str, notices: tuple[str, ...] = ()) -> None:
        self.name, self.notices, self._source = name, notices, source
        self._samples: deque[tuple[int, Wrench]] = deque()
        self._trouble: BaseException | None = None
        self._lock, self._closing = Lock(), Event()
        self._thread = Thread(target=self._run, name=f"read {source.name}", daemon=True)

    def snapshot(self, at_ns: int | None, now_ns: int) -> WrenchSnapshot:
        """Return the wrench nearest to a time (None: the newest) and the last seconds; never waits for the source."""
        with self._lock:
            samples, trouble = list(self._samples), self._trouble
        history = np.array([(at - now_ns, *wrench.six) for at, wrench in samples], float).reshape(-1, 7).T
        history[0] /= NS_PER_S
        return WrenchSnapshot(self.name, _nearest_sample(samples, at_ns), history, trouble, self.notices)

    def __enter__(self) -> "WrenchPoller":
        """Open the source, raising what it raises, and start reading."""
        self._source.open()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._source.close()
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._keep(self._source.read())
        except SourceEnded:
            pass
        except BaseException as trouble:  # the page shows it
            if not self._closing.is_set():
                self._trouble = trouble

    def _keep(self, wrench: Wrench) -> None:
        if self._samples and wrench.stamp_ns - self._samples[-1][0] < NS_PER_S / MOST_HZ:
            return
        with self._lock:
            self._samples.append((wrench.stamp_ns, wrench.about(np.zeros(3))))
            while wrench.stamp_ns - self._samples[0][0] > HISTORY_S * NS_PER_S:
                self._samples.popleft()


def _nearest_sample(samples: list[tuple[int, Wrench]], at_ns: int | None) -> Wrench | None:
    """Return the sample nearest to a time, or the last one without a time."""
    if not samples:
        return None
    if at_ns is None:
        return samples[-1][1]
    after = min(bisect_left(samples, at_ns, key=lambda sample: sample[0]), len(samples) - 1)
    before = max(after - 1, 0)
    return min(samples[before], samples[after], key=lambda sample: abs(sample[0] - at_ns))[1]

"""The wrenches on the live page: the last seconds of each of their sources, without ever delaying the sensor or the page.

A `WrenchPoller` reads a force/torque sensor, or the true wrench of a twin, in a thread of its own. What the sensor's estimator
answers comes with its readings. Both fill a `WrenchHistory`, which the page reads.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from threading import Event, Lock, Thread

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.frame_source import SourceEnded
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.live.sensor_poller import HISTORY_S, NS_PER_S
from ninedtact.quantities import Wrench, WrenchEstimate

MOST_HZ = 60.0
"""Number of samples kept per second, which is more than a person can see."""
_ROUNDING_NS = 1000
"""Time by which a sample may come before its turn: stamps are whole nanoseconds, and a step at `MOST_HZ` is not."""
UNKNOWN_STD = np.full(6, np.nan)
"""The standard deviations of a wrench whose errors are not stated."""


@dataclass(frozen=True)
class WrenchWithUncertainty:
    """A wrench about the skin's centre, with its error and warnings where it is an estimate."""

    wrench: Wrench
    std: Float64[Array, "6"]
    """One standard deviation of F_x, F_y, F_z in N and T_x, T_y, T_z in N·m; NaN where none is stated, infinite where the wrench is
    unknown."""
    warnings: tuple[str, ...] = ()

    @classmethod
    def of_estimate(cls, estimate: WrenchEstimate) -> "WrenchWithUncertainty":
        """Return the wrench of an estimate with its standard deviations and warnings.

        An infinite standard deviation beside a wrench of zero says that the wrench is unknown, as of an image that is none of the
        sensor; beside another wrench it says that the estimator states no error.
        """
        is_unknown = not estimate.wrench.six.any()
        std = estimate.std if is_unknown else np.where(np.isinf(estimate.std), np.nan, estimate.std)
        return cls(estimate.wrench, std, tuple(estimate.warnings))

    @cached_property
    def values_and_stds(self) -> Float64[Array, "12"]:
        """The six components in N and N·m, then their standard deviations."""
        return np.concatenate([self.wrench.six, self.std])


@dataclass(frozen=True)
class WrenchSourceSnapshot:
    """The state of one source of wrenches at one moment."""

    name: str
    """One word, the head of its column: true, measured or estimated."""
    meaning: str
    """What the wrench is, and where it comes from."""
    sample: WrenchWithUncertainty | None
    """The sample at the time of the shown reading; None before the first."""
    samples: tuple[tuple[int, WrenchWithUncertainty], ...]
    """The last seconds: stamps in ns, and samples."""
    now_ns: int
    """Time of the snapshot."""
    trouble: BaseException | None = None
    """Why no more wrenches will arrive."""
    notices: tuple[str, ...] = ()
    """Sentences that hold for every wrench of the source."""
    states_errors: bool = False
    """Whether the source states standard deviations."""

    @cached_property
    def history(self) -> Float64[Array, "13 n"]:
        """Seconds before now (negative); the six components in N and N·m; their six standard deviations."""
        before_s = np.array([at - self.now_ns for at, _ in self.samples]) / NS_PER_S
        values = [sample.values_and_stds for _, sample in self.samples]
        return np.concatenate([before_s[None], np.array(values, float).reshape(-1, 12).T])


class WrenchHistory:
    """The last seconds of one source of wrenches, or all its samples; safe to fill and to read from different threads."""

    def __init__(
        self,
        name: str,
        meaning: str,
        notices: tuple[str, ...] = (),
        states_errors: bool = False,
        keeps_all: bool = False,
    ) -> None:
        """keeps_all: whether samples of a recording are kept, whose snapshots end with the time that is shown."""
        self.name, self.meaning, self.notices, self.states_errors = name, meaning, notices, states_errors
        self.trouble: BaseException | None = None
        self._keeps_all, self._samples = keeps_all, list[tuple[int, WrenchWithUncertainty]]()
        self._lock = Lock()

    def add(self, sample: WrenchWithUncertainty) -> None:
        """Keep a sample, unless it follows the last one within 1/`MOST_HZ`; drop those that are too old, or of a later time."""
        stamp_ns = sample.wrench.stamp_ns
        elapsed_ns = stamp_ns - self._samples[-1][0] if self._samples else np.inf
        if 0 <= elapsed_ns < NS_PER_S / MOST_HZ - _ROUNDING_NS:
            return
        with self._lock:
            if elapsed_ns < 0:  # a recording that starts again
                self._samples.clear()
            self._samples.append((stamp_ns, sample))
            if not self._keeps_all:
                del self._samples[: self._first_shown(stamp_ns)]

    def add_estimate(self, estimate: WrenchEstimate) -> None:
        """Keep an estimate with its standard deviations and warnings."""
        self.add(WrenchWithUncertainty.of_estimate(estimate))

    def snapshot(self, at_ns: int | None, now_ns: int) -> WrenchSourceSnapshot:
        """Return the sample nearest to a time (None: the newest) and the last seconds."""
        with self._lock:
            end = bisect_right(self._samples, now_ns, key=_stamp_ns) if self._keeps_all else len(self._samples)
            samples = tuple(self._samples[self._first_shown(now_ns) if self._keeps_all else 0 : end])
            sample = self._samples[-1] if self._samples else None
            if at_ns is not None and self._samples:
                after = bisect_right(self._samples, at_ns, key=_stamp_ns)
                near = self._samples[max(after - 1, 0) : after + 1]
                sample = min(near, key=lambda one: abs(one[0] - at_ns))
        state = (self.trouble, self.notices, self.states_errors)
        nearest = None if sample is None else sample[1]
        return WrenchSourceSnapshot(self.name, self.meaning, nearest, samples, now_ns, *state)

    def _first_shown(self, now_ns: int) -> int:
        return bisect_left(self._samples, now_ns - HISTORY_S * NS_PER_S, key=_stamp_ns)


def _stamp_ns(sample: tuple[int, WrenchWithUncertainty]) -> int:
    return sample[0]


class WrenchPoller:
    """Reads a wrench source in its own thread while it is open (`with`). on_sample: is called there with every sample."""

    def __init__(
        self,
        source: WrenchSource,
        name: str,
        meaning: str,
        on_sample: Callable[[Wrench], None] = lambda wrench: None,
    ) -> None:
        self.history = WrenchHistory(name, meaning)
        self.source, self._on_sample = source, on_sample
        self._closing = Event()
        self._thread = Thread(target=self._run, name=f"read {source.name}", daemon=True)

    def __enter__(self) -> "WrenchPoller":
        """Open the source, raising what it raises, and start reading."""
        self.source.open_for(self)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self.source.close_for(self)
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                wrench = self.source.read().about(np.zeros(3))
                self.history.add(WrenchWithUncertainty(wrench, UNKNOWN_STD))
                self._on_sample(wrench)
        except SourceEnded:
            pass
        except BaseException as trouble:  # the page shows it
            if not self._closing.is_set():
                self.history.trouble = trouble

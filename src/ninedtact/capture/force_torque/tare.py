"""Without what the sensor reads when nothing touches: weights on it, and its own bias, which wanders with temperature."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Wrench

NS_PER_S = 1_000_000_000
PARTS = 4
SIGMAS = 7.0
"""The four means of a still load spread further than so many of their standard deviations once in ten thousand tares."""
FEW = 8
"""From so few samples the noise itself is known to a factor of two only."""


class TareRefused(NinedtactError):
    """The load moved while it was measured, or there were too few samples."""


@dataclass(frozen=True)
class TareSettings:
    """How the untouched reading is measured, and how far it may move."""

    seconds: float = 1.0
    least_samples: int = 8
    still_n: float = 0.05
    """How far the force may wander within a tare, beyond what its noise explains."""
    still_nm: float = 0.002
    wander_n: float = 0.1
    """How far the untouched force may have wandered since the tare before a person is told."""
    wander_nm: float = 0.005


@dataclass(frozen=True)
class Tare:
    """What the sensor read when nothing touched."""

    mean: Float64[Array, "6"]
    """N and N·m, as `Wrench.six`."""
    deviation: Float64[Array, "6"]
    """Standard deviation of one sample."""
    samples: int
    seconds: float
    stamp_ns: int
    """Of the last sample."""

    @property
    def sentence(self) -> str:
        """For a person."""
        force_n, torque_mnm = self.deviation[:3], 1e3 * self.deviation[3:]
        return (
            f"tared over {self.seconds:.1f} s, {self.samples} samples; noise of one sample "
            f"{format_vector(force_n, 3)} N, {format_vector(torque_mnm, 2)} mN·m"
        )


@dataclass(frozen=True)
class ZeroDrift:
    """How far the untouched reading has gone since the tare, through temperature or strain."""

    six: Float64[Array, "6"]
    error: Float64[Array, "6"]
    """Standard deviation of `six` from the noise of the samples."""
    since_s: float
    limit_n: float
    limit_nm: float

    @property
    def too_far(self) -> bool:
        """Whether a person should tare again: it is beyond the limit, and noise does not explain that."""
        limits = np.repeat([self.limit_n, self.limit_nm], 3)
        return bool((np.abs(self.six) > limits + 3 * self.error).any())

    @property
    def sentence(self) -> str:
        """For a person."""
        advice = "tare again" if self.too_far else "no need to tare"
        return (
            f"untouched, the reading has wandered by {format_vector(self.six[:3], 3)} N, "
            f"{format_vector(1e3 * self.six[3:], 1)} mN·m in "
            f"{self.since_s / 60:.0f} min since the tare (limits {self.limit_n:g} N, {1e3 * self.limit_nm:g} mN·m); {advice}"
        )


class TaredWrenchSource(WrenchSource):
    """Another source less its tare, which is taken at each opening and whenever `take_tare` is called."""

    tare: Tare
    """The last one that was taken."""

    def __init__(self, source: WrenchSource, settings: TareSettings = TareSettings()) -> None:
        self.name = source.name
        self._source, self._settings = source, settings
        self._reading, self._is_open = Lock(), False

    def open(self) -> None:
        """Open the source and tare; raises `TareRefused` and what the source raises."""
        if self._is_open:
            return
        self._source.open()
        try:
            self.take_tare()
        except BaseException:
            self._source.close()
            raise
        self._is_open = True

    def read(self) -> Wrench:
        """The next sample; raises what the source raises."""
        with self._reading:
            wrench = self._source.read()
            mean = self.tare.mean if self._is_open else np.zeros(6)
        return replace(wrench, force_n=wrench.force_n - mean[:3], torque_nm=wrench.torque_nm - mean[3:])

    def take_tare(self) -> Tare:
        """Measure the untouched reading, while no other thread reads; raises `TareRefused` and keeps the last one."""
        with self._reading:
            wrenches = collect_samples(self._source, self._settings.seconds)
        self.tare = compute_tare(wrenches, self._settings)
        return self.tare

    def measure_wander(self, seconds: float = 0.5) -> ZeroDrift:
        """How far the untouched reading has gone since the tare; the skin must be untouched meanwhile."""
        with self._reading:
            wrenches = collect_samples(self._source, seconds)
        return self.wander_of([wrench.six - self.tare.mean for wrench in wrenches], wrenches[-1].stamp_ns)

    def wander_of(self, untouched: Sequence[Float64[Array, "6"]], stamp_ns: int) -> ZeroDrift:
        """The same of samples, less the tare, that somebody knows to be untouched; the last is of `stamp_ns`."""
        since_s = (stamp_ns - self.tare.stamp_ns) / NS_PER_S
        error = self.tare.deviation * np.sqrt(1 / len(untouched) + 1 / self.tare.samples)
        return ZeroDrift(np.mean(untouched, axis=0), error, since_s, self._settings.wander_n, self._settings.wander_nm)

    def close(self) -> None:
        """Close the source."""
        self._is_open = False
        self._source.close()


def collect_samples(source: WrenchSource, seconds: float) -> list[Wrench]:
    """What an open source delivers in this time, by its own stamps."""
    wrenches = [source.read()]
    while wrenches[-1].stamp_ns - wrenches[0].stamp_ns < seconds * NS_PER_S:
        wrenches.append(source.read())
    return wrenches


def compute_tare(wrenches: Sequence[Wrench], settings: TareSettings) -> Tare:
    """The mean of untouched samples; raises `TareRefused` where they are too few or the load moved.

    A still load differs between the quarters of the time by its noise alone, and the noise is known from neighbouring
    samples (docs/force_torque.md, von Neumann 1941).
    """
    six = np.array([wrench.six for wrench in wrenches])
    if len(six) < settings.least_samples:
        raise TareRefused(
            f"expected {settings.least_samples} samples for a tare, got {len(six)}; tare for longer than {settings.seconds:g} s"
        )
    noise = (1 + FEW / len(six)) * np.diff(six, axis=0).std(axis=0) / np.sqrt(2)
    spread = np.ptp([part.mean(axis=0) for part in np.array_split(six, PARTS)], axis=0)
    still = np.repeat([settings.still_n, settings.still_nm], 3)
    if (spread > still + SIGMAS * noise / np.sqrt(len(six) / PARTS)).any():
        raise TareRefused(
            f"expected a load at rest for a tare, got one that moved by {format_vector(spread[:3], 3)} N, "
            f"{format_vector(1e3 * spread[3:], 1)} mN·m; take the hand away and tare again"
        )
    seconds = (wrenches[-1].stamp_ns - wrenches[0].stamp_ns) / NS_PER_S
    return Tare(six.mean(axis=0), six.std(axis=0, ddof=1), len(six), seconds, wrenches[-1].stamp_ns)


def format_vector(three: Float64[Array, "3"], decimals: int) -> str:
    """Three numbers along x, y and z."""
    return "(" + ", ".join(f"{number:.{decimals}f}" for number in three) + ")"

"""The tare of a force/torque sensor: its reading without contact, which consists of weights on it and of its bias.

`TaredWrenchSource` subtracts the tare.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.wrench_source import WrenchSource, WrenchSourceWrapper
from ninedtact.errors import DeviceError
from ninedtact.quantities import Wrench

_NS_PER_S = 1_000_000_000
_TARE_QUARTERS = 4
_SPREAD_SIGMAS = 7.0
"""Spread of the means of a tare's quarters, in standard deviations, that a tare at rest exceeds once in ten thousand tares."""
_FEW_SAMPLES = 8
"""Number of samples up to which the noise itself is known only to a factor of two."""


class TareRefused(DeviceError):
    """Raised where the load moved while it was measured, or there were too few samples."""


@dataclass(frozen=True)
class TareSettings:
    """How the reading without contact is measured."""

    seconds: float = 1.0
    least_samples: int = 8
    still_n: float = 0.05
    """How far the force may move within a tare, beyond what its noise explains."""
    still_nm: float = 0.002


@dataclass(frozen=True)
class Tare:
    """The reading of the sensor without contact, and its noise."""

    mean: Float64[Array, "6"]
    """Mean reading, N and N·m, in the order of `Wrench.six`."""
    deviation: Float64[Array, "6"]
    """Standard deviation of one sample."""
    samples: int
    seconds: float
    stamp_ns: int
    """Stamp of the last sample."""

    @property
    def sentence(self) -> str:
        """The tare as a sentence for a person."""
        force_n, torque_nmm = self.deviation[:3], 1e3 * self.deviation[3:]
        return (
            f"tared over {self.seconds:.1f} s, {self.samples} samples; noise of one sample "
            f"{_format_vector(force_n, 3)} N, {_format_vector(torque_nmm, 2)} N·mm"
        )


class TaredWrenchSource(WrenchSourceWrapper):
    """Wraps a source and subtracts its tare, which is taken at each opening and whenever `take_tare` is called."""

    tare: Tare
    """The last tare that was taken."""

    def __init__(self, source: WrenchSource, settings: TareSettings = TareSettings()) -> None:
        super().__init__(source)
        self._settings = settings
        self._reading, self._is_open = Lock(), False

    def open(self) -> None:
        """Open the source and take a tare; raises `TareRefused` and what the source raises."""
        if self._is_open:
            return
        with self._reading:
            self._source.open()
            try:
                self._measure_tare()
            except BaseException:
                self._source.close()
                raise
        self._is_open = True

    def read(self) -> Wrench:
        """Return the next sample minus the tare; raises what the source raises."""
        with self._reading:
            wrench = self._source.read()
            mean = self.tare.mean
        return replace(wrench, force_n=wrench.force_n - mean[:3], torque_nm=wrench.torque_nm - mean[3:])

    def take_tare(self) -> Tare:
        """Take a new tare while no other thread reads; raises `TareRefused` and keeps the last tare."""
        with self._reading:
            self._measure_tare()
        return self.tare

    def _measure_tare(self) -> None:
        wrenches = [self._source.read()]
        while wrenches[-1].stamp_ns - wrenches[0].stamp_ns < self._settings.seconds * _NS_PER_S:
            wrenches.append(self._source.read())
        self.tare = compute_tare(wrenches, self._settings)

    def close(self) -> None:
        """Close the source that this one wraps."""
        self._is_open = False
        self._source.close()


def compute_tare(wrenches: Sequence[Wrench], settings: TareSettings) -> Tare:
    """Return the tare of samples without contact; raises `TareRefused` where they are too few or the load moved.

    A load at rest differs between the quarters of the time by its noise alone, and the noise is known from neighbouring
    samples (docs/force_torque.md, von Neumann 1941).
    """
    six = np.array([wrench.six for wrench in wrenches])
    if len(six) < settings.least_samples:
        raise TareRefused(
            expected=f"{settings.least_samples} samples for a tare",
            got=f"{len(six)}",
            remedy=f"tare for longer than {settings.seconds:g} s",
        )
    noise = (1 + _FEW_SAMPLES / len(six)) * np.diff(six, axis=0).std(axis=0) / np.sqrt(2)
    spread = np.ptp([part.mean(axis=0) for part in np.array_split(six, _TARE_QUARTERS)], axis=0)
    still = np.repeat([settings.still_n, settings.still_nm], 3)
    if (spread > still + _SPREAD_SIGMAS * noise / np.sqrt(len(six) / _TARE_QUARTERS)).any():
        raise TareRefused(
            expected="a load at rest for a tare",
            got=f"one that moved by {_format_vector(spread[:3], 3)} N, {_format_vector(1000.0 * spread[3:], 1)} N·mm",
            remedy="take the hand away and tare again",
        )
    seconds = (wrenches[-1].stamp_ns - wrenches[0].stamp_ns) / _NS_PER_S
    return Tare(six.mean(axis=0), six.std(axis=0, ddof=1), len(six), seconds, wrenches[-1].stamp_ns)


def _format_vector(three: Float64[Array, "3"], decimals: int) -> str:
    return "(" + ", ".join(f"{number:.{decimals}f}" for number in three) + ")"

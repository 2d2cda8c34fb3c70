"""The tare of a force/torque sensor: its reading without contact, which consists of weights on it and of its bias."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.errors import DeviceError
from ninedtact.quantities import Wrench

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
    return Tare(six.mean(axis=0), six.std(axis=0, ddof=1))


def _format_vector(three: Float64[Array, "3"], decimals: int) -> str:
    return "(" + ", ".join(f"{number:.{decimals}f}" for number in three) + ")"

"""What a recording of free pressing delivers: images to read, and the samples of a force/torque sensor without stuck ones."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int64
from numpy import ndarray as Array

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import ForceEstimationError
from ninedtact.quantities import WRENCH_AXES, WRENCH_UNITS
from ninedtact.reading import Reading
from ninedtact.robust_noise import robust_std

_STUCK_S, _STUCK_SAMPLES = 0.1, 5
"""Duration and number of equal samples from which an axis counts as stuck; that of a device with noise does not repeat."""
_SAME, _ZEROS_WITHOUT_NOISE = 1e-9, 0.05
_AT_LIMIT = 0.999
_FEW_SAMPLES_PER_S = 10.0
_SLOPE_S = 0.02
"""Half of the time over which the slope of a sample is taken."""
_LONGEST_GAP_S = 0.2
"""Longest time between two samples between which one is interpolated."""


class PressingUnusable(ForceEstimationError):
    """A recording of free pressing does not tell how image and force/torque sensor belong together."""


@dataclass(frozen=True)
class ForceTorqueSamples:
    """The samples of a force/torque sensor in the frame of the device, N and N·m."""

    at_s: Float[Array, " samples"]
    six: Float[Array, "samples 6"]
    usable: Bool[Array, " samples"]
    """Whether a sample may be used; not where an axis is saturated or frozen."""

    @cached_property
    def noise(self) -> Float[Array, "6"]:
        """Standard deviation of one sample, from the differences of neighbours."""
        return np.asarray(robust_std(np.diff(self.six, axis=0), axis=0) / np.sqrt(2))

    def at(self, at_s: Float[Array, " n"]) -> Float[Array, "n 6"]:
        """Return the samples at these times, interpolated; not-a-number where none is near."""
        found = np.stack([np.interp(at_s, self.at_s, column) for column in self.six.T], axis=1)
        after = np.clip(np.searchsorted(self.at_s, at_s), 1, len(self.at_s) - 1)
        gap = self.at_s[after] - self.at_s[after - 1]
        inside = (at_s >= self.at_s[0]) & (at_s <= self.at_s[-1]) & (gap <= _LONGEST_GAP_S)
        found[~(inside & self.usable[after] & self.usable[after - 1])] = np.nan
        return found

    def slope_at(self, at_s: Float[Array, " n"]) -> Float[Array, "n 6"]:
        """Return the change per second at these times."""
        return (self.at(at_s + _SLOPE_S) - self.at(at_s - _SLOPE_S)) / (2 * _SLOPE_S)


class FreePressing(ABC):
    """A recording of free pressing, open for reading."""

    name: str
    stamps_ns: Int64[Array, " images"]
    """Stamps of the images that are read, few enough to estimate all of them."""
    samples: ForceTorqueSamples
    """In seconds after the first of these images."""
    notices: tuple[str, ...]
    """What is wrong with the samples, one sentence each."""
    mount: ForceTorqueMount
    """Where the design has the device, with which the recording was made."""

    @abstractmethod
    def read(self, number: int, sensor: SensorFolder) -> Reading:
        """Return the reading of one of the images by a sensor; raises what reading raises."""


def find_stuck_samples(at_s: Float[Array, " n"], six: Float[Array, "n 6"]) -> tuple[Bool[Array, " n"], tuple[str, ...]]:
    """Return which samples can be used, and a sentence for each axis that is saturated or frozen for a time.

    Raises `PressingUnusable` where there are too few samples, or an axis never changes. An axis that is exactly zero without
    contact, as in a simulation without noise, is not judged.
    """
    if len(at_s) < 2 or len(at_s) < _FEW_SAMPLES_PER_S * (at_s[-1] - at_s[0]):
        raise PressingUnusable(
            expected=f"at least {_FEW_SAMPLES_PER_S:g} samples of the force/torque sensor a second",
            got=f"{len(at_s)} samples in {at_s[-1] - at_s[0] if len(at_s) else 0:.0f} s",
            remedy="record with a faster rate of the force/torque sensor",
        )
    usable, notices = np.ones(len(at_s), bool), []
    for axis, name in enumerate(WRENCH_AXES):
        values = six[:, axis]
        extent = np.abs(values).max()
        same = np.abs(np.diff(values)) <= _SAME * extent
        if same.all():
            raise PressingUnusable(
                expected="six axes of the force/torque sensor that change while the skin is pressed",
                got=f"{name} frozen at {values[0]:.3g} {WRENCH_UNITS[axis]} all the time",
                remedy="check the force/torque sensor and record again",
            )
        if (values == 0).mean() > _ZEROS_WITHOUT_NOISE:
            continue
        stuck = _long_runs(same, at_s)
        at_limit = stuck & (np.abs(values) >= _AT_LIMIT * extent)
        for kind, which in (("saturated", at_limit), ("frozen", stuck & ~at_limit)):
            if which.any():
                seconds = float(which.sum() * np.median(np.diff(at_s)))
                worst = values[which][np.abs(values[which]).argmax()]
                notices.append(
                    f"{name} was {kind} at {worst:.3g} {WRENCH_UNITS[axis]} for {seconds:.1f} s, which is left out"
                )
        usable &= ~stuck
    return usable, tuple(notices)


def _long_runs(same: Bool[Array, " gaps"], at_s: Float[Array, " n"]) -> Bool[Array, " n"]:
    """Return the samples that belong to long runs of equal ones. same: whether each equals the next."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    found = np.zeros(len(at_s), bool)
    for first, last in edges.reshape(-1, 2):  # samples first to last, included, are equal
        if last - first + 1 >= _STUCK_SAMPLES and at_s[last] - at_s[first] >= _STUCK_S:
            found[first : last + 1] = True
    return found

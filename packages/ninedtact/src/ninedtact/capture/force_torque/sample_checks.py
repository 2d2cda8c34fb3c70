"""Checks that reject samples of a force/torque sensor: beyond its range, frozen, or changing faster than any load does; and the
faults of sensor and clocks by time, which determine the moments that must not be saved.

A rejected sample raises `WrenchSampleRejected` with its reason and is never returned, so that it cannot be saved by mistake.
The source stays open and the next read continues. `SkippingWrenchSource` is for displays, which need no reason.

`SampleFaultHistory` stores the faults with their times. They include the time before a rejection in which the fault already
existed but could not be detected yet.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from ninedtact.capture.wrench_source import (
    WrenchFrozen,
    WrenchJumped,
    WrenchSampleRejected,
    WrenchSaturated,
    WrenchSource,
)
from ninedtact.errors import InputError
from ninedtact.quantities import Wrench

_NS_PER_MS = 1_000_000
_AXES = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")
_UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")


class SampleChecksInvalid(InputError):
    """Raised for a range of a force/torque sensor that none has."""


@dataclass(frozen=True)
class SampleCheckSettings:
    """When a sample is rejected; all values are in the frame of the device, before any tare."""

    range_n: tuple[float, float, float] | None = None
    """Range of the force/torque sensor along each axis, N, from its data sheet; samples near its end are not saved."""
    range_nm: tuple[float, float, float] | None = None
    """Range of the force/torque sensor about each axis, N·m."""
    saturated_fraction: float = 0.98
    """Fraction of the range from which a sample counts as saturated."""
    frozen_ms: float = 200.0
    """How long a device may repeat one sample (at least five times) before it counts as frozen; six noisy numbers never repeat."""
    jump_n: float = 10.0
    """Largest change from one sample to the next."""
    jump_nm: float = 0.5
    """The same for the torque."""
    jump_within_ms: float = 20.0
    """Largest time between two samples whose change is judged."""
    jump_settles_ms: float = 50.0
    """After this long at the new level it counts as the load. What moved the reading may also have moved its zero."""

    def __post_init__(self) -> None:
        for limits, unit in ((self.range_n, "N"), (self.range_nm, "N·m")):
            if limits is not None and not all(limit > 0 for limit in limits):
                raise SampleChecksInvalid(
                    f"expected three ranges of a force/torque sensor above zero, got {limits} {unit}; take them from its data sheet"
                )


class CheckedWrenchSource(WrenchSource):
    """Wraps a source and raises `WrenchSampleRejected` for its unusable samples."""

    def __init__(self, source: WrenchSource, settings: SampleCheckSettings = SampleCheckSettings()) -> None:
        self.name = source.name
        self._source, self._settings = source, settings
        self._reset()

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._source.open()
        self._reset()

    def read(self) -> Wrench:
        """Return the next sample; raises `WrenchSaturated`, `WrenchFrozen`, `WrenchJumped`, and what the source raises."""
        wrench = self._source.read()
        for detector in self._detectors:
            detector.check(wrench)
        return wrench

    def close(self) -> None:
        """Close the source that this one wraps."""
        self._source.close()

    def _reset(self) -> None:
        detectors = (_SaturationDetector, _FreezeDetector, _JumpDetector)
        self._detectors = [detector(self.name, self._settings) for detector in detectors]


class _SaturationDetector:
    """Rejects samples at the end of the range of the device."""

    def __init__(self, name: str, settings: SampleCheckSettings) -> None:
        self._name, unknown = name, (np.inf, np.inf, np.inf)
        ends = [*(settings.range_n or unknown), *(settings.range_nm or unknown)]
        self._limits = settings.saturated_fraction * np.array(ends)

    def check(self, wrench: Wrench) -> None:
        """Raise `WrenchSaturated` for a sample near the end of the range."""
        excess = np.abs(wrench.six) / self._limits
        worst = int(excess.argmax())
        if excess[worst] >= 1:
            raise WrenchSaturated(
                f"expected {_AXES[worst]} of {self._name} within ± {self._limits[worst]:.3g} {_UNITS[worst]}, got "
                f"{wrench.six[worst]:.3g}; press less"
            )


class _FreezeDetector:
    """Rejects a sample that the device keeps repeating."""

    _LEAST_REPEATS = 5

    def __init__(self, name: str, settings: SampleCheckSettings) -> None:
        self._name, self._frozen_ms = name, settings.frozen_ms
        self._first: Wrench | None = None
        self._repeats = 0

    def check(self, wrench: Wrench) -> None:
        """Raise `WrenchFrozen` for a sample that has repeated for too long."""
        if self._first is None or not np.array_equal(wrench.six, self._first.six):
            self._first, self._repeats = wrench, 0
            return
        self._repeats += 1
        same_ms = (wrench.stamp_ns - self._first.stamp_ns) / _NS_PER_MS
        if self._repeats >= self._LEAST_REPEATS and same_ms > self._frozen_ms:
            raise WrenchFrozen(
                f"expected the samples of {self._name} to differ by noise, got the same one for {same_ms:.0f} ms; switch it "
                "off and on, and tare"
            )


class _JumpDetector:
    """Rejects a jump from the last accepted sample, until the new level has lasted."""

    def __init__(self, name: str, settings: SampleCheckSettings) -> None:
        self._name, self._settings = name, settings
        self._last: Wrench | None = None
        self._jumped_at_ns: int | None = None

    def check(self, wrench: Wrench) -> None:
        """Raise `WrenchJumped` for a sample that jumped and has not settled."""
        if self._last is not None and self._is_jump(wrench, self._last):
            self._jumped_at_ns = self._jumped_at_ns or wrench.stamp_ns
            if wrench.stamp_ns - self._jumped_at_ns < self._settings.jump_settles_ms * _NS_PER_MS:
                raise self._jump_error(wrench, self._last)
        self._last, self._jumped_at_ns = wrench, None

    def _is_jump(self, wrench: Wrench, last: Wrench) -> bool:
        apart_ms = (wrench.stamp_ns - last.stamp_ns) / _NS_PER_MS
        if self._jumped_at_ns is None and apart_ms > self._settings.jump_within_ms:
            return False
        force_n, torque_nm = np.abs(wrench.force_n - last.force_n), np.abs(wrench.torque_nm - last.torque_nm)
        return bool(force_n.max() > self._settings.jump_n or torque_nm.max() > self._settings.jump_nm)

    def _jump_error(self, wrench: Wrench, last: Wrench) -> WrenchJumped:
        change = wrench.six - last.six
        limits = np.repeat([self._settings.jump_n, self._settings.jump_nm], 3)
        worst = int((np.abs(change) / limits).argmax())
        return WrenchJumped(
            f"expected {_AXES[worst]} of {self._name} to change by at most {limits[worst]:.3g} {_UNITS[worst]} from sample to "
            f"sample, got {change[worst]:+.3g}; check its cable, and tare again if it stays there"
        )


class SkippingWrenchSource(WrenchSource):
    """Wraps a source and skips its rejected samples; `on_skip` is called once at the beginning of each run of them."""

    def __init__(self, source: WrenchSource, on_skip: Callable[[WrenchSampleRejected], None]) -> None:
        self.name = source.name
        self.skipped = 0
        self._source, self._on_skip = source, on_skip

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._source.open()
        self.skipped = 0

    def read(self) -> Wrench:
        """Wait for the next usable sample and return it, however long that takes."""
        reported = False
        while True:
            try:
                return self._source.read()
            except WrenchSampleRejected as reason:
                self.skipped += 1
                if not reported:
                    self._on_skip(reason)
                reported = True

    def close(self) -> None:
        """Close the source that this one wraps."""
        self._source.close()


_REMEMBERED_INTERVALS = 64
_LOST_NS = 1_000_000_000
"""Silence after which a device counts as lost (`WrenchSensorLost`); its zero may have changed when it is back."""
_DELAY_WINDOW_NS = 1_000_000_000
"""Time over which the smallest delay of a source is taken: delays vary, but their minimum does not."""


class SampleFault(StrEnum):
    """What is wrong with the force/torque samples of a moment, as a sentence; such a moment is not saved."""

    FROZEN = "the force/torque sensor repeats one sample"
    JUMPED = "the force/torque sensor jumped"
    SATURATED = "the force/torque sensor is at its limit: press less"
    FAULTY = "the force/torque sensor marks its samples as wrong"
    SHIFTED = "the force/torque sensor jumped or was away, and has not been at rest since: lift the object"
    NOT_AT_REST = (
        "nothing seems to touch the gel, but the force/torque sensor is not at rest: lift the object and tare (t)"
    )
    UNPAIRED = "no force/torque samples near enough to the image in time"
    CLOCK = "the clocks of images and forces drift apart: stop and start again"


REJECTION_FAULTS = {
    WrenchFrozen: SampleFault.FROZEN,
    WrenchJumped: SampleFault.JUMPED,
    WrenchSaturated: SampleFault.SATURATED,
}
"""The fault of each kind of rejection; `FAULTY` for any other."""


@dataclass
class SampleFaultHistory:
    """Receives every sample and every rejection, and stores the times at which a fault existed."""

    frozen_ns: int
    """How long a sensor may have been frozen when its samples are rejected."""
    intervals: deque[tuple[int, int, SampleFault]] = field(
        default_factory=lambda: deque(maxlen=_REMEMBERED_INTERVALS), init=False
    )
    """Begin, end and fault of each interval."""
    rejection: tuple[int, SampleFault] | None = field(default=None, init=False)
    """Start and reason of the current rejection, until a sample is accepted."""
    zero_changes_ns: list[int] = field(default_factory=list, init=False)
    """Times after which the reading without contact may have changed and has not been confirmed, ascending."""
    last_ns: int = field(default=0, init=False)

    def accept(self, wrench: Wrench) -> bool:
        """Record an accepted sample; return whether its stamp follows the others."""
        if wrench.stamp_ns <= self.last_ns:
            self.intervals.append((wrench.stamp_ns, self.last_ns, SampleFault.CLOCK))
            return False
        if self.rejection is not None:
            since_ns, fault = self.rejection
            self.intervals.append((since_ns, wrench.stamp_ns, fault))
        elif 0 < self.last_ns < wrench.stamp_ns - _LOST_NS:
            self.mark_zero_uncertain()
        self.last_ns, self.rejection = wrench.stamp_ns, None
        return True

    def reject(self, reason: WrenchSampleRejected) -> None:
        """Record a rejected sample."""
        fault = REJECTION_FAULTS.get(type(reason), SampleFault.FAULTY)
        since_ns = self.last_ns - (self.frozen_ns if fault is SampleFault.FROZEN else 0)
        self.rejection = self.rejection or (since_ns, fault)
        if fault is SampleFault.JUMPED:
            self.mark_zero_uncertain()

    def mark_zero_uncertain(self) -> None:
        """Record that the reading without contact may have changed."""
        if self.last_ns not in self.zero_changes_ns:
            self.zero_changes_ns.append(self.last_ns)

    def confirm_zero(self, at_ns: int) -> None:
        """Record that the sensor read no load without contact at this time, so that its zero is correct whatever happened before.

        An image is decided later than it was taken: what happened between, it cannot confirm.
        """
        self.zero_changes_ns = [changed_ns for changed_ns in self.zero_changes_ns if changed_ns >= at_ns]

    def fault_between(self, from_ns: int, to_ns: int) -> SampleFault | None:
        """Return a fault in this interval, or None."""
        intervals = list(self.intervals)
        if self.rejection is not None:
            intervals.append((self.rejection[0], to_ns, self.rejection[1]))
        for begin_ns, end_ns, fault in intervals:
            if begin_ns <= to_ns and end_ns >= from_ns:
                return fault
        return SampleFault.SHIFTED if any(to_ns > changed_ns for changed_ns in self.zero_changes_ns) else None


@dataclass
class ClockDriftMonitor:
    """Checks whether the stamps of a source keep a constant offset to the clock of this machine."""

    tolerance_ms: float
    first_delay_ns: float | None = field(default=None, init=False)
    """Smallest delay at the beginning."""
    drift_ns: float = field(default=0.0, init=False)
    smallest_delay_ns: float = field(default=np.inf, init=False)
    window_ends_ns: int = field(default=0, init=False)

    def add_arrival(self, stamp_ns: int, arrived_ns: int) -> None:
        """Record the stamp and the arrival of an image or sample."""
        self.window_ends_ns = self.window_ends_ns or arrived_ns + _DELAY_WINDOW_NS
        self.smallest_delay_ns = min(self.smallest_delay_ns, arrived_ns - stamp_ns)
        if arrived_ns < self.window_ends_ns:
            return
        self.first_delay_ns = self.smallest_delay_ns if self.first_delay_ns is None else self.first_delay_ns
        self.drift_ns = self.smallest_delay_ns - self.first_delay_ns
        self.smallest_delay_ns, self.window_ends_ns = np.inf, arrived_ns + _DELAY_WINDOW_NS

    @property
    def is_within_tolerance(self) -> bool:
        """Whether the drift since the beginning is within the tolerance."""
        return abs(self.drift_ns) <= self.tolerance_ms * 1e6

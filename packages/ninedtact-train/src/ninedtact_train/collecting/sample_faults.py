"""The faults of force/torque sensor and clocks by time, which determine the moments that must not be saved.

They include the time before a rejection in which the fault already existed but could not be detected yet.
"""

from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from ninedtact.capture.wrench_source import WrenchFrozen, WrenchJumped, WrenchSampleRejected, WrenchSaturated
from ninedtact.quantities import Wrench

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

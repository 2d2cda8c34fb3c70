"""Which moments are not to be believed, because of their samples or because of a clock.

`Trusted` refuses samples one by one (capture/force_torque/trusted.py). Here it is kept for when: also for the time before a
refusal in which the fault was already there and nobody could know.
"""

from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from ninedtact.capture.wrench_source import WrenchFrozen, WrenchJumped, WrenchSampleRejected, WrenchSaturated
from ninedtact.quantities import Wrench

REMEMBERED = 64
WATCH_NS = 1_000_000_000
"""Over which the least delay of a source is taken: delays vary, the least does not."""


class SampleFault(StrEnum):
    """Why a moment is not saved, as a person is told where nothing tells more."""

    FROZEN = "the force/torque sensor repeats one sample"
    JUMPED = "the force/torque sensor jumped"
    SATURATED = "the force/torque sensor is at its limit: press less"
    FAULTY = "the force/torque sensor calls its samples wrong"
    SHIFTED = "the force/torque sensor jumped or was away, and was not seen at rest since: lift the object"
    NOT_AT_REST = "the skin looks untouched, but the force/torque sensor is not at rest: lift the object and tare (t)"
    UNPAIRED = "no force/torque samples near enough to the image in time"
    CLOCK = "the clocks of images and forces drift apart: stop and begin anew"


FAULTS = {WrenchFrozen: SampleFault.FROZEN, WrenchJumped: SampleFault.JUMPED, WrenchSaturated: SampleFault.SATURATED}


@dataclass
class SampleFaultTracker:
    """Hears of every sample and every refusal, and knows when something was wrong."""

    frozen_ns: int
    """How long a sensor may have been frozen when it is refused."""
    stretches: deque[tuple[int, int, SampleFault]] = field(default_factory=lambda: deque(maxlen=REMEMBERED), init=False)
    refusal: tuple[int, SampleFault] | None = field(default=None, init=False)
    """Since when samples are refused, until one is not."""
    shifted_since_ns: int | None = field(default=None, init=False)
    """Its zero may be another since then."""
    last_ns: int = field(default=0, init=False)

    def takes(self, wrench: Wrench) -> bool:
        """A sample that was not refused; whether it has a place after the others."""
        if wrench.stamp_ns <= self.last_ns:
            self.stretches.append((wrench.stamp_ns, self.last_ns, SampleFault.CLOCK))
            return False
        if self.refusal is not None:
            since_ns, fault = self.refusal
            self.stretches.append((since_ns, wrench.stamp_ns, fault))
        self.last_ns, self.refusal = wrench.stamp_ns, None
        return True

    def refuse(self, reason: WrenchSampleRejected) -> None:
        """A sample was refused."""
        fault = FAULTS.get(type(reason), SampleFault.FAULTY)
        since_ns = self.last_ns - (self.frozen_ns if fault is SampleFault.FROZEN else 0)
        self.refusal = self.refusal or (since_ns, fault)
        if fault is SampleFault.JUMPED:
            self.doubt_zero()

    def doubt_zero(self) -> None:
        """What the sensor reads when nothing touches may have changed."""
        self.shifted_since_ns = self.shifted_since_ns or self.last_ns

    def at_rest(self) -> None:
        """The skin is untouched and the sensor reads nothing: whatever happened, it came back."""
        self.shifted_since_ns = None

    def fault(self, from_ns: int, to_ns: int) -> SampleFault | None:
        """What speaks against this time."""
        stretches = list(self.stretches)
        if self.refusal is not None:
            stretches.append((self.refusal[0], to_ns, self.refusal[1]))
        for begin_ns, end_ns, fault in stretches:
            if begin_ns <= to_ns and end_ns >= from_ns:
                return fault
        shifted = self.shifted_since_ns is not None and to_ns > self.shifted_since_ns
        return SampleFault.SHIFTED if shifted else None


@dataclass
class ClockDriftMonitor:
    """Whether a source's stamps keep their distance to this machine's clock."""

    tolerance_ms: float
    first_ns: float | None = field(default=None, init=False)
    """Least delay at the beginning."""
    drift_ns: float = field(default=0.0, init=False)
    least_ns: float = field(default=np.inf, init=False)
    watch_ends_ns: int = field(default=0, init=False)

    def note(self, stamp_ns: int, heard_ns: int) -> None:
        """An image or sample came."""
        self.watch_ends_ns = self.watch_ends_ns or heard_ns + WATCH_NS
        self.least_ns = min(self.least_ns, heard_ns - stamp_ns)
        if heard_ns < self.watch_ends_ns:
            return
        self.first_ns = self.least_ns if self.first_ns is None else self.first_ns
        self.drift_ns = self.least_ns - self.first_ns
        self.least_ns, self.watch_ends_ns = np.inf, heard_ns + WATCH_NS

    @property
    def keeps(self) -> bool:
        """Whether it does."""
        return abs(self.drift_ns) <= self.tolerance_ms * 1e6

"""Samples that must not be used: beyond the device's range, frozen, or leaping as no load does.

Such a sample is *raised*, as `WrenchSampleRejected` with its reason, never returned: what is not returned cannot be saved. The
source stays open and the next read goes on. `SkippingWrenchSource` is for those who only want to look.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ninedtact.capture.wrench_source import (
    WrenchFrozen,
    WrenchJumped,
    WrenchSampleRejected,
    WrenchSaturated,
    WrenchSource,
)
from ninedtact.quantities import Wrench

NS_PER_MS = 1_000_000
NAMES = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")
UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")


@dataclass(frozen=True)
class SampleCheckSettings:
    """When a sample is not believed; in the device's own frame, before any tare."""

    range_n: tuple[float, float, float] | None = None
    """Largest force along each axis that the device is made for, from its data sheet; None: only the device's own flag counts."""
    range_nm: tuple[float, float, float] | None = None
    """Largest torque about each axis."""
    saturated_from: float = 0.98
    """Part of the range from which a sample counts as saturated."""
    frozen_ms: float = 200.0
    """The device repeats a sample for this long, at least five times: six noisy numbers never do."""
    jump_n: float = 10.0
    """From one sample to the next, if they are no more than `jump_within_ms` apart."""
    jump_nm: float = 0.5
    jump_within_ms: float = 20.0
    jump_settles_ms: float = 50.0
    """After this long at the new level it counts as the load; whatever moved the reading may have moved its zero too."""


class CheckedWrenchSource(WrenchSource):
    """Another source without the samples that must not be used: they raise `WrenchSampleRejected`."""

    def __init__(self, source: WrenchSource, settings: SampleCheckSettings = SampleCheckSettings()) -> None:
        self.name = source.name
        self._source, self._settings = source, settings
        self._forget()

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._source.open()
        self._forget()

    def read(self) -> Wrench:
        """The next sample; raises `WrenchSaturated`, `WrenchFrozen`, `WrenchJumped`, and what the source raises."""
        wrench = self._source.read()
        for watch in self._watches:
            watch.refuse_untrusted(wrench)
        return wrench

    def close(self) -> None:
        """Close the source."""
        self._source.close()

    def _forget(self) -> None:
        watches = (SaturationDetector, FreezeDetector, JumpDetector)
        self._watches = [watch(self.name, self._settings) for watch in watches]


class SaturationDetector:
    """Refuses what is at the end of the device's range."""

    def __init__(self, name: str, settings: SampleCheckSettings) -> None:
        self._name, unknown = name, (np.inf, np.inf, np.inf)
        ends = [*(settings.range_n or unknown), *(settings.range_nm or unknown)]
        self._limits = settings.saturated_from * np.array(ends)

    def refuse_untrusted(self, wrench: Wrench) -> None:
        """Raises `WrenchSaturated`."""
        excess = np.abs(wrench.six) / self._limits
        worst = int(excess.argmax())
        if excess[worst] >= 1:
            raise WrenchSaturated(
                f"expected {NAMES[worst]} of {self._name} within ± {self._limits[worst]:.3g} {UNITS[worst]}, got "
                f"{wrench.six[worst]:.3g}; press less"
            )


class FreezeDetector:
    """Refuses a sample that the device goes on repeating."""

    LEAST_REPEATS = 5

    def __init__(self, name: str, settings: SampleCheckSettings) -> None:
        self._name, self._frozen_ms = name, settings.frozen_ms
        self._first: Wrench | None = None
        self._repeats = 0

    def refuse_untrusted(self, wrench: Wrench) -> None:
        """Raises `WrenchFrozen`."""
        if self._first is None or not np.array_equal(wrench.six, self._first.six):
            self._first, self._repeats = wrench, 0
            return
        self._repeats += 1
        same_ms = (wrench.stamp_ns - self._first.stamp_ns) / NS_PER_MS
        if self._repeats >= self.LEAST_REPEATS and same_ms > self._frozen_ms:
            raise WrenchFrozen(
                f"expected the samples of {self._name} to differ by noise, got the same one for {same_ms:.0f} ms; switch it "
                "off and on, and tare"
            )


class JumpDetector:
    """Refuses a leap from the last trusted sample, until it has lasted."""

    def __init__(self, name: str, settings: SampleCheckSettings) -> None:
        self._name, self._settings = name, settings
        self._last: Wrench | None = None
        self._leapt_ns: int | None = None

    def refuse_untrusted(self, wrench: Wrench) -> None:
        """Raises `WrenchJumped`."""
        if self._last is not None and self._leaps(wrench, self._last):
            self._leapt_ns = self._leapt_ns or wrench.stamp_ns
            if wrench.stamp_ns - self._leapt_ns < self._settings.jump_settles_ms * NS_PER_MS:
                raise self._jumped(wrench, self._last)
        self._last, self._leapt_ns = wrench, None

    def _leaps(self, wrench: Wrench, last: Wrench) -> bool:
        apart_ms = (wrench.stamp_ns - last.stamp_ns) / NS_PER_MS
        if self._leapt_ns is None and apart_ms > self._settings.jump_within_ms:
            return False
        force_n, torque_nm = np.abs(wrench.force_n - last.force_n), np.abs(wrench.torque_nm - last.torque_nm)
        return bool(force_n.max() > self._settings.jump_n or torque_nm.max() > self._settings.jump_nm)

    def _jumped(self, wrench: Wrench, last: Wrench) -> WrenchJumped:
        change = wrench.six - last.six
        limits = np.repeat([self._settings.jump_n, self._settings.jump_nm], 3)
        worst = int((np.abs(change) / limits).argmax())
        return WrenchJumped(
            f"expected {NAMES[worst]} of {self._name} to change by at most {limits[worst]:.3g} {UNITS[worst]} from sample to "
            f"sample, got {change[worst]:+.3g}; check its cable, and tare again if it stays there"
        )


class SkippingWrenchSource(WrenchSource):
    """Another source without its untrusted samples, for those who look: `on_skip` is told once each time they begin."""

    def __init__(self, source: WrenchSource, on_skip: Callable[[WrenchSampleRejected], None]) -> None:
        self.name = source.name
        self.skipped = 0
        self._source, self._on_skip = source, on_skip

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._source.open()
        self.skipped = 0

    def read(self) -> Wrench:
        """The next sample that can be trusted, however long that takes."""
        told = False
        while True:
            try:
                return self._source.read()
            except WrenchSampleRejected as reason:
                self.skipped += 1
                if not told:
                    self._on_skip(reason)
                told = True

    def close(self) -> None:
        """Close the source."""
        self._source.close()

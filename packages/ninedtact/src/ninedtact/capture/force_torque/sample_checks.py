"""Checks that reject samples of a force/torque sensor: beyond its range, frozen, or changing faster than any load does.

A rejected sample raises `WrenchSampleRejected` with its reason and is never returned, so that it cannot be saved by mistake.
The source stays open and the next read continues. `SkippingWrenchSource` is for displays, which need no reason.
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
    WrenchSourceWrapper,
)
from ninedtact.errors import InputError
from ninedtact.quantities import Wrench

_NS_PER_MS = 1_000_000
_AXES = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")
_UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")


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
                raise InputError(
                    f"expected three ranges of a force/torque sensor above zero, got {limits} {unit}; take them from its data sheet"
                )


class CheckedWrenchSource(WrenchSourceWrapper):
    """Wraps a source and raises `WrenchSampleRejected` for its unusable samples."""

    def __init__(self, source: WrenchSource, settings: SampleCheckSettings = SampleCheckSettings()) -> None:
        super().__init__(source)
        self._settings = settings
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


class SkippingWrenchSource(WrenchSourceWrapper):
    """Wraps a source and skips its rejected samples; `on_skip` is called once at the beginning of each run of them."""

    def __init__(self, source: WrenchSource, on_skip: Callable[[WrenchSampleRejected], None]) -> None:
        super().__init__(source)
        self.skipped = 0
        self._on_skip = on_skip

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

"""Checks that reject samples of a force/torque sensor: beyond its range, frozen, or changing faster than any load does.

A rejected sample raises `WrenchSampleRejected` with its reason and is never returned, so that it cannot be saved by mistake.
The source stays open and the next read continues. `SkippingWrenchSource` is for displays, which need no reason.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta

from ninedtact.bounds import checks_arguments
from ninedtact.capture.wrench_source import (
    WrenchFrozen,
    WrenchJumped,
    WrenchSampleRejected,
    WrenchSaturated,
    WrenchSource,
    WrenchSourceWrapper,
)
from ninedtact.quantities import Wrench

_NS_PER_MS = 1_000_000
_AXES = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")
_UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")
_LEAST_REPEATS = 5
_Range = Annotated[float, Meta(gt=0)]
_Ranges = tuple[_Range, _Range, _Range]


@checks_arguments
@dataclass(frozen=True)
class SampleCheckSettings:
    """When a sample is rejected; all values are in the frame of the device, before any tare."""

    range_n: _Ranges | None = None
    """Range of the force/torque sensor along each axis, N, from its data sheet; samples near its end are not saved."""
    range_nm: _Ranges | None = None
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


class CheckedWrenchSource(WrenchSourceWrapper):
    """Wraps a source and raises `WrenchSampleRejected` for its unusable samples."""

    def __init__(self, source: WrenchSource, settings: SampleCheckSettings = SampleCheckSettings()) -> None:
        super().__init__(source)
        unknown = (np.inf, np.inf, np.inf)
        self._settings = settings
        self._limits = settings.saturated_fraction * np.array(
            [*(settings.range_n or unknown), *(settings.range_nm or unknown)]
        )
        self._jump_limits = np.repeat([settings.jump_n, settings.jump_nm], 3)

    def open(self) -> None:
        """Open the source; raises what it raises."""
        super().open()
        self._repeated: Wrench | None = None
        """The first of the samples that are all the same as the last."""
        self._repeats = 0
        self._accepted: Wrench | None = None
        self._jumped_at_ns: int | None = None

    def read(self) -> Wrench:
        """Return the next sample; raises `WrenchSaturated`, `WrenchFrozen`, `WrenchJumped`, and what the source raises."""
        wrench = self._source.read()
        self._require_within_range(wrench)
        self._require_change(wrench)
        self._require_no_jump(wrench)
        return wrench

    def _require_within_range(self, wrench: Wrench) -> None:
        excess = np.abs(wrench.six) / self._limits
        worst = int(excess.argmax())
        if excess[worst] >= 1:
            raise WrenchSaturated(
                expected=f"{_AXES[worst]} of {self.name} within ± {self._limits[worst]:.3g} {_UNITS[worst]}",
                got=f"{wrench.six[worst]:.3g}",
                remedy="press less",
            )

    def _require_change(self, wrench: Wrench) -> None:
        if self._repeated is None or not np.array_equal(wrench.six, self._repeated.six):
            self._repeated, self._repeats = wrench, 0
            return
        self._repeats += 1
        same_ms = (wrench.stamp_ns - self._repeated.stamp_ns) / _NS_PER_MS
        if self._repeats >= _LEAST_REPEATS and same_ms > self._settings.frozen_ms:
            raise WrenchFrozen(
                expected=f"the samples of {self.name} to differ by noise",
                got=f"the same one for {same_ms:.0f} ms",
                remedy="switch it off and on, and tare",
            )

    def _require_no_jump(self, wrench: Wrench) -> None:
        """Raise `WrenchJumped` for a jump from the last accepted sample, until the new level has lasted."""
        if self._accepted is not None and self._is_jump(wrench, self._accepted):
            self._jumped_at_ns = self._jumped_at_ns or wrench.stamp_ns
            if wrench.stamp_ns - self._jumped_at_ns < self._settings.jump_settles_ms * _NS_PER_MS:
                change = wrench.six - self._accepted.six
                worst = int((np.abs(change) / self._jump_limits).argmax())
                raise WrenchJumped(
                    expected=f"{_AXES[worst]} of {self.name} to change by at most {self._jump_limits[worst]:.3g} "
                    f"{_UNITS[worst]} from sample to sample",
                    got=f"{change[worst]:+.3g}",
                    remedy="check its cable, and tare again if it stays there",
                )
        self._accepted, self._jumped_at_ns = wrench, None

    def _is_jump(self, wrench: Wrench, last: Wrench) -> bool:
        apart_ms = (wrench.stamp_ns - last.stamp_ns) / _NS_PER_MS
        if self._jumped_at_ns is None and apart_ms > self._settings.jump_within_ms:
            return False
        return bool((np.abs(wrench.six - last.six) > self._jump_limits).any())


class SkippingWrenchSource(WrenchSourceWrapper):
    """Wraps a source and skips its rejected samples; `on_skip` is called once at the beginning of each run of them."""

    def __init__(self, source: WrenchSource, on_skip: Callable[[WrenchSampleRejected], None]) -> None:
        super().__init__(source)
        self._on_skip = on_skip

    def read(self) -> Wrench:
        """Wait for the next usable sample and return it, however long that takes."""
        reported = False
        while True:
            try:
                return self._source.read()
            except WrenchSampleRejected as reason:
                if not reported:
                    self._on_skip(reason)
                reported = True

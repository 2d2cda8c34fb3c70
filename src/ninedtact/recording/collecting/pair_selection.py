"""An image and the wrench of its moment, before anything is decided about them.

What rest tells: a sensor that jumped came back, or one that weighs something where nothing touches has drifted.

Which of the moments that can be trusted are worth saving, and which contact each belongs to.
"""

from dataclasses import dataclass, field

import numpy as np

from ninedtact.capture.sampling_rule import SamplingRule
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.collecting.pair_counts import PairCounts
from ninedtact.recording.collecting.settings import CollectSettings
from ninedtact.recording.saved_pairs import PairKind


@dataclass(frozen=True)
class PairCandidate:
    """What was seen and weighed at once."""

    frame: Frame
    wrench: Wrench
    """About the skin's centre, tare taken off."""
    change: float
    """Grey levels from the untouched skin."""

    def looks_untouched(self, settings: CollectSettings) -> bool:
        """Whether the image shows nothing; between this and a touch it shows neither."""
        return self.change < settings.touched_levels / 2

    def rests(self, settings: CollectSettings) -> bool:
        """Whether the force/torque sensor reads nothing."""
        return bool((np.abs(self.wrench.six) <= settings.rest).all())


UNREST_NS = 2_000_000_000
"""A load on skin that looks untouched is believed for so long: a broad flat object is felt before it is seen."""


@dataclass
class ZeroDriftMonitor:
    """Watches the skin while nothing seems to touch it."""

    settings: CollectSettings
    has_drifted: bool = field(default=False, init=False)
    """Weighs something where nothing touches; until it is seen at rest."""
    unrest_since_ns: int | None = field(default=None, init=False)

    def sees(self, moment: PairCandidate) -> bool:
        """Look at a moment; whether it is one of rest."""
        if not moment.looks_untouched(self.settings):
            self.unrest_since_ns = None
            return False
        if moment.rests(self.settings):
            self.begin()
            return True
        self.unrest_since_ns = self.unrest_since_ns or moment.frame.stamp_ns
        self.has_drifted |= moment.frame.stamp_ns - self.unrest_since_ns > UNREST_NS
        return False

    def begin(self) -> None:
        """The skin is known to rest."""
        self.unrest_since_ns, self.has_drifted = None, False


APART_NS = {"light_touch": 200_000_000, "no_contact": 1_000_000_000}
"""Between two pairs of a kind that the rule does not choose."""


@dataclass
class PairSelector:
    """The paper's rule, and shares of what it leaves out: light touches, and skin that nothing touches."""

    settings: CollectSettings
    rule: SamplingRule
    contact: int = field(default=0, init=False)
    """Number of the contact, or of the time between two."""
    touching: bool = field(default=False, init=False)
    last_ns: dict[PairKind, int] = field(default_factory=dict, init=False)

    def of(self, moment: PairCandidate, counters: PairCounts) -> PairKind | None:
        """Why to save a moment, if at all; asked about every moment in turn."""
        kept = self.rule.keeps(moment.wrench)
        self._note_touch(moment)
        if kept:
            return "rule"
        kind: PairKind = "light_touch" if self.touching else "no_contact"
        return kind if self._is(kind, moment) and self._is_wanted(kind, moment, counters) else None

    def begin_contact(self) -> None:
        """What follows is another contact, though nothing may have been lifted."""
        self.contact += 1
        self.rule.end_contact()

    def _note_touch(self, moment: PairCandidate) -> None:
        # A touch that was seen goes on until the image shows nothing.
        levels = self.settings.touched_levels / (2 if self.touching else 1)
        touching = self.rule.touching or moment.change > levels
        self.contact += touching != self.touching
        self.touching = touching

    def _is(self, kind: PairKind, moment: PairCandidate) -> bool:
        if kind == "light_touch":
            return not self.rule.touching and moment.change > self.settings.touched_levels
        return moment.looks_untouched(self.settings) and moment.rests(self.settings)

    def _is_wanted(self, kind: PairKind, moment: PairCandidate, counters: PairCounts) -> bool:
        """Whether a kind is short of its share, and the last one some time ago."""
        share = self.settings.light_touch if kind == "light_touch" else self.settings.no_contact
        is_soon = moment.frame.stamp_ns - self.last_ns.get(kind, 0) < APART_NS[kind]
        if is_soon or counters.kinds[kind] >= share * (len(counters.saved) + 1):
            return False
        self.last_ns[kind] = moment.frame.stamp_ns
        return True

"""Which of the moments that can be trusted are worth saving, and which contact each belongs to."""

from dataclasses import dataclass, field

from ninedtact.capture.sampling_rule import SamplingRule
from ninedtact.recording.collecting.counters import Counters
from ninedtact.recording.collecting.moment import Moment
from ninedtact.recording.collecting.settings import CollectSettings
from ninedtact.recording.saved_pair import Kind

APART_NS = {"light_touch": 200_000_000, "no_contact": 1_000_000_000}
"""Between two pairs of a kind that the rule does not choose."""


@dataclass
class Worth:
    """The paper's rule, and shares of what it leaves out: light touches, and skin that nothing touches."""

    settings: CollectSettings
    rule: SamplingRule
    contact: int = field(default=0, init=False)
    """Number of the contact, or of the time between two."""
    touching: bool = field(default=False, init=False)
    last_ns: dict[Kind, int] = field(default_factory=dict, init=False)

    def of(self, moment: Moment, counters: Counters) -> Kind | None:
        """Why to save a moment, if at all; asked about every moment in turn."""
        kept = self.rule.keeps(moment.wrench)
        self._note_touch(moment)
        if kept:
            return "rule"
        kind: Kind = "light_touch" if self.touching else "no_contact"
        return kind if self._is(kind, moment) and self._is_wanted(kind, moment, counters) else None

    def begin_contact(self) -> None:
        """What follows is another contact, though nothing may have been lifted."""
        self.contact += 1
        self.rule.lifted()

    def _note_touch(self, moment: Moment) -> None:
        # A touch that was seen goes on until the image shows nothing.
        levels = self.settings.touched_levels / (2 if self.touching else 1)
        touching = self.rule.touching or moment.change > levels
        self.contact += touching != self.touching
        self.touching = touching

    def _is(self, kind: Kind, moment: Moment) -> bool:
        if kind == "light_touch":
            return not self.rule.touching and moment.change > self.settings.touched_levels
        return moment.looks_untouched(self.settings) and moment.rests(self.settings)

    def _is_wanted(self, kind: Kind, moment: Moment, counters: Counters) -> bool:
        """Whether a kind is short of its share, and the last one some time ago."""
        share = self.settings.light_touch if kind == "light_touch" else self.settings.no_contact
        is_soon = moment.frame.stamp_ns - self.last_ns.get(kind, 0) < APART_NS[kind]
        if is_soon or counters.kinds[kind] >= share * (len(counters.saved) + 1):
            return False
        self.last_ns[kind] = moment.frame.stamp_ns
        return True

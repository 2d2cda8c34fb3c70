"""What rest tells: a sensor that jumped came back, or one that weighs something where nothing touches has drifted."""

from dataclasses import dataclass, field

from ninedtact.recording.collecting.moment import Moment
from ninedtact.recording.collecting.settings import CollectSettings

UNREST_NS = 2_000_000_000
"""A load on skin that looks untouched is believed for so long: a broad flat object is felt before it is seen."""


@dataclass
class Rest:
    """Watches the skin while nothing seems to touch it."""

    settings: CollectSettings
    has_drifted: bool = field(default=False, init=False)
    """Weighs something where nothing touches; until it is seen at rest."""
    unrest_since_ns: int | None = field(default=None, init=False)

    def sees(self, moment: Moment) -> bool:
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

"""Pair selection of `ninedtact collect`: which moments are saved as pairs, to which contact each belongs, and all settings.

The sampling rule selects pairs within a contact; fixed fractions of light touches and of moments without contact are added.
The resolved settings are stored in the recording.
"""

from dataclasses import dataclass, field

import numpy as np

from ninedtact.capture.force_torque.sample_checks import SampleCheckSettings
from ninedtact.capture.force_torque.tare import TareSettings
from ninedtact.capture.training_pair_rule import SamplingRule, SamplingRuleSettings, SixFloats
from ninedtact.errors import InputError
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.collecting.force_coverage import PairCounts
from ninedtact.recording.saved_pairs import PairKind


class CollectSettingsInvalid(InputError):
    """The settings describe a collection in which nothing can be saved."""


@dataclass(frozen=True)
class CollectSettings:
    """When an image and a wrench are saved as a pair."""

    rule: SamplingRuleSettings = SamplingRuleSettings()
    """The sampling rule of the paper for pairs within a contact."""
    checks: SampleCheckSettings = SampleCheckSettings()
    """Which samples of the force/torque sensor are rejected."""
    tare: TareSettings = TareSettings()
    """How the zero of the force/torque sensor is measured."""
    tolerance_ms: float = 10.0
    """Largest distance of the samples before and after an image; the wrench is interpolated between them."""
    camera_delay_ms: float = 0.0
    """How long before its stamp an image shows the skin: half the exposure, and the transfer to the computer."""
    no_contact: float = 0.03
    """Fraction of pairs without contact."""
    light_touch: float = 0.05
    """Fraction of pairs with contact whose load is below the start of the sampling rule."""
    reference_images: int = 10
    """Number of reference images (no contact) before the first touch and at every tare."""
    rest: SixFloats = (0.2, 0.2, 0.2, 0.015, 0.015, 0.01)
    """Largest wrench without contact, N and N·m about the skin centre; more calls for a tare."""
    contact_levels: float = 2.0
    """Grey levels by which a block of pixels must differ from the reference to show contact; below half of it nothing touches."""

    def __post_init__(self) -> None:
        if not (self.tolerance_ms > 0 and self.camera_delay_ms >= 0):
            raise CollectSettingsInvalid(
                f"expected a tolerance above zero and a camera delay of zero or more, got {self.tolerance_ms} and "
                f"{self.camera_delay_ms} ms; correct them"
            )
        if not (min(self.no_contact, self.light_touch) >= 0 and self.no_contact + self.light_touch < 1):
            raise CollectSettingsInvalid(
                f"expected fractions of zero or more, together below 1, got {self.no_contact} without contact and "
                f"{self.light_touch} with a light touch; correct them"
            )
        if not (self.reference_images >= 1 and self.contact_levels > 0 and min(self.rest) > 0):
            raise CollectSettingsInvalid(
                f"expected at least one reference image, and levels and rest above zero, got "
                f"{self.reference_images}, {self.contact_levels} and {self.rest}; correct them"
            )

    @property
    def decision_delay_ns(self) -> int:
        """How long after a moment its samples can be judged: a frozen sensor is noticed only when it keeps repeating."""
        return int((self.checks.frozen_ms + self.tolerance_ms) * 1e6)


_REST_TIMEOUT_NS = 2_000_000_000
"""Time for which a load without visible contact is accepted: a broad flat object is measurable before it is visible."""
_MIN_INTERVAL_NS = {"light_touch": 200_000_000, "no_contact": 1_000_000_000}
"""Smallest time between two pairs of a kind that the sampling rule does not select."""


@dataclass(frozen=True)
class ImageWrenchCandidate:
    """An image and the wrench at its time, before the decision whether to save them."""

    frame: Frame
    wrench: Wrench
    """The wrench about the skin centre, minus the tare."""
    change_levels: float
    """Grey levels by which the image differs from the reference."""

    def looks_untouched(self, settings: CollectSettings) -> bool:
        """Return whether the image shows no contact. Between this limit and that of a contact, it shows neither."""
        return self.change_levels < settings.contact_levels / 2

    def is_at_rest(self, settings: CollectSettings) -> bool:
        """Return whether the force/torque sensor reads no load."""
        return bool((np.abs(self.wrench.six) <= settings.rest).all())


@dataclass
class ZeroDriftMonitor:
    """Detects a drifted zero: the force/torque sensor reads a load while the image shows no contact."""

    settings: CollectSettings
    has_drifted: bool = field(default=False, init=False)
    """Whether the zero has drifted; it stays set until the sensor is at rest without visible contact."""
    load_since_ns: int | None = field(default=None, init=False)

    def check(self, candidate: ImageWrenchCandidate) -> bool:
        """Process one moment; return whether it is at rest without contact."""
        if not candidate.looks_untouched(self.settings):
            self.load_since_ns = None
            return False
        if candidate.is_at_rest(self.settings):
            self.reset()
            return True
        self.load_since_ns = self.load_since_ns or candidate.frame.stamp_ns
        self.has_drifted |= candidate.frame.stamp_ns - self.load_since_ns > _REST_TIMEOUT_NS
        return False

    def reset(self) -> None:
        """Accept the present zero as correct."""
        self.load_since_ns, self.has_drifted = None, False


@dataclass
class PairSelector:
    """Selects the moments to save from all moments in their order."""

    settings: CollectSettings
    rule: SamplingRule
    contact: int = field(default=0, init=False)
    """Number of the contact, or of the interval between two contacts."""
    touching: bool = field(default=False, init=False)
    last_ns: dict[PairKind, int] = field(default_factory=dict, init=False)

    def select(self, candidate: ImageWrenchCandidate, counts: PairCounts) -> PairKind | None:
        """Return the reason to save a moment, or None."""
        kept = self.rule.keeps(candidate.wrench)
        self._update_contact(candidate)
        if kept:
            return "rule"
        kind: PairKind = "light_touch" if self.touching else "no_contact"
        return kind if self._is_of_kind(kind, candidate) and self._is_wanted(kind, candidate, counts) else None

    def begin_contact(self) -> None:
        """Start another contact, even if the object was not lifted."""
        self.contact += 1
        self.rule.end_contact()

    def _update_contact(self, candidate: ImageWrenchCandidate) -> None:
        # A contact that was visible continues until the image shows none.
        levels = self.settings.contact_levels / (2 if self.touching else 1)
        touching = self.rule.touching or candidate.change_levels > levels
        self.contact += touching != self.touching
        self.touching = touching

    def _is_of_kind(self, kind: PairKind, candidate: ImageWrenchCandidate) -> bool:
        if kind == "light_touch":
            return not self.rule.touching and candidate.change_levels > self.settings.contact_levels
        return candidate.looks_untouched(self.settings) and candidate.is_at_rest(self.settings)

    def _is_wanted(self, kind: PairKind, candidate: ImageWrenchCandidate, counts: PairCounts) -> bool:
        """Return whether there are too few pairs of a kind, and the last one was saved long enough ago."""
        fraction = self.settings.light_touch if kind == "light_touch" else self.settings.no_contact
        is_soon = candidate.frame.stamp_ns - self.last_ns.get(kind, 0) < _MIN_INTERVAL_NS[kind]
        if is_soon or counts.kinds[kind] >= fraction * (len(counts.pairs) + 1):
            return False
        self.last_ns[kind] = candidate.frame.stamp_ns
        return True

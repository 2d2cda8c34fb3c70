"""Pair selection of `ninedtact collect`: which moments are saved as pairs, to which contact each belongs, and all settings.

`SavedPairCounts` counts the saved pairs in bins of each wrench axis, which shows the forces that are still missing. The sampling
rule selects pairs within a contact; fixed fractions of light touches and of moments without contact are added. The resolved
settings are stored in the recording.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from jaxtyping import Float64, Int
from msgspec import Meta
from numpy import ndarray as Array
from tyro.conf import Suppress, arg

from ninedtact.bounds import checks_arguments
from ninedtact.capture.force_torque.sample_checks import SampleCheckSettings
from ninedtact.capture.force_torque.tare import TareSettings
from ninedtact.quantities import DISPLAY_FACTORS, DISPLAY_UNITS, WRENCH_AXES, Frame, Wrench
from ninedtact.recording.topics_and_messages import PairLabel
from ninedtact_train.collecting.collected_pairs import PairKind
from ninedtact_train.collecting.training_pair_rule import (
    PairKindShares,
    SamplingRule,
    SamplingRuleSettings,
    SixFloats,
    wrench_limits,
)

_BINS = 12
_Limit = Annotated[float, Meta(gt=0)]
_SCARCE_FRACTION = 0.02
"""Fraction of the pairs below which a bin counts as missing."""


@dataclass
class SavedPairCounts:
    """All pairs that were saved in this session, undone contacts excluded."""

    ranges: SixFloats
    pairs: list[PairLabel] = field(default_factory=list)

    def add(self, pair: PairLabel) -> None:
        """Count one more saved pair."""
        self.pairs.append(pair)

    def undo(self, contact: str) -> int:
        """Remove the pairs of a contact and return their number."""
        before = len(self.pairs)
        self.pairs = [pair for pair in self.pairs if pair.contact != contact]
        return before - len(self.pairs)

    @property
    def kinds(self) -> Counter[str]:
        """Number of pairs of each kind."""
        return Counter(pair.kind for pair in self.pairs)

    @property
    def objects(self) -> Counter[str]:
        """Number of pairs of each object."""
        return Counter(pair.object for pair in self.pairs)

    @property
    def counts(self) -> Int[Array, "6 bins"]:
        """Number of pairs in each of the twelve bins of each axis; values beyond the range count in the last bin."""
        low, high = self.limits
        wrenches = np.array([pair.wrench.six for pair in self.pairs]).reshape(-1, 6)
        bins = ((wrenches - low) / (high - low) * _BINS).astype(int).clip(0, _BINS - 1)
        return (bins[..., None] == np.arange(_BINS)).sum(0)

    @property
    def limits(self) -> Float64[Array, "2 6"]:
        """Lower and upper limit of each axis, N and N·m."""
        return wrench_limits(self.ranges)

    @property
    def last_contact(self) -> str | None:
        """The newest contact that has pairs."""
        return next((pair.contact for pair in reversed(self.pairs) if pair.kind != "no_contact"), None)

    def missing_ranges(self) -> list[str]:
        """Return the ranges that hold hardly any pairs, as text."""
        texts = []
        scarce = self.counts <= _SCARCE_FRACTION * max(len(self.pairs), 1)
        for axis, (low, high) in enumerate(self.limits.T * DISPLAY_FACTORS[:, None]):
            edges = np.linspace(low, high, _BINS + 1)
            borders = np.flatnonzero(np.diff(scarce[axis].astype(int), prepend=0, append=0)).reshape(-1, 2)
            name, unit = WRENCH_AXES[axis], DISPLAY_UNITS[axis]
            texts += [f"{name} {edges[one]:.3g} to {edges[other]:.3g} {unit}" for one, other in borders]
        return texts


@checks_arguments
@dataclass(frozen=True)
class CollectSettings:
    """Sampling rule, checks, tare and tolerances by which images and wrenches are saved as pairs."""

    rule: Annotated[SamplingRuleSettings, arg(name="")] = SamplingRuleSettings()
    """The sampling rule of the paper for pairs within a contact."""
    shares: Annotated[PairKindShares, arg(name="")] = PairKindShares()
    checks: Annotated[SampleCheckSettings, arg(name="")] = SampleCheckSettings()
    """Which samples of the force/torque sensor are rejected."""
    tare: Annotated[TareSettings, Suppress] = TareSettings()
    """How the zero of the force/torque sensor is measured."""
    tolerance_ms: Annotated[float, Meta(gt=0, le=1e6)] = 10.0
    """Largest distance in time of the force/torque samples before and after an image; the wrench is interpolated."""
    reference_images: Annotated[int, Meta(ge=1)] = 10
    """Number of reference images (no contact) before the first touch and at every tare."""
    rest: tuple[_Limit, _Limit, _Limit, _Limit, _Limit, _Limit] = (0.2, 0.2, 0.2, 0.015, 0.015, 0.01)
    """Largest wrench without contact, N and N·m about the skin centre; more calls for a tare."""
    contact_levels: Annotated[float, Meta(gt=0)] = 2.0
    """Grey levels by which a block of pixels must differ from the reference to show contact; below half of it nothing touches."""

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

    def select(self, candidate: ImageWrenchCandidate, counts: SavedPairCounts) -> PairKind | None:
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

    def _is_wanted(self, kind: PairKind, candidate: ImageWrenchCandidate, counts: SavedPairCounts) -> bool:
        """Return whether there are too few pairs of a kind, and the last one was saved long enough ago."""
        fraction = getattr(self.settings.shares, kind)
        is_soon = candidate.frame.stamp_ns - self.last_ns.get(kind, 0) < _MIN_INTERVAL_NS[kind]
        if is_soon or counts.kinds[kind] >= fraction * (len(counts.pairs) + 1):
            return False
        self.last_ns[kind] = candidate.frame.stamp_ns
        return True

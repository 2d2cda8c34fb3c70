"""What was saved, counted per range of each axis, so that a person sees which forces are missing."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.sampling_rule import SixFloats
from ninedtact.recording.saved_pairs import PairKind

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")
BINS = 12
SCARCE = 0.02
"""Share of the pairs below which a range is missing."""


@dataclass(frozen=True)
class CountedPair:
    """What is remembered of a pair."""

    kind: PairKind
    object: str
    contact: str
    six: Float64[Array, "6"]


@dataclass
class PairCounts:
    """Everything that was saved in this session, undone contacts taken out."""

    ranges: SixFloats
    saved: list[CountedPair] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)
    objects: Counter[str] = field(default_factory=Counter)
    counts: Array = field(default_factory=lambda: np.zeros((6, BINS), int))
    """Pairs in each of the twelve parts of each axis's range; what is beyond counts at its end."""

    def add(self, pair: CountedPair) -> None:
        """One more."""
        self.saved.append(pair)
        self._count(pair, +1)

    def undo(self, contact: str) -> int:
        """Take a contact out; how many pairs it had."""
        undone = [pair for pair in self.saved if pair.contact == contact]
        self.saved = [pair for pair in self.saved if pair.contact != contact]
        for pair in undone:
            self._count(pair, -1)
        return len(undone)

    def _count(self, pair: CountedPair, by: int) -> None:
        self.kinds[pair.kind] += by
        self.objects[pair.object] += by
        low, high = self.spans
        parts = ((pair.six - low) / (high - low) * BINS).astype(int).clip(0, BINS - 1)
        self.counts[np.arange(6), parts] += by

    @property
    def spans(self) -> Float64[Array, "2 6"]:
        """From where to where each axis is counted: about zero, the load from zero inwards."""
        widths = np.array(self.ranges)
        low = -widths / 2
        low[2] = -widths[2]
        return np.array([low, low + widths])

    @property
    def last_contact(self) -> str | None:
        """The newest contact that has pairs."""
        return next((pair.contact for pair in reversed(self.saved) if pair.kind != "no_contact"), None)

    def missing(self) -> list[str]:
        """Ranges with hardly a pair, in words."""
        return [words for axis in range(6) for words in self._missing_of(axis)]

    def _missing_of(self, axis: int) -> list[str]:
        low, high = self.spans[:, axis]
        edges = np.linspace(low, high, BINS + 1)
        scarce = self.counts[axis] <= SCARCE * max(len(self.saved), 1)
        borders = np.flatnonzero(np.diff(np.concatenate([[False], scarce, [False]]).astype(int))).reshape(-1, 2)
        return [f"{AXES[axis]} {edges[one]:.3g} to {edges[other]:.3g} {UNITS[axis]}" for one, other in borders]

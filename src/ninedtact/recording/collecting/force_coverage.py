"""Counts of the saved pairs in bins of each wrench axis, which show the forces that are still missing."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.training_pair_rule import SixFloats
from ninedtact.recording.ros_messages import PairLabel

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
AXIS_UNITS = ("N", "N", "N", "N·mm", "N·mm", "N·mm")
AXIS_SCALES = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])
"""Factors from N and N·m to the units that are displayed."""
_BINS = 12
_SCARCE_FRACTION = 0.02
"""Fraction of the pairs below which a bin counts as missing."""


@dataclass
class PairCounts:
    """All pairs that were saved in this session, undone contacts excluded."""

    ranges: SixFloats
    pairs: list[PairLabel] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)
    objects: Counter[str] = field(default_factory=Counter)
    counts: Array = field(default_factory=lambda: np.zeros((6, _BINS), int))
    """Pairs in each of the twelve bins of each axis; values beyond the range count in the last bin."""

    def add(self, pair: PairLabel) -> None:
        """Count one more saved pair."""
        self.pairs.append(pair)
        self._count(pair, +1)

    def undo(self, contact: str) -> int:
        """Remove the pairs of a contact and return their number."""
        undone = [pair for pair in self.pairs if pair.contact == contact]
        self.pairs = [pair for pair in self.pairs if pair.contact != contact]
        for pair in undone:
            self._count(pair, -1)
        return len(undone)

    def _count(self, pair: PairLabel, by: int) -> None:
        self.kinds[pair.kind] += by
        self.objects[pair.object] += by
        low, high = self.limits
        bins = ((pair.wrench.six - low) / (high - low) * _BINS).astype(int).clip(0, _BINS - 1)
        self.counts[np.arange(6), bins] += by

    @property
    def limits(self) -> Float64[Array, "2 6"]:
        """Lower and upper limit of each axis, N and N·m: symmetric about zero, F_z from zero inwards."""
        widths = np.array(self.ranges)
        low = -widths / 2
        low[2] = -widths[2]
        return np.array([low, low + widths])

    @property
    def last_contact(self) -> str | None:
        """The newest contact that has pairs."""
        return next((pair.contact for pair in reversed(self.pairs) if pair.kind != "no_contact"), None)

    def missing_ranges(self) -> list[str]:
        """Return the ranges that hold hardly any pairs, as text."""
        return [text for axis in range(6) for text in self._missing_ranges_of(axis)]

    def _missing_ranges_of(self, axis: int) -> list[str]:
        low, high = self.limits[:, axis] * AXIS_SCALES[axis]
        edges = np.linspace(low, high, _BINS + 1)
        scarce = self.counts[axis] <= _SCARCE_FRACTION * max(len(self.pairs), 1)
        borders = np.flatnonzero(np.diff(np.concatenate([[False], scarce, [False]]).astype(int))).reshape(-1, 2)
        return [f"{AXES[axis]} {edges[one]:.3g} to {edges[other]:.3g} {AXIS_UNITS[axis]}" for one, other in borders]

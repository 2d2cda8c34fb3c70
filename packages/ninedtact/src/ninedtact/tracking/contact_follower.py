"""The contacts of a stream, each with the same number from image to image."""

from dataclasses import dataclass, field, replace

import numpy as np

from ninedtact.shape.contacts import ContactPatch

_REACH_MM = 1.0
"""Distance that a contact may move from one image to the next, beyond its own radius."""


@dataclass
class ContactFollower:
    """Numbers the contacts of a stream so that one keeps its number while it is near where it was in the image before."""

    _last: tuple[ContactPatch, ...] = field(default=(), init=False, repr=False)
    _newest: int = field(default=0, init=False, repr=False)

    def update(self, found: tuple[ContactPatch, ...]) -> tuple[ContactPatch, ...]:
        """Return the contacts of the next image with their numbers."""
        pairs = sorted(
            (float(np.linalg.norm(now.centre_mm - before.centre_mm)), new, old)
            for new, now in enumerate(found)
            for old, before in enumerate(self._last)
        )
        numbers = dict[int, int]()
        taken = set[int]()
        for distance, new, old in pairs:
            reach = _REACH_MM + float(np.sqrt(max(found[new].area_mm2, self._last[old].area_mm2) / np.pi))
            if new not in numbers and old not in taken and distance < reach:
                numbers[new] = self._last[old].number
                taken.add(old)
        numbered = []
        for new, contact in enumerate(found):
            if new not in numbers:
                self._newest += 1
                numbers[new] = self._newest
            numbered.append(replace(contact, number=numbers[new]))
        self._last = tuple(numbered)
        return self._last

"""Relaxation of the gel: the load of an object that is held at a depth falls, and an object under a held load sinks in.

Silicone is linearly viscoelastic, and gel and base are taken to relax alike. As long as a contact does not shrink, its load is
then that of the elastic contact at the same depth, convolved with the relaxation of the modulus (Lee and Radok 1960,
docs/references.md), so that one number for each term of the Prony series is all that the gel remembers of a contact. All tractions
are reduced in the proportion of the load, which is exact for an object that is held and keeps Coulomb's law. The skin stays where
the object holds it, so that relaxation does not show in an image. What leaves the skin is forgotten; dents that fill slowly are not
modelled.
"""

from dataclasses import dataclass, replace

import numpy as np

from ninedtact.design import Gel
from ninedtact.mechanics.contact_result import Contact

_LEAST_LEFT = 0.01
"""Part of the tractions that is left at least: an object that is lifted faster than the gel comes back still touches it."""


@dataclass(frozen=True)
class GelMemory:
    """What the gel remembers of one contact."""

    gel: Gel
    remembered_n: tuple[float, ...]
    """For each term of the gel's Prony series, the elastic load as it was, averaged over about the term's time."""

    @classmethod
    def of_new_contact(cls, gel: Gel) -> "GelMemory":
        """Return the memory of a contact that begins now."""
        return cls(gel, (0.0,) * len(gel.relaxing_shares))

    def after(self, seconds: float, elastic_n: float) -> "GelMemory":
        """Return the memory after some time in which the elastic load was this."""
        kept = self._kept(seconds)
        return GelMemory(self.gel, tuple((kept * np.array(self.remembered_n) + (1 - kept) * elastic_n).tolist()))

    def left_of(self, elastic_n: float) -> float:
        """Return the part of an elastic load that is left now, 0.01 to 1."""
        return (
            max(1 - float(self._shares @ np.array(self.remembered_n)) / elastic_n, _LEAST_LEFT)
            if elastic_n > 0
            else 1.0
        )

    def elastic_load_n(self, load_n: float, after_s: float) -> float:
        """Return the elastic load of which this load is left after some time."""
        kept = self._kept(after_s)
        still_n = float(self._shares @ (kept * np.array(self.remembered_n)))
        return (load_n + still_n) / (1 - float(self._shares @ (1 - kept)))

    @property
    def _shares(self) -> np.ndarray:
        return np.array(self.gel.relaxing_shares)

    def _kept(self, seconds: float) -> np.ndarray:
        """Return the part of each term's memory that is left after some time."""
        return np.exp(-seconds / np.array(self.gel.relaxation_times_s))


def relax_tractions(contact: Contact, left: float) -> Contact:
    """Return a single contact with this part of its tractions left, and the skin where it was."""
    return replace(contact, pressure_mpa=left * contact.pressure_mpa, shear_mpa=left * contact.shear_mpa, left=left)

"""Normal contacts of which some are held by their load and others by their depth."""

from dataclasses import dataclass
from typing import Any

from ninedtact.mechanics.halving import Chosen, some
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.normal import Held
from ninedtact.mechanics.per_contact import PerContact, Which, positive, total
from ninedtact.mechanics.response import Field, Points


@dataclass(frozen=True)
class HeldEach(Held):
    """As `HeldLoad` where the load is held, as `HeldDepth` where not."""

    total_mpa: PerContact
    """Sum of the pressure over the grid, where the load is held."""
    by_load: Which
    window: Field
    """One where a contact may be, zero elsewhere."""

    def level_mm(self, gap_mm: Field, points: Points) -> Any:
        """Their mean, or the object."""
        level = total(gap_mm * points) / positive(total(points))
        return library_of(gap_mm).where(self.by_load, level, 0.0)

    def loaded(self, pressure_mpa: Field) -> Field:
        """Scaled, the same everywhere in the window where there was none; or as it is."""
        pressed = pressure_mpa + self.window * (total(pressure_mpa) <= 0)
        return library_of(pressed).where(self.by_load, pressed * (self.total_mpa / total(pressed)), pressure_mpa)

    def of(self, chosen: Chosen) -> "HeldEach":
        """The chosen contacts of the batch."""
        return HeldEach(some(self.total_mpa, chosen), some(self.by_load, chosen), some(self.window, chosen))

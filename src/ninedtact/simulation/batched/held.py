"""Normal contacts of which some are held by their load and others by their depth."""

from dataclasses import dataclass
from typing import Any

from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.mechanics.batching import (
    ContactFlags,
    ContactIndices,
    PerContact,
    nonzero_divisor,
    sum_over_grid,
    take_contacts,
)
from ninedtact.mechanics.normal_contact import ContactConstraint
from ninedtact.mechanics.skin import PointMask, ScalarField


@dataclass(frozen=True)
class HeldEach(ContactConstraint):
    """As `HeldLoad` where the load is held, as `HeldDepth` where not."""

    total_mpa: PerContact
    """Sum of the pressure over the grid, where the load is held."""
    by_load: ContactFlags
    window: ScalarField
    """One where a contact may be, zero elsewhere."""

    def level_mm(self, gap_mm: ScalarField, points: PointMask) -> Any:
        """Their mean, or the object."""
        level = sum_over_grid(gap_mm * points) / nonzero_divisor(sum_over_grid(points))
        return array_namespace_of(gap_mm).where(self.by_load, level, 0.0)

    def loaded(self, pressure_mpa: ScalarField) -> ScalarField:
        """Scaled, the same everywhere in the window where there was none; or as it is."""
        pressed = pressure_mpa + self.window * (sum_over_grid(pressure_mpa) <= 0)
        return array_namespace_of(pressed).where(
            self.by_load, pressed * (self.total_mpa / sum_over_grid(pressed)), pressure_mpa
        )

    def of(self, chosen: ContactIndices) -> "HeldEach":
        """The chosen contacts of the batch."""
        return HeldEach(
            take_contacts(self.total_mpa, chosen),
            take_contacts(self.by_load, chosen),
            take_contacts(self.window, chosen),
        )

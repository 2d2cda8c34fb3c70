"""Normal contact: where the object touches and how hard it presses there.

The gap between skin and object is never negative, the pressure is never negative, and only one of the two differs from
zero anywhere. Conjugate gradients on the pressed points, with projection (Polonsky and Keer 1999, docs/references.md).
Either the object's depth is held, or its load: then the depth is the one at which the mean gap under pressure is zero.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from ninedtact.mechanics.halving import Chosen, half_of, put, some
from ninedtact.mechanics.per_contact import PerContact, Which, largest, positive, total
from ninedtact.mechanics.response import Field, Points, Response


@dataclass(frozen=True)
class Pressed:
    """Skin under pressure, and how well it fits the object."""

    pressure_mpa: Field
    sunk_mm: Field
    """Inward displacement by the pressure."""
    deeper_mm: PerContact
    """By how much the object is deeper than its overlap says; zero where the depth is held."""
    residual_mm: PerContact
    """The largest gap under pressure, or the largest overlap without."""
    disturbed_mm: PerContact
    """The same of the first guess."""
    iterations: PerContact


class Held(ABC):
    """What is held while the pressure is sought."""

    @abstractmethod
    def level_mm(self, gap_mm: Field, points: Points) -> Any:
        """What every gap is measured from, given the points that count."""

    @abstractmethod
    def loaded(self, pressure_mpa: Field) -> Field:
        """The pressure with the load it must have."""

    @abstractmethod
    def of(self, chosen: Chosen) -> "Held":
        """The same for the chosen contacts of a batch."""


@dataclass(frozen=True)
class HeldDepth(Held):
    """The object stays where it is; the load is what it turns out to be."""

    def level_mm(self, gap_mm: Field, points: Points) -> Any:
        """The object."""
        return 0.0

    def loaded(self, pressure_mpa: Field) -> Field:
        """As it is."""
        return pressure_mpa

    def of(self, chosen: Chosen) -> "HeldDepth":
        """All alike."""
        return self


@dataclass(frozen=True)
class HeldLoad(Held):
    """The object sinks in until the pressure adds up."""

    total_mpa: Any
    """Sum of the pressure over the grid, which is the load over the area of a cell; a number, or one per contact."""

    def level_mm(self, gap_mm: Field, points: Points) -> Any:
        """Their mean."""
        return total(gap_mm * points) / positive(total(points))

    def loaded(self, pressure_mpa: Field) -> Field:
        """Scaled; the same everywhere where there was none."""
        pressed = pressure_mpa + (total(pressure_mpa) <= 0)
        return pressed * (self.total_mpa / total(pressed))

    def of(self, chosen: Chosen) -> "HeldLoad":
        """Their loads."""
        return HeldLoad(some(self.total_mpa, chosen))


@dataclass(frozen=True)
class Search:
    """Where the search for the pressure has come to."""

    pressure_mpa: Field
    gap_mm: Field
    """Between skin and object, from the level that is held."""
    deeper_mm: Any
    direction: Field
    """In which the pressure was changed last."""
    square: PerContact
    """Of the miss that led there."""
    active: Points
    """What could change then."""

    @cached_property
    def pressed(self) -> Points:
        """Where there is pressure."""
        return self.pressure_mpa > 0

    def of(self, chosen: Chosen) -> "Search":
        """That of the chosen contacts of a batch."""
        return Search(**{name.name: some(getattr(self, name.name), chosen) for name in fields(self)})

    def after(self, chosen: Chosen, part: "Search") -> "Search":
        """That of all contacts, after some were searched on."""
        pressure, gap = put(self.pressure_mpa, chosen, part.pressure_mpa), put(self.gap_mm, chosen, part.gap_mm)
        deeper = put(self.deeper_mm + 0 * self.square, chosen, part.deeper_mm)
        return Search(pressure, gap, deeper, self.direction, self.square, self.active)


@dataclass(frozen=True)
class Fit:
    """What the search is for."""

    response: Response
    held: Held
    overlap_mm: Field
    tolerance_mm: PerContact

    def of(self, chosen: Chosen) -> "Fit":
        """For the chosen contacts of a batch."""
        overlap, tolerance = some(self.overlap_mm, chosen), some(self.tolerance_mm, chosen)
        return Fit(self.response.of(chosen), self.held.of(chosen), overlap, tolerance)


def press(
    response: Response, held: Held, overlap_mm: Field, start: Pressed, tolerance_mm: PerContact, most_iterations: int
) -> Pressed:
    """Find the pressure under an object.

    overlap_mm: how far the object reaches into the skin as it would be without this pressure, negative where it stands
    clear. start: a first guess that has the load, best from the step before; it is kept where it is good to the tolerance,
    else improved to half of it. Stops at `most_iterations` without complaint: the residual tells.
    """
    none, raw = 0 * tolerance_mm, start.sunk_mm - overlap_mm
    first = Search(start.pressure_mpa, raw, none, 0 * raw, none, raw != raw)
    search = levelled(first, held)
    residual = disturbed = misfit(search)
    fit, going = Fit(response, held, overlap_mm, tolerance_mm), disturbed > tolerance_mm
    search, residual, iterations = searched(fit, search, residual, going, most_iterations)
    sunk = search.gap_mm + (overlap_mm + search.deeper_mm)
    return Pressed(search.pressure_mpa, sunk, search.deeper_mm + none, residual, disturbed, iterations)


def searched(
    fit: Fit, search: Search, residual: PerContact, going: Which, left: int
) -> tuple[Search, PerContact, PerContact]:
    """Improved to half the tolerance, with its residual and iterations; half a batch by itself when the other half is done.

    left: iterations, at most.
    """
    iterations = 0 * fit.tolerance_mm
    while bool(going.any()) and left:
        if (half := half_of(going)) is not None:
            picked = fit.of(half), search.of(half), some(residual, half), some(going, half)
            part, rest, more = searched(*picked, left)
            return search.after(half, part), put(residual, half, rest), iterations + put(0 * iterations, half, more)
        search = levelled(improved(search, fit.response, fit.held, fit.overlap_mm, going), fit.held)
        residual = misfit(search)
        left, iterations = left - 1, iterations + going
        going = going & (residual > fit.tolerance_mm / 2)
    return search, residual, iterations


def improved(last: Search, response: Response, held: Held, overlap_mm: Field, going: Which) -> Search:
    """One conjugate step for the contacts still going; where it pulls at the skin, the pressure is cut off at zero."""
    xp, gap = response.xp, last.gap_mm
    active = last.pressed | (gap < 0)
    miss = xp.where(active, gap - held.level_mm(gap, active), 0.0)
    square = total(miss * miss)
    conjugate = xp.all(active == last.active, axis=(-2, -1), keepdims=True)
    direction = miss + conjugate * square / positive(last.square) * last.direction
    answer = response.sunk_mm(direction)
    stride = going * total(miss * direction) / positive(total(direction * answer))
    pressure = last.pressure_mpa - stride * direction
    gap = gap + last.deeper_mm - stride * answer
    if bool((pressure < 0).any()):
        pressure = held.loaded(xp.where(pressure > 0, pressure, 0.0))
        gap = response.sunk_mm(pressure) - overlap_mm
    return Search(pressure, gap, last.deeper_mm, direction, square, active)


def levelled(search: Search, held: Held) -> Search:
    """The same with its gaps from the level held."""
    level = held.level_mm(search.gap_mm, search.pressed)
    gap = search.gap_mm - level
    return Search(search.pressure_mpa, gap, level, search.direction, search.square, search.active)


def misfit(search: Search) -> PerContact:
    """The largest violation of the contact's conditions, mm."""
    # Under pressure a gap of either sign counts, elsewhere an overlap alone.
    return largest(abs(search.gap_mm) * search.pressed - search.gap_mm * ~search.pressed)

"""Normal contact: where the object touches and how hard it presses there.

The gap between skin and object is never negative, the pressure is never negative, and only one of the two differs from
zero anywhere. Conjugate gradients on the pressed points, with projection (Polonsky and Keer 1999, docs/references.md).
Either the object's depth is held, or its load: then the depth is the one at which the mean gap under pressure is zero.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from ninedtact.mechanics.batching import (
    ContactFlags,
    ContactIndices,
    PerContact,
    max_over_grid,
    nonzero_divisor,
    put_contacts,
    sum_over_grid,
    take_contacts,
    unconverged_half,
)
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField


@dataclass(frozen=True)
class PressureSolution:
    """Skin under pressure, and how well it fits the object."""

    pressure_mpa: ScalarField
    sunk_mm: ScalarField
    """Inward displacement by the pressure."""
    deeper_mm: PerContact
    """By how much the object is deeper than its overlap says; zero where the depth is held."""
    residual_mm: PerContact
    """The largest gap under pressure, or the largest overlap without."""
    disturbed_mm: PerContact
    """The same of the first guess."""
    iterations: PerContact


class ContactConstraint(ABC):
    """What is held while the pressure is sought."""

    @abstractmethod
    def level_mm(self, gap_mm: ScalarField, points: PointMask) -> Any:
        """What every gap is measured from, given the points that count."""

    @abstractmethod
    def loaded(self, pressure_mpa: ScalarField) -> ScalarField:
        """The pressure with the load it must have."""

    @abstractmethod
    def of(self, chosen: ContactIndices) -> "ContactConstraint":
        """The same for the chosen contacts of a batch."""


@dataclass(frozen=True)
class DepthConstraint(ContactConstraint):
    """The object stays where it is; the load is what it turns out to be."""

    def level_mm(self, gap_mm: ScalarField, points: PointMask) -> Any:
        """The object."""
        return 0.0

    def loaded(self, pressure_mpa: ScalarField) -> ScalarField:
        """As it is."""
        return pressure_mpa

    def of(self, chosen: ContactIndices) -> "DepthConstraint":
        """All alike."""
        return self


@dataclass(frozen=True)
class LoadConstraint(ContactConstraint):
    """The object sinks in until the pressure adds up."""

    total_mpa: Any
    """Sum of the pressure over the grid, which is the load over the area of a cell; a number, or one per contact."""

    def level_mm(self, gap_mm: ScalarField, points: PointMask) -> Any:
        """Their mean."""
        return sum_over_grid(gap_mm * points) / nonzero_divisor(sum_over_grid(points))

    def loaded(self, pressure_mpa: ScalarField) -> ScalarField:
        """Scaled; the same everywhere where there was none."""
        pressed = pressure_mpa + (sum_over_grid(pressure_mpa) <= 0)
        return pressed * (self.total_mpa / sum_over_grid(pressed))

    def of(self, chosen: ContactIndices) -> "LoadConstraint":
        """Their loads."""
        return LoadConstraint(take_contacts(self.total_mpa, chosen))


@dataclass(frozen=True)
class _PressureIterate:
    """Where the search for the pressure has come to."""

    pressure_mpa: ScalarField
    gap_mm: ScalarField
    """Between skin and object, from the level that is held."""
    deeper_mm: Any
    direction: ScalarField
    """In which the pressure was changed last."""
    square: PerContact
    """Of the miss that led there."""
    active: PointMask
    """What could change then."""

    @cached_property
    def pressed(self) -> PointMask:
        """Where there is pressure."""
        return self.pressure_mpa > 0

    def of(self, chosen: ContactIndices) -> "_PressureIterate":
        """That of the chosen contacts of a batch."""
        return _PressureIterate(**{name.name: take_contacts(getattr(self, name.name), chosen) for name in fields(self)})

    def after(self, chosen: ContactIndices, part: "_PressureIterate") -> "_PressureIterate":
        """That of all contacts, after some were searched on."""
        pressure, gap = (
            put_contacts(self.pressure_mpa, chosen, part.pressure_mpa),
            put_contacts(self.gap_mm, chosen, part.gap_mm),
        )
        deeper = put_contacts(self.deeper_mm + 0 * self.square, chosen, part.deeper_mm)
        return _PressureIterate(pressure, gap, deeper, self.direction, self.square, self.active)


@dataclass(frozen=True)
class _PressureProblem:
    """What the search is for."""

    response: DisplacementOperators
    held: ContactConstraint
    overlap_mm: ScalarField
    tolerance_mm: PerContact

    def of(self, chosen: ContactIndices) -> "_PressureProblem":
        """For the chosen contacts of a batch."""
        overlap, tolerance = take_contacts(self.overlap_mm, chosen), take_contacts(self.tolerance_mm, chosen)
        return _PressureProblem(self.response.of(chosen), self.held.of(chosen), overlap, tolerance)


def solve_pressure(
    response: DisplacementOperators,
    held: ContactConstraint,
    overlap_mm: ScalarField,
    start: PressureSolution,
    tolerance_mm: PerContact,
    most_iterations: int,
) -> PressureSolution:
    """Find the pressure under an object.

    overlap_mm: how far the object reaches into the skin as it would be without this pressure, negative where it stands
    clear. start: a first guess that has the load, best from the step before; it is kept where it is good to the tolerance,
    else improved to half of it. Stops at `most_iterations` without complaint: the residual tells.
    """
    none, raw = 0 * tolerance_mm, start.sunk_mm - overlap_mm
    first = _PressureIterate(start.pressure_mpa, raw, none, 0 * raw, none, raw != raw)
    search = _subtract_gap_level(first, held)
    residual = disturbed = _contact_violation_mm(search)
    fit, going = _PressureProblem(response, held, overlap_mm, tolerance_mm), disturbed > tolerance_mm
    search, residual, iterations = _iterate_pressure(fit, search, residual, going, most_iterations)
    sunk = search.gap_mm + (overlap_mm + search.deeper_mm)
    return PressureSolution(search.pressure_mpa, sunk, search.deeper_mm + none, residual, disturbed, iterations)


def _iterate_pressure(
    fit: _PressureProblem, search: _PressureIterate, residual: PerContact, going: ContactFlags, left: int
) -> tuple[_PressureIterate, PerContact, PerContact]:
    """Improved to half the tolerance, with its residual and iterations; half a batch by itself when the other half is done.

    left: iterations, at most.
    """
    iterations = 0 * fit.tolerance_mm
    while bool(going.any()) and left:
        if (half := unconverged_half(going)) is not None:
            picked = fit.of(half), search.of(half), take_contacts(residual, half), take_contacts(going, half)
            part, rest, more = _iterate_pressure(*picked, left)
            return (
                search.after(half, part),
                put_contacts(residual, half, rest),
                iterations + put_contacts(0 * iterations, half, more),
            )
        search = _subtract_gap_level(
            _conjugate_gradient_step(search, fit.response, fit.held, fit.overlap_mm, going), fit.held
        )
        residual = _contact_violation_mm(search)
        left, iterations = left - 1, iterations + going
        going = going & (residual > fit.tolerance_mm / 2)
    return search, residual, iterations


def _conjugate_gradient_step(
    last: _PressureIterate,
    response: DisplacementOperators,
    held: ContactConstraint,
    overlap_mm: ScalarField,
    going: ContactFlags,
) -> _PressureIterate:
    """One conjugate step for the contacts still going; where it pulls at the skin, the pressure is cut off at zero."""
    xp, gap = response.xp, last.gap_mm
    active = last.pressed | (gap < 0)
    miss = xp.where(active, gap - held.level_mm(gap, active), 0.0)
    square = sum_over_grid(miss * miss)
    conjugate = xp.all(active == last.active, axis=(-2, -1), keepdims=True)
    direction = miss + conjugate * square / nonzero_divisor(last.square) * last.direction
    answer = response.sunk_mm(direction)
    stride = going * sum_over_grid(miss * direction) / nonzero_divisor(sum_over_grid(direction * answer))
    pressure = last.pressure_mpa - stride * direction
    gap = gap + last.deeper_mm - stride * answer
    if bool((pressure < 0).any()):
        pressure = held.loaded(xp.where(pressure > 0, pressure, 0.0))
        gap = response.sunk_mm(pressure) - overlap_mm
    return _PressureIterate(pressure, gap, last.deeper_mm, direction, square, active)


def _subtract_gap_level(search: _PressureIterate, held: ContactConstraint) -> _PressureIterate:
    """The same with its gaps from the level held."""
    level = held.level_mm(search.gap_mm, search.pressed)
    gap = search.gap_mm - level
    return _PressureIterate(search.pressure_mpa, gap, level, search.direction, search.square, search.active)


def _contact_violation_mm(search: _PressureIterate) -> PerContact:
    """The largest violation of the contact's conditions, mm."""
    # Under pressure a gap of either sign counts, elsewhere an overlap alone.
    return max_over_grid(abs(search.gap_mm) * search.pressed - search.gap_mm * ~search.pressed)

"""Normal contact: the area in which the object touches the skin, and the pressure there.

The gap between skin and object is never negative, the pressure is never negative, and at every point at least one of the two
is zero. Projected conjugate gradients on the points under pressure solve this problem (Polonsky and Keer 1999,
docs/references.md). Either the depth of the object is given, or its load; with a given load the depth is the one at which the
mean gap under pressure is zero.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from ninedtact.mechanics.numpy_or_torch_arrays import (
    ContactFlags,
    ContactIndices,
    PerContact,
    array_namespace_of,
    half_with_all_unconverged,
    max_over_grid,
    nonzero_divisor,
    put_contacts,
    sum_over_grid,
    take_contacts,
)
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField


@dataclass(frozen=True)
class PressureSolution:
    """The pressure between skin and object, and how well it satisfies the conditions of contact."""

    pressure_mpa: ScalarField
    indentation_mm: ScalarField
    """Inward displacement by the pressure."""
    depth_increase_mm: PerContact
    """Depth of the object beyond the one for which the overlap was computed; zero where the depth is given."""
    residual_mm: PerContact
    """The largest gap under pressure, or the largest overlap without pressure."""
    initial_residual_mm: PerContact
    """The residual of the first guess."""
    iterations: PerContact


@dataclass(frozen=True)
class ContactConstraint:
    """What is given while the pressure is solved: the depth of the object (the default), its load, or either for each contact."""

    pressure_sum_mpa: Any = None
    """Sum of the pressure over the grid, which is the load over the area of a cell: a number, or one per contact. None: all depths
    are given."""
    by_load: ContactFlags | None = None
    """The contacts of a batch whose load is given; the depth of all others is. None: all loads are given."""
    region: Any = True
    """One where contact is possible, zero elsewhere; True: everywhere."""

    def gap_level_mm(self, gap_mm: ScalarField, points: PointMask) -> Any:
        """Return the level from which gaps are measured: the mean gap of these points where the load is given, else zero."""
        if self.pressure_sum_mpa is None:
            return 0.0
        mean = sum_over_grid(gap_mm * points) / nonzero_divisor(sum_over_grid(points))
        return mean if self.by_load is None else array_namespace_of(gap_mm).where(self.by_load, mean, 0.0)

    def scale_to_load(self, pressure_mpa: ScalarField) -> ScalarField:
        """Return the pressure scaled to the given load, uniform where it was zero; unchanged where the depth is given."""
        if self.pressure_sum_mpa is None:
            return pressure_mpa
        positive = pressure_mpa + self.region * (sum_over_grid(pressure_mpa) <= 0)
        scaled = positive * (self.pressure_sum_mpa / sum_over_grid(positive))
        return scaled if self.by_load is None else array_namespace_of(scaled).where(self.by_load, scaled, pressure_mpa)

    def select(self, indices: ContactIndices) -> "ContactConstraint":
        """Return the constraint of these contacts of a batch."""
        return ContactConstraint(*(take_contacts(getattr(self, one.name), indices) for one in fields(self)))


@dataclass(frozen=True)
class _PressureIterate:
    """One iterate of the conjugate gradients."""

    pressure_mpa: ScalarField
    gap_mm: ScalarField
    """The gap between skin and object, from the given level."""
    depth_increase_mm: Any
    direction: ScalarField
    """The last search direction (d)."""
    squared_residual: PerContact
    """Sum of the squared residual (r) of that step."""
    active: PointMask
    """The points that were free to change in that step."""

    @cached_property
    def pressed(self) -> PointMask:
        """The points under pressure."""
        return self.pressure_mpa > 0

    def select(self, indices: ContactIndices) -> "_PressureIterate":
        """Return the iterate of these contacts of a batch."""
        return _PressureIterate(**{one.name: take_contacts(getattr(self, one.name), indices) for one in fields(self)})

    def merge(self, indices: ContactIndices, part: "_PressureIterate") -> "_PressureIterate":
        """Return the iterate of all contacts, with these contacts replaced after they were iterated separately."""
        pressure = put_contacts(self.pressure_mpa, indices, part.pressure_mpa)
        gap = put_contacts(self.gap_mm, indices, part.gap_mm)
        deeper = put_contacts(self.depth_increase_mm + 0 * self.squared_residual, indices, part.depth_increase_mm)
        return _PressureIterate(pressure, gap, deeper, self.direction, self.squared_residual, self.active)


@dataclass(frozen=True)
class _PressureProblem:
    """The given quantities of the normal contact."""

    operators: DisplacementOperators
    constraint: ContactConstraint
    overlap_mm: ScalarField
    tolerance_mm: PerContact

    def select(self, indices: ContactIndices) -> "_PressureProblem":
        """Return the problem of these contacts of a batch."""
        overlap, tolerance = take_contacts(self.overlap_mm, indices), take_contacts(self.tolerance_mm, indices)
        return _PressureProblem(self.operators.select(indices), self.constraint.select(indices), overlap, tolerance)


def solve_pressure(
    operators: DisplacementOperators,
    constraint: ContactConstraint,
    overlap_mm: ScalarField,
    start: PressureSolution,
    tolerance_mm: PerContact,
    max_iterations: int,
) -> PressureSolution:
    """Return the pressure under an object.

    overlap_mm: how far the object reaches into the skin as it would be without this pressure, negative where it stands
    clear. start: a first guess that has the given load, best from the step before. A guess within the tolerance is kept; any other
    is improved to half the tolerance. Stops after `max_iterations` without an error: see the residual.
    """
    none, gap = 0 * tolerance_mm, start.indentation_mm - overlap_mm
    iterate = _subtract_gap_level(
        _PressureIterate(start.pressure_mpa, gap, none, 0 * gap, none, gap != gap), constraint
    )
    residual = initial = _contact_violation_mm(iterate)
    problem = _PressureProblem(operators, constraint, overlap_mm, tolerance_mm)
    iterate, residual, iterations = _iterate_pressure(
        problem, iterate, residual, initial > tolerance_mm, max_iterations
    )
    indentation = iterate.gap_mm + (overlap_mm + iterate.depth_increase_mm)
    deeper = iterate.depth_increase_mm + none
    return PressureSolution(iterate.pressure_mpa, indentation, deeper, residual, initial, iterations)


def _iterate_pressure(
    problem: _PressureProblem, iterate: _PressureIterate, residual: PerContact, unconverged: ContactFlags, left: int
) -> tuple[_PressureIterate, PerContact, PerContact]:
    """Return the iterate at half the tolerance, its residual and its iterations, of which there are at most `left`.

    As soon as half of a batch has converged, the other half is iterated separately.
    """
    iterations = 0 * problem.tolerance_mm
    while bool(unconverged.any()) and left:
        if (half := half_with_all_unconverged(unconverged)) is not None:
            selected = (
                problem.select(half),
                iterate.select(half),
                take_contacts(residual, half),
                take_contacts(unconverged, half),
            )
            part, rest, more = _iterate_pressure(*selected, left)
            iterations = iterations + put_contacts(0 * iterations, half, more)
            return iterate.merge(half, part), put_contacts(residual, half, rest), iterations
        iterate = _subtract_gap_level(_conjugate_gradient_step(iterate, problem, unconverged), problem.constraint)
        residual = _contact_violation_mm(iterate)
        left, iterations = left - 1, iterations + unconverged
        unconverged = unconverged & (residual > problem.tolerance_mm / 2)
    return iterate, residual, iterations


def _conjugate_gradient_step(
    last: _PressureIterate, problem: _PressureProblem, unconverged: ContactFlags
) -> _PressureIterate:
    """Return the next iterate of the contacts that have not converged; negative pressure is projected to zero.

    The names correspond to the symbols of Polonsky and Keer: residual (r), search direction (d), its displacement (q = K d), step
    length (α).
    """
    operators, constraint, gap = problem.operators, problem.constraint, last.gap_mm
    xp = operators.xp
    active = last.pressed | (gap < 0)
    residual = xp.where(active, gap - constraint.gap_level_mm(gap, active), 0.0)
    squared_residual = sum_over_grid(residual * residual)
    conjugate = xp.all(active == last.active, axis=(-2, -1), keepdims=True)
    direction = residual + conjugate * squared_residual / nonzero_divisor(last.squared_residual) * last.direction
    displacement = operators.indentation_from_pressure_mm(direction)
    curvature = nonzero_divisor(sum_over_grid(direction * displacement))
    step_length = unconverged * sum_over_grid(residual * direction) / curvature
    pressure = last.pressure_mpa - step_length * direction
    gap = gap + last.depth_increase_mm - step_length * displacement
    if bool((pressure < 0).any()):
        pressure = constraint.scale_to_load(xp.where(pressure > 0, pressure, 0.0))
        gap = operators.indentation_from_pressure_mm(pressure) - problem.overlap_mm
    return _PressureIterate(pressure, gap, last.depth_increase_mm, direction, squared_residual, active)


def _subtract_gap_level(iterate: _PressureIterate, constraint: ContactConstraint) -> _PressureIterate:
    """Return the iterate with its gaps measured from the level that the constraint gives."""
    level = constraint.gap_level_mm(iterate.gap_mm, iterate.pressed)
    gap = iterate.gap_mm - level
    return _PressureIterate(
        iterate.pressure_mpa, gap, level, iterate.direction, iterate.squared_residual, iterate.active
    )


def _contact_violation_mm(iterate: _PressureIterate) -> PerContact:
    """Return the largest violation of the conditions of contact, in mm."""
    # Under pressure a gap of either sign is a violation; elsewhere only an overlap is.
    return max_over_grid(abs(iterate.gap_mm) * iterate.pressed - iterate.gap_mm * ~iterate.pressed)

"""Normal contact: the area in which the object touches the skin, and the pressure there.

The gap between skin and object is never negative, the pressure is never negative, and at every point at least one of the two
is zero. Projected conjugate gradients on the points under pressure solve this problem (Polonsky and Keer 1999,
docs/references.md). Either the depth of the object is given, or its load; with a given load the depth is the one at which the
mean gap under pressure is zero.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ninedtact.mechanics.numpy_or_torch_arrays import (
    ContactFlags,
    PerContact,
    array_namespace_of,
    max_over_grid,
    may_stop_after,
    nonzero_divisor,
    sum_over_grid,
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
        return mean if self.by_load is None else mean * self.by_load

    def scale_to_load(self, pressure_mpa: ScalarField) -> ScalarField:
        """Return the pressure scaled to the given load, uniform where it was zero; unchanged where the depth is given."""
        if self.pressure_sum_mpa is None:
            return pressure_mpa
        positive = pressure_mpa + self.region * (sum_over_grid(pressure_mpa) <= 0)
        scaled = positive * (self.pressure_sum_mpa / sum_over_grid(positive))
        return scaled if self.by_load is None else array_namespace_of(scaled).where(self.by_load, scaled, pressure_mpa)


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


@dataclass(frozen=True)
class _PressureProblem:
    """The given quantities of the normal contact."""

    operators: DisplacementOperators
    constraint: ContactConstraint
    overlap_mm: ScalarField
    tolerance_mm: PerContact


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
    iterations, unconverged = none, initial > tolerance_mm
    for count in range(max_iterations):
        if may_stop_after(count, unconverged) and not bool(unconverged.any()):
            break
        iterate = _subtract_gap_level(_conjugate_gradient_step(iterate, problem, unconverged), constraint)
        residual = _contact_violation_mm(iterate)
        iterations = iterations + unconverged
        unconverged = unconverged & (residual > tolerance_mm / 2)
    indentation = iterate.gap_mm + (overlap_mm + iterate.depth_increase_mm)
    deeper = iterate.depth_increase_mm + none
    return PressureSolution(iterate.pressure_mpa, indentation, deeper, residual, initial, iterations)


def _conjugate_gradient_step(
    last: _PressureIterate, problem: _PressureProblem, unconverged: ContactFlags
) -> _PressureIterate:
    """Return the next iterate of the contacts that have not converged; negative pressure is projected to zero.

    The names correspond to the symbols of Polonsky and Keer: residual (r), search direction (d), its displacement (q = K d), step
    length (α).
    """
    operators, constraint, gap = problem.operators, problem.constraint, last.gap_mm
    active = last.pressed | (gap < 0)
    residual = (gap - constraint.gap_level_mm(gap, active)) * active
    squared_residual = sum_over_grid(residual * residual)
    conjugate = sum_over_grid(active != last.active) == 0
    direction = residual + conjugate * squared_residual / nonzero_divisor(last.squared_residual) * last.direction
    displacement = operators.indentation_from_pressure_mm(direction)
    curvature = nonzero_divisor(sum_over_grid(direction * displacement))
    step_length = unconverged * sum_over_grid(residual * direction) / curvature
    pressure = last.pressure_mpa - step_length * direction
    gap = gap + last.depth_increase_mm - step_length * displacement
    # In a batch some contact nearly always has negative pressure, and to ask would stop a device.
    if pressure.ndim > 2 or bool((pressure < 0).any()):
        pressure = constraint.scale_to_load(pressure * (pressure > 0))
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

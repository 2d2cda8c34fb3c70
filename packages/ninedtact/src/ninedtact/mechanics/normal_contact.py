"""Normal contact: the area in which the object touches the skin, and the pressure there.

The gap between skin and object is never negative, the pressure is never negative, and at every point at least one of the two
is zero. The pressure is the minimum of a convex energy, found as the shear is (`friction`): by projected gradients with the step
lengths of Barzilai and Borwein (docs/references.md). Conjugate gradients (Polonsky and Keer, Wear 231, 1999), which begin again
whenever the contact area changes, took as many steps of twice as many transforms. Either the depth of the object is given, or its
load; with a given load the depth is the one at which the mean gap under pressure is zero.
"""

from collections.abc import Callable
from dataclasses import dataclass
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
    step_length: PerContact
    """Length of the next step (α), from which the next round goes on."""


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
    """One iterate of the projected gradients."""

    pressure_mpa: ScalarField
    gap_mm: ScalarField
    """The gap between skin and object, from the given level: the gradient (g)."""
    depth_increase_mm: PerContact
    step_length: PerContact
    """Length of the next step (α), MPa per mm of gap."""


@dataclass(frozen=True)
class _PressureProblem:
    """The given quantities of the normal contact."""

    operators: DisplacementOperators
    constraint: ContactConstraint
    overlap_mm: ScalarField
    none: PerContact
    """Zero for each contact."""

    def iterate(self, pressure: ScalarField, indentation_mm: ScalarField, step_length: PerContact) -> _PressureIterate:
        """Return the iterate with this pressure, its gaps measured from the level that the constraint gives."""
        gap = indentation_mm - self.overlap_mm
        level = self.none + self.constraint.gap_level_mm(gap, pressure > 0)
        return _PressureIterate(pressure, gap - level, level, step_length)


def solve_pressure(
    operators: DisplacementOperators,
    constraint: ContactConstraint,
    overlap_mm: ScalarField,
    start: PressureSolution,
    tolerance_at: Callable[[PerContact], PerContact],
    max_iterations: int,
) -> PressureSolution:
    """Return the pressure under an object.

    overlap_mm: how far the object reaches into the skin as it would be without this pressure, negative where it stands
    clear. start: a first guess that has the given load, best from the step before. tolerance_at: the residual in mm that counts as
    solved, by the increase of the depth. A guess within the tolerance is kept; any other is improved to half the tolerance. Stops
    after `max_iterations` without an error: see the residual.
    """
    none = 0 * start.depth_increase_mm
    problem = _PressureProblem(operators, constraint, overlap_mm, none)
    iterate = problem.iterate(start.pressure_mpa, start.indentation_mm, start.step_length)
    tolerance_mm = tolerance_at(iterate.depth_increase_mm)
    residual = initial = _contact_violation_mm(iterate)
    iterations, unconverged = none, initial > tolerance_mm
    for count in range(max_iterations):
        if may_stop_after(count, unconverged) and not bool(unconverged.any()):
            break
        iterate = _projected_gradient_step(iterate, problem, unconverged, long=count % 2 == 0)
        residual = _contact_violation_mm(iterate)
        iterations = iterations + unconverged
        unconverged = unconverged & (residual > tolerance_mm / 2)
    indentation = iterate.gap_mm + (overlap_mm + iterate.depth_increase_mm)
    deeper, step_length = iterate.depth_increase_mm, iterate.step_length
    return PressureSolution(iterate.pressure_mpa, indentation, deeper, residual, initial, iterations, step_length)


def _projected_gradient_step(
    last: _PressureIterate, problem: _PressureProblem, unconverged: ContactFlags, long: bool
) -> _PressureIterate:
    """Return the next iterate of the contacts that have not converged; negative pressure is projected to zero.

    The step length (α) alternates between the longer and the shorter one of Barzilai and Borwein: with s the change of the pressure
    and y that of the gap under pressure, α = s·s / s·y (long) or s·y / y·y (short).
    """
    constraint, gap, xp = problem.constraint, last.gap_mm, problem.operators.xp
    active = (last.pressure_mpa > 0) | (gap < 0)
    residual = (gap - constraint.gap_level_mm(gap, active)) * active
    pressure = last.pressure_mpa - (unconverged * last.step_length) * residual
    pressure = constraint.scale_to_load(xp.maximum(pressure, problem.none))
    following = problem.iterate(pressure, problem.operators.indentation_from_pressure_mm(pressure), last.step_length)
    pressure_change, gap_change = pressure - last.pressure_mpa, (following.gap_mm - gap) * active
    curvature = sum_over_grid(pressure_change * gap_change)
    if long:
        ratio = sum_over_grid(pressure_change * pressure_change), curvature
    else:
        ratio = curvature, sum_over_grid(gap_change * gap_change)
    step_length = xp.where(unconverged & (curvature > 0), ratio[0] / nonzero_divisor(ratio[1]), last.step_length)
    return _PressureIterate(pressure, following.gap_mm, following.depth_increase_mm, step_length)


def _contact_violation_mm(iterate: _PressureIterate) -> PerContact:
    """Return the largest violation of the conditions of contact, in mm."""
    # Under pressure a gap of either sign is a violation; elsewhere only an overlap is.
    gap, xp = iterate.gap_mm, array_namespace_of(iterate.gap_mm)
    return max_over_grid(xp.maximum(gap * (iterate.pressure_mpa > 0), -gap))

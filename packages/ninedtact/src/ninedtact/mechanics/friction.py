"""Friction: which points of the contact stick, which slip, and the shear traction at each.

Coulomb's law with memory: where the shear stays below μp a point moves with the object; where it reaches μp it slips
along the shear. Given the pressure, the shear is the minimum of a convex energy over discs |q| ≤ μp (Johnson, Contact
Mechanics, 1985, §7). It is found by projected gradients with the step lengths of Barzilai and Borwein (Birgin, Martínez and Raydan
2000). Conjugate gradients, which lose their memory whenever a point begins or ceases to slip, took ten times as many iterations.
"""

from dataclasses import dataclass
from functools import cached_property

from ninedtact.mechanics.numpy_or_torch_arrays import (
    ContactFlags,
    PerContact,
    array_namespace_of,
    may_stop_after,
    nonzero_divisor,
)
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField, VectorField

_SLIP_FROM = 0.99999
"""Fraction of μp from which a point counts as slipping."""
_ROUNDING_MARGIN = 1.00003
"""A squared shear above this many times the squared limit exceeds it by more than rounding."""
_SMALLEST_MPA = 1e-30
"""Added to divisors that may be zero."""


@dataclass(frozen=True)
class ShearSolution:
    """The shear between skin and object, and how well the skin follows the object."""

    shear_mpa: VectorField
    displacement_mm: VectorField
    """Tangential displacement by the shear."""
    residual_mm: PerContact
    """The largest distance by which a sticking point misses where the object carried it, or by which a slipping point
    slips other than along its shear."""
    initial_residual_mm: PerContact
    """The residual of the first guess."""
    iterations: PerContact
    step_length: PerContact
    """Length of the next step (α), from which the next round goes on, (…, 1, 1, 1)."""


@dataclass(frozen=True)
class FrictionLimit:
    """The largest shear that friction can hold: μp, which is zero where there is no pressure."""

    max_shear_mpa: ScalarField

    @cached_property
    def pressed(self) -> ScalarField:
        """One under pressure, zero elsewhere."""
        return self.max_shear_mpa * 0 + (self.max_shear_mpa > 0)

    @cached_property
    def squared_limit(self) -> ScalarField:
        """The squared shear from which a point slips."""
        return (_SLIP_FROM * self.max_shear_mpa) ** 2

    def is_exceeded_by(self, shear: VectorField) -> bool:
        """Return whether some shear is more than friction can hold, by more than rounding."""
        return bool((_squared_length(shear) > self.squared_limit * _ROUNDING_MARGIN).any())

    def project(self, shear: VectorField) -> VectorField:
        """Return each shear vector shortened to what friction can hold."""
        xp = array_namespace_of(shear)
        length = xp.sqrt(_squared_length(shear))
        factor = self.max_shear_mpa / xp.maximum(length, self.max_shear_mpa + _SMALLEST_MPA)
        return shear * factor[..., None, :, :]

    def residual_mm(self, miss: VectorField, shear: VectorField) -> PerContact:
        """Return the largest component of the misses that a change of shear may still reduce, in mm.

        At the limit a miss that pulls the shear outward cannot be followed; what remains is the part across the shear.
        """
        outward, squared_shear = _dot_at_each_point(miss, shear), _squared_length(shear)
        slips = (squared_shear >= self.squared_limit) & (outward < 0)
        radial = slips * outward / (squared_shear + _SMALLEST_MPA)
        missed = abs((miss - radial[..., None, :, :] * shear) * self.pressed[..., None, :, :])
        return array_namespace_of(miss).max(missed, axis=(-3, -2, -1), keepdims=True)[..., 0, :, :]


def slip_mask(shear: VectorField, max_shear: ScalarField) -> PointMask:
    """Return the points where the shear has reached the limit of friction."""
    return _squared_length(shear) >= FrictionLimit(max_shear).squared_limit


@dataclass(frozen=True)
class _ShearIterate:
    """One iterate of the projected gradients."""

    shear_mpa: VectorField
    miss_mm: VectorField
    """The displacement by the shear minus the displacement by which the object carries the skin: the gradient (g)."""
    step_length: PerContact
    """Length of the next step (α), MPa per mm of miss, (…, 1, 1, 1)."""


@dataclass(frozen=True)
class _ShearProblem:
    """The given quantities of the frictional contact."""

    operators: DisplacementOperators
    target_mm: VectorField
    limit: FrictionLimit
    tolerance_mm: PerContact


def solve_shear(
    operators: DisplacementOperators,
    target_mm: VectorField,
    limit: FrictionLimit,
    start: ShearSolution,
    tolerance_mm: PerContact,
    max_iterations: int,
) -> ShearSolution:
    """Return the shear that carries the skin's points to where the object takes them, as far as friction can hold.

    target_mm: wanted displacement by shear alone. start: a first guess; it is kept where it is within the tolerance, else
    improved to half the tolerance. Stops after `max_iterations` without an error: see the residual.
    """
    problem = _ShearProblem(operators, target_mm, limit, tolerance_mm)
    iterate = _first_iterate(problem, start)
    residual = initial = limit.residual_mm(iterate.miss_mm, iterate.shear_mpa)
    iterations, unconverged = 0 * tolerance_mm, initial > tolerance_mm
    for count in range(max_iterations):
        if may_stop_after(count, unconverged) and not bool(unconverged.any()):
            break
        iterate = _projected_gradient_step(iterate, problem, unconverged[..., None, :, :], long=count % 2 == 0)
        residual = limit.residual_mm(iterate.miss_mm, iterate.shear_mpa)
        iterations = iterations + unconverged
        unconverged = unconverged & (residual > tolerance_mm / 2)
    displacement = iterate.miss_mm + target_mm
    return ShearSolution(iterate.shear_mpa, displacement, residual, initial, iterations, iterate.step_length)


def _first_iterate(problem: _ShearProblem, start: ShearSolution) -> _ShearIterate:
    """Return the first guess, limited to what friction can hold."""
    shear, displacement = start.shear_mpa, start.displacement_mm
    if shear.ndim > 3 or problem.limit.is_exceeded_by(shear):  # to ask of a batch would stop a device
        shear = problem.limit.project(shear)
        displacement = problem.operators.tangential_from_shear_mm(shear)
    return _ShearIterate(shear, displacement - problem.target_mm, start.step_length)


def _projected_gradient_step(
    last: _ShearIterate, problem: _ShearProblem, unconverged: ContactFlags, long: bool
) -> _ShearIterate:
    """Return the next iterate; its step length (α) alternates between the longer and the shorter one of Barzilai and Borwein.

    With s the change of the shear and y that of the miss, α = s·s / s·y (long) or s·y / y·y (short).
    """
    operators = problem.operators
    shear = problem.limit.project(last.shear_mpa - unconverged * last.step_length * last.miss_mm)
    miss = operators.tangential_from_shear_mm(shear) - problem.target_mm
    shear_change, miss_change = shear - last.shear_mpa, miss - last.miss_mm
    curvature = _inner_product(shear_change, miss_change)
    if long:
        ratio = _inner_product(shear_change, shear_change), curvature
    else:
        ratio = curvature, _inner_product(miss_change, miss_change)
    step_length = operators.xp.where(
        unconverged & (curvature > 0), ratio[0] / nonzero_divisor(ratio[1]), last.step_length
    )
    return _ShearIterate(shear, miss, step_length)


def _dot_at_each_point(one: VectorField, other: VectorField) -> ScalarField:
    return one[..., 0, :, :] * other[..., 0, :, :] + one[..., 1, :, :] * other[..., 1, :, :]


def _squared_length(vectors: VectorField) -> ScalarField:
    return _dot_at_each_point(vectors, vectors)


def _inner_product(one: VectorField, other: VectorField) -> PerContact:
    """Return the sum of products over grid and components, (…, 1, 1, 1)."""
    return (one * other).sum(axis=(-3, -2, -1), keepdims=True)

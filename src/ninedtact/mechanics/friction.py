"""Friction: which points of the contact stick, which slip, and what shear each carries.

Coulomb's law with memory: where the shear stays below μp a point moves with the object; where it reaches μp it slips
along the shear. Given the pressure, the shear is the minimum of a convex energy over discs |q| ≤ μp (Johnson, Contact
Mechanics, 1985, §7). Found by projected gradients with Barzilai and Borwein's strides (Birgin, Martínez and Raydan 2000):
conjugate gradients, which lose their memory whenever a point begins or ceases to slip, took ten times as many.
"""

from dataclasses import dataclass
from functools import cached_property

from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.mechanics.batching import (
    ContactFlags,
    ContactIndices,
    PerContact,
    nonzero_divisor,
    put_contacts,
    take_contacts,
    unconverged_half,
)
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField, VectorField

_SLIP_FROM = 0.99999
"""Of μp, from which a point counts as slipping."""
_ROUNDING_MARGIN = 1.00003
"""Times that limit's square, a shear is surely beyond it, whatever rounding did."""
_SMALLEST_MPA = 1e-30
"""So that nothing is divided by zero."""


@dataclass(frozen=True)
class ShearSolution:
    """Skin under shear, and how well it follows the object."""

    shear_mpa: VectorField
    slid_mm: VectorField
    """Tangential displacement by the shear."""
    residual_mm: PerContact
    """The largest distance by which a sticking point misses where the object carried it, or by which a slipping point
    slips other than along its shear."""
    disturbed_mm: PerContact
    """The same of the first guess."""
    iterations: PerContact


@dataclass(frozen=True)
class FrictionLimit:
    """What friction can hold: shear up to μp, and none where there is no pressure."""

    most_mpa: ScalarField

    def of(self, chosen: ContactIndices) -> "FrictionLimit":
        """On the chosen contacts of a batch."""
        return FrictionLimit(take_contacts(self.most_mpa, chosen))

    @cached_property
    def touched(self) -> ScalarField:
        """One under pressure, zero elsewhere."""
        return self.most_mpa * 0 + (self.most_mpa > 0)

    @cached_property
    def limit(self) -> ScalarField:
        """Square from which a shear slips."""
        return (_SLIP_FROM * self.most_mpa) ** 2

    def exceeded(self, shear: VectorField) -> bool:
        """Whether some shear is more than friction holds, by more than rounding."""
        return bool((_squared_length(shear) > self.limit * _ROUNDING_MARGIN).any())

    def capped(self, shear: VectorField) -> VectorField:
        """Each shear vector shortened to what friction can hold."""
        xp = array_namespace_of(shear)
        length = xp.sqrt(_squared_length(shear))
        return shear * (self.most_mpa / xp.maximum(length, self.most_mpa + _SMALLEST_MPA))[..., None, :, :]

    def residual_mm(self, miss: VectorField, shear: VectorField) -> PerContact:
        """The longest miss that a change of shear may still reduce, of either component.

        At the limit a miss that pulls the shear outward cannot be followed; what remains is the part across the shear.
        """
        outward, square = _dot_at_each_point(miss, shear), _squared_length(shear)
        slips = (square >= self.limit) & (outward < 0)
        radial = slips * outward / (square + _SMALLEST_MPA)
        return _max_component_over_grid((miss - radial[..., None, :, :] * shear) * self.touched[..., None, :, :])


@dataclass(frozen=True)
class _ShearIterate:
    """Where the search for the shear has come to."""

    shear_mpa: VectorField
    miss_mm: VectorField
    """From where the object carries the skin to where the shear does."""
    stride: PerContact
    """MPa per mm of miss, (…, 1, 1, 1)."""

    def of(self, chosen: ContactIndices) -> "_ShearIterate":
        """That of the chosen contacts of a batch."""
        return _ShearIterate(
            take_contacts(self.shear_mpa, chosen),
            take_contacts(self.miss_mm, chosen),
            take_contacts(self.stride, chosen),
        )

    def after(self, chosen: ContactIndices, part: "_ShearIterate") -> "_ShearIterate":
        """That of all contacts, after some went on."""
        shear, miss = (
            put_contacts(self.shear_mpa, chosen, part.shear_mpa),
            put_contacts(self.miss_mm, chosen, part.miss_mm),
        )
        return _ShearIterate(shear, miss, put_contacts(self.stride, chosen, part.stride))


@dataclass(frozen=True)
class _ShearProblem:
    """What the search is for."""

    response: DisplacementOperators
    target_mm: VectorField
    grip: FrictionLimit
    tolerance_mm: PerContact

    def of(self, chosen: ContactIndices) -> "_ShearProblem":
        """For the chosen contacts of a batch."""
        target, tolerance = take_contacts(self.target_mm, chosen), take_contacts(self.tolerance_mm, chosen)
        return _ShearProblem(self.response.of(chosen), target, self.grip.of(chosen), tolerance)


def solve_shear(
    response: DisplacementOperators,
    target_mm: VectorField,
    grip: FrictionLimit,
    start: ShearSolution,
    tolerance_mm: PerContact,
    most_iterations: int,
) -> ShearSolution:
    """Find the shear that carries the skin's points to where the object takes them, as far as friction holds.

    target_mm: wanted displacement by shear alone. start: a first guess; it is kept where it is good to the tolerance, else
    improved to half of it. Stops at `most_iterations` without complaint: the residual tells.
    """
    at = _first_iterate(response, target_mm, grip, start)
    residual = disturbed = grip.residual_mm(at.miss_mm, at.shear_mpa)
    pull, going = _ShearProblem(response, target_mm, grip, tolerance_mm), disturbed > tolerance_mm
    at, residual, iterations = _iterate_shear(pull, at, residual, going, range(most_iterations))
    return ShearSolution(at.shear_mpa, at.miss_mm + target_mm, residual, disturbed, iterations)


def _iterate_shear(
    pull: _ShearProblem, at: _ShearIterate, residual: PerContact, going: ContactFlags, counts: range
) -> tuple[_ShearIterate, PerContact, PerContact]:
    """Down to half the tolerance, with its residual and iterations; half a batch by itself when the other half is done."""
    iterations = 0 * pull.tolerance_mm
    for count in counts:
        if not bool(going.any()):
            break
        if (half := unconverged_half(going)) is not None:
            picked = pull.of(half), at.of(half), take_contacts(residual, half), take_contacts(going, half)
            part, left, more = _iterate_shear(*picked, range(count, counts.stop))
            return (
                at.after(half, part),
                put_contacts(residual, half, left),
                iterations + put_contacts(0 * iterations, half, more),
            )
        at = _projected_gradient_step(
            at, pull.response, pull.target_mm, pull.grip, going[..., None, :, :], long=count % 2 == 0
        )
        residual = pull.grip.residual_mm(at.miss_mm, at.shear_mpa)
        iterations = iterations + going
        going = going & (residual > pull.tolerance_mm / 2)
    return at, residual, iterations


def _first_iterate(
    response: DisplacementOperators, target_mm: VectorField, grip: FrictionLimit, start: ShearSolution
) -> _ShearIterate:
    """The first guess, as far as friction holds it; the first stride is that of the waves a quarter as soft as the softest."""
    shear, slid = start.shear_mpa, start.slid_mm
    if grip.exceeded(shear):
        shear = grip.capped(shear)
        slid = response.slid_mm(shear)
    return _ShearIterate(shear, slid - target_mm, 4 / response.softest_mm_per_mpa + 0 * slid[..., :1, :1, :1])


def _projected_gradient_step(
    last: _ShearIterate,
    response: DisplacementOperators,
    target_mm: VectorField,
    grip: FrictionLimit,
    going: ContactFlags,
    long: bool,
) -> _ShearIterate:
    """One step down the miss, and the stride for the next: by turns Barzilai and Borwein's longer and shorter one."""
    shear = grip.capped(last.shear_mpa - going * last.stride * last.miss_mm)
    miss = response.slid_mm(shear) - target_mm
    change, answer = shear - last.shear_mpa, miss - last.miss_mm
    curvature = _inner_product(change, answer)
    ratio = (_inner_product(change, change), curvature) if long else (curvature, _inner_product(answer, answer))
    stride = response.xp.where(curvature > 0, ratio[0] / nonzero_divisor(ratio[1]), last.stride)
    return _ShearIterate(shear, miss, stride)


def _dot_at_each_point(one: VectorField, other: VectorField) -> ScalarField:
    """Product of two vectors at each point."""
    return one[..., 0, :, :] * other[..., 0, :, :] + one[..., 1, :, :] * other[..., 1, :, :]


def _squared_length(vectors: VectorField) -> ScalarField:
    """Squared length of each vector."""
    return _dot_at_each_point(vectors, vectors)


def slip_mask(shear: VectorField, most: ScalarField) -> PointMask:
    """Where friction is at its limit."""
    return _squared_length(shear) >= FrictionLimit(most).limit


def _max_component_over_grid(miss: VectorField) -> PerContact:
    """The longest component of all."""
    return array_namespace_of(miss).max(abs(miss), axis=(-3, -2, -1), keepdims=True)[..., 0, :, :]


def _inner_product(one: VectorField, other: VectorField) -> PerContact:
    """Sum of products over grid and components, (…, 1, 1, 1)."""
    return (one * other).sum(axis=(-3, -2, -1), keepdims=True)

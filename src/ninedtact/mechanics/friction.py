"""Friction: which points of the contact stick, which slip, and what shear each carries.

Coulomb's law with memory: where the shear stays below μp a point moves with the object; where it reaches μp it slips
along the shear. Given the pressure, the shear is the minimum of a convex energy over discs |q| ≤ μp (Johnson, Contact
Mechanics, 1985, §7). Found by projected gradients with Barzilai and Borwein's strides (Birgin, Martínez and Raydan 2000):
conjugate gradients, which lose their memory whenever a point begins or ceases to slip, took ten times as many.
"""

from dataclasses import dataclass
from functools import cached_property

from ninedtact.mechanics.halving import Chosen, half_of, put, some
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.per_contact import PerContact, Which, positive
from ninedtact.mechanics.response import Field, Points, Response, Vectors

AT_LIMIT = 0.99999
"""Of μp, from which a point counts as slipping."""
HELD = 1.00003
"""Times that limit's square, a shear is surely beyond it, whatever rounding did."""
LEAST_MPA = 1e-30
"""So that nothing is divided by zero."""


@dataclass(frozen=True)
class Sheared:
    """Skin under shear, and how well it follows the object."""

    shear_mpa: Vectors
    slid_mm: Vectors
    """Tangential displacement by the shear."""
    residual_mm: PerContact
    """The largest distance by which a sticking point misses where the object carried it, or by which a slipping point
    slips other than along its shear."""
    disturbed_mm: PerContact
    """The same of the first guess."""
    iterations: PerContact


@dataclass(frozen=True)
class Grip:
    """What friction can hold: shear up to μp, and none where there is no pressure."""

    most_mpa: Field

    def of(self, chosen: Chosen) -> "Grip":
        """On the chosen contacts of a batch."""
        return Grip(some(self.most_mpa, chosen))

    @cached_property
    def touched(self) -> Field:
        """One under pressure, zero elsewhere."""
        return self.most_mpa * 0 + (self.most_mpa > 0)

    @cached_property
    def limit(self) -> Field:
        """Square from which a shear slips."""
        return (AT_LIMIT * self.most_mpa) ** 2

    def exceeded(self, shear: Vectors) -> bool:
        """Whether some shear is more than friction holds, by more than rounding."""
        return bool((squared(shear) > self.limit * HELD).any())

    def capped(self, shear: Vectors) -> Vectors:
        """Each shear vector shortened to what friction can hold."""
        xp = library_of(shear)
        length = xp.sqrt(squared(shear))
        return shear * (self.most_mpa / xp.maximum(length, self.most_mpa + LEAST_MPA))[..., None, :, :]

    def residual_mm(self, miss: Vectors, shear: Vectors) -> PerContact:
        """The longest miss that a change of shear may still reduce, of either component.

        At the limit a miss that pulls the shear outward cannot be followed; what remains is the part across the shear.
        """
        outward, square = dot(miss, shear), squared(shear)
        slips = (square >= self.limit) & (outward < 0)
        radial = slips * outward / (square + LEAST_MPA)
        return farthest((miss - radial[..., None, :, :] * shear) * self.touched[..., None, :, :])


@dataclass(frozen=True)
class Descent:
    """Where the search for the shear has come to."""

    shear_mpa: Vectors
    miss_mm: Vectors
    """From where the object carries the skin to where the shear does."""
    stride: PerContact
    """MPa per mm of miss, (…, 1, 1, 1)."""

    def of(self, chosen: Chosen) -> "Descent":
        """That of the chosen contacts of a batch."""
        return Descent(some(self.shear_mpa, chosen), some(self.miss_mm, chosen), some(self.stride, chosen))

    def after(self, chosen: Chosen, part: "Descent") -> "Descent":
        """That of all contacts, after some went on."""
        shear, miss = put(self.shear_mpa, chosen, part.shear_mpa), put(self.miss_mm, chosen, part.miss_mm)
        return Descent(shear, miss, put(self.stride, chosen, part.stride))


@dataclass(frozen=True)
class Pull:
    """What the search is for."""

    response: Response
    target_mm: Vectors
    grip: Grip
    tolerance_mm: PerContact

    def of(self, chosen: Chosen) -> "Pull":
        """For the chosen contacts of a batch."""
        target, tolerance = some(self.target_mm, chosen), some(self.tolerance_mm, chosen)
        return Pull(self.response.of(chosen), target, self.grip.of(chosen), tolerance)


def drag(
    response: Response, target_mm: Vectors, grip: Grip, start: Sheared, tolerance_mm: PerContact, most_iterations: int
) -> Sheared:
    """Find the shear that carries the skin's points to where the object takes them, as far as friction holds.

    target_mm: wanted displacement by shear alone. start: a first guess; it is kept where it is good to the tolerance, else
    improved to half of it. Stops at `most_iterations` without complaint: the residual tells.
    """
    at = begun(response, target_mm, grip, start)
    residual = disturbed = grip.residual_mm(at.miss_mm, at.shear_mpa)
    pull, going = Pull(response, target_mm, grip, tolerance_mm), disturbed > tolerance_mm
    at, residual, iterations = brought(pull, at, residual, going, range(most_iterations))
    return Sheared(at.shear_mpa, at.miss_mm + target_mm, residual, disturbed, iterations)


def brought(
    pull: Pull, at: Descent, residual: PerContact, going: Which, counts: range
) -> tuple[Descent, PerContact, PerContact]:
    """Down to half the tolerance, with its residual and iterations; half a batch by itself when the other half is done."""
    iterations = 0 * pull.tolerance_mm
    for count in counts:
        if not bool(going.any()):
            break
        if (half := half_of(going)) is not None:
            picked = pull.of(half), at.of(half), some(residual, half), some(going, half)
            part, left, more = brought(*picked, range(count, counts.stop))
            return at.after(half, part), put(residual, half, left), iterations + put(0 * iterations, half, more)
        at = descended(at, pull.response, pull.target_mm, pull.grip, going[..., None, :, :], long=count % 2 == 0)
        residual = pull.grip.residual_mm(at.miss_mm, at.shear_mpa)
        iterations = iterations + going
        going = going & (residual > pull.tolerance_mm / 2)
    return at, residual, iterations


def begun(response: Response, target_mm: Vectors, grip: Grip, start: Sheared) -> Descent:
    """The first guess, as far as friction holds it; the first stride is that of the waves a quarter as soft as the softest."""
    shear, slid = start.shear_mpa, start.slid_mm
    if grip.exceeded(shear):
        shear = grip.capped(shear)
        slid = response.slid_mm(shear)
    return Descent(shear, slid - target_mm, 4 / response.softest_mm_per_mpa + 0 * slid[..., :1, :1, :1])


def descended(last: Descent, response: Response, target_mm: Vectors, grip: Grip, going: Which, long: bool) -> Descent:
    """One step down the miss, and the stride for the next: by turns Barzilai and Borwein's longer and shorter one."""
    shear = grip.capped(last.shear_mpa - going * last.stride * last.miss_mm)
    miss = response.slid_mm(shear) - target_mm
    change, answer = shear - last.shear_mpa, miss - last.miss_mm
    curvature = inner(change, answer)
    ratio = (inner(change, change), curvature) if long else (curvature, inner(answer, answer))
    stride = response.xp.where(curvature > 0, ratio[0] / positive(ratio[1]), last.stride)
    return Descent(shear, miss, stride)


def dot(one: Vectors, other: Vectors) -> Field:
    """Product of two vectors at each point."""
    return one[..., 0, :, :] * other[..., 0, :, :] + one[..., 1, :, :] * other[..., 1, :, :]


def squared(vectors: Vectors) -> Field:
    """Squared length of each vector."""
    return dot(vectors, vectors)


def slipping(shear: Vectors, most: Field) -> Points:
    """Where friction is at its limit."""
    return squared(shear) >= Grip(most).limit


def farthest(miss: Vectors) -> PerContact:
    """The longest component of all."""
    return library_of(miss).max(abs(miss), axis=(-3, -2, -1), keepdims=True)[..., 0, :, :]


def inner(one: Vectors, other: Vectors) -> PerContact:
    """Sum of products over grid and components, (…, 1, 1, 1)."""
    return (one * other).sum(axis=(-3, -2, -1), keepdims=True)

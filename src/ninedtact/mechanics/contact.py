"""What a touch is: tractions on the skin, where they have moved it, and the wrench they add up to.

Fields travel with the object: the middle of their patch lies over the object's origin. They are read in space: a value at
(x, y) is of the skin that is there now, wherever it came from. (Against finite elements that reading is several times
closer than one by the points' old places: docs/mechanics.md.)

What no contact is solved for: where the answer would be wrong, and nothing would say so.

How far a patch is from a skin without end: what the periodic images of a contact do to its own skin.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.errors import InputError, SimulationError
from ninedtact.mechanics.array_namespace import array_namespace_of, to_numpy
from ninedtact.mechanics.batching import CountPerContact, ScalarPerContact
from ninedtact.mechanics.friction import slip_mask
from ninedtact.mechanics.periodic_grid import PeriodicGrid
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.mechanics.skin import PointMask, ScalarField, Skin, VectorField
from ninedtact.quantities import Wrench


@dataclass(frozen=True)
class Contact:
    """The skin under one object, or under each of a batch, and how well it was solved."""

    skin: Skin
    pose: Pose
    pressure_mpa: ScalarField
    shear_mpa: VectorField
    """(q_x, q_y), what the object applies to the skin."""
    height_mm: ScalarField
    """u_z: negative where pressed in."""
    moved_mm: VectorField
    """(u_x, u_y) of the skin that is there now."""
    friction: float
    residual_mm: ScalarPerContact = 0.0
    """The largest violation of the contact's conditions: gap under pressure, overlap, or missed stick."""
    iterations: CountPerContact = 0
    """Of both solvers, over all turns."""

    @property
    def centre_mm(self) -> tuple[ScalarPerContact, ScalarPerContact]:
        """(x, y) of the sensor over which the middle of the patch lies."""
        return self.pose.x_mm, self.pose.y_mm

    @property
    def touches(self) -> bool:
        """Whether anything is pressed, by any object of a batch."""
        return bool(array_namespace_of(self.pressure_mpa).any(self.pressure_mpa > 0))

    @property
    def stuck(self) -> PointMask:
        """Where the skin moves with the object; what is pressed and not stuck slips."""
        return (self.pressure_mpa > 0) & ~slip_mask(self.shear_mpa, self.friction * self.pressure_mpa)

    def wrench(self, about_mm: Float64[Array, "3"] | None = None) -> Wrench:
        """What the object applies to the skin, summed over the deformed surface; for one contact, not a batch."""
        force, place = self.cell_forces_n, self.surface_mm
        torque = np.cross(place.reshape(3, -1), force.reshape(3, -1), axis=0).sum(axis=1) / 1e3
        wrench = Wrench(force.sum(axis=(1, 2)), torque)
        return wrench if about_mm is None else wrench.about(about_mm)

    def each(self) -> list["Contact"]:
        """The contacts of a batch, one by one."""
        poses = self.pose.each()
        residuals, counts = (np.broadcast_to(of, len(poses)).tolist() for of in (self.residual_mm, self.iterations))
        fields = zip(self.pressure_mpa, self.shear_mpa, self.height_mm, self.moved_mm, strict=True)
        return [
            Contact(self.skin, pose, *four, self.friction, residual, count)
            for pose, four, residual, count in zip(poses, fields, residuals, counts, strict=True)
        ]

    @property
    def cell_forces_n(self) -> Float64[Array, "*batch 3 rows cols"]:
        """Force on every cell."""
        pressure, shear = to_numpy(self.pressure_mpa), to_numpy(self.shear_mpa)
        return np.concatenate([shear, -pressure[..., None, :, :]], axis=-3) * self.skin.patch.cell_mm2

    @property
    def surface_mm(self) -> Float64[Array, "*batch 3 rows cols"]:
        """(x, y, z) of the skin at every point of the grid, in the sensor's frame."""
        height = to_numpy(self.height_mm)[..., None, :, :]
        x, y = (np.asarray(middle, float)[..., None, None] for middle in self.centre_mm)
        across, along = (place + 0 * height[..., 0, :, :] for place in self.skin.patch.place_mm)
        return np.concatenate([np.stack([across + x, along + y], axis=-3), height], axis=-3)


class ContactNotConverged(SimulationError):
    """The solver ran out of iterations before it reached its tolerance."""


class InvalidLoad(InputError):
    """A load under which nothing rests on the skin."""


class ContactLeavesGrid(SimulationError):
    """The contact reaches the patch's border, where it would meet its own image on the other side."""


def require_above_base(deepest_mm: float, thickness_mm: float) -> None:
    """Refuse an object that reaches through the gel, and heights that are no numbers; raises `InvalidPose`."""
    if not deepest_mm < thickness_mm:
        raise InvalidPose(
            f"expected the object less deep in the skin than its base, {thickness_mm:g} mm, got {deepest_mm:g} mm; "
            f"press less, or give the skin its true thickness"
        )


def require_inside_grid(patch: PeriodicGrid, field: ScalarField) -> None:
    """Refuse pressure (or overlap) above zero at the border; raises `ContactLeavesGrid`."""
    xp = array_namespace_of(field)
    borders = {"left": field[..., 0], "right": field[..., -1], "upper": field[..., 0, :], "lower": field[..., -1, :]}
    reached = [name for name, border in borders.items() if bool(xp.any(border > 0))]
    if reached:
        raise ContactLeavesGrid(
            f"expected the contact inside the patch of {patch.width_mm:g} x {patch.height_mm:g} mm, got it at the "
            f"{' and '.join(reached)} border; give the patch a wider margin, or press less deep"
        )


def require_positive_load(load_n: ScalarPerContact) -> None:
    """Refuse a load that does not press; raises `InvalidLoad`."""
    if not np.all((np.asarray(load_n) > 0) & np.isfinite(load_n)):
        raise InvalidLoad(
            f"expected a load above zero, got {load_n} N; press with a force, or lift the object off by its depth"
        )


def require_converged(residual_mm: ScalarPerContact, wanted_mm: ScalarPerContact, iterations: CountPerContact) -> None:
    """Refuse an answer that misses its tolerance; raises `ContactNotConverged`."""
    residuals, wanted, counts = np.broadcast_arrays(np.atleast_1d(residual_mm), wanted_mm, iterations)
    missed = np.flatnonzero(~(residuals <= wanted))
    if len(missed):
        which, many = missed[0], f", {len(missed)} of {len(residuals)} contacts" if len(residuals) > 1 else ""
        raise ContactNotConverged(
            f"expected the contact solved to {wanted[which]:.2g} mm, got {residuals[which]:.2g} mm after {counts[which]} "
            f"iterations{many}; take smaller steps, or allow more rounds"
        )


def periodic_image_error_mm(contact: Contact, times: int = 3) -> Float64[Array, "rows cols"]:
    """By how much the skin under one contact stands higher than the same tractions alone would have it.

    Against a patch `times` (odd) as long and as wide, which has images too, but far away.
    """
    patch = contact.skin.patch
    larger = replace(contact.skin, patch=PeriodicGrid(times * patch.rows, times * patch.cols, patch.pitch_mm))
    around = [(0, 0), *((cells * (times // 2),) * 2 for cells in patch.shape)]
    tractions = np.pad(np.concatenate([to_numpy(contact.pressure_mpa)[None], to_numpy(contact.shear_mpa)]), around)
    alone, _ = larger.response.displaced_mm(larger.asarray(tractions[0]), larger.asarray(tractions[1:]))
    inside = tuple(slice(before, before + cells) for (before, _), cells in zip(around[1:], patch.shape, strict=True))
    return to_numpy(contact.height_mm) - to_numpy(alone)[inside]

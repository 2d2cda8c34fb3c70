"""The solved contact: tractions on the skin, the displacements they cause, and the wrench they add up to; checks that refuse it.

Fields move with the object: the middle of their grid lies over the object's origin. They are Eulerian: a value at (x, y)
belongs to the skin that is there now, wherever it came from. Compared with finite elements, this interpretation is several
times more accurate than one by the points' original positions (docs/mechanics.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Bool, Float, Float64
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.errors import InputError, SimulationError
from ninedtact.mechanics.friction import slip_mask
from ninedtact.mechanics.numpy_or_torch_arrays import (
    CountPerContact,
    PerContact,
    ScalarPerContact,
    array_namespace_of,
    expand_over_grid,
    max_over_grid,
    sum_over_grid,
    to_numpy,
    to_numpy_together,
)
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.mechanics.skin import PeriodicGrid, PointMask, ScalarField, Skin, VectorField
from ninedtact.quantities import Wrench


class NonPositiveLoad(InputError):
    """Raised for a load that does not press: zero, negative or not finite."""


class ContactLeavesGrid(SimulationError):
    """Raised for a contact at the grid's border, where it would meet its own periodic image."""


@dataclass(frozen=True)
class Contact:
    """The skin under one object, or under each of a batch, and how well it was solved."""

    skin: Skin
    pose: Pose
    pressure_mpa: ScalarField
    shear_mpa: VectorField
    """The shear traction (q_x, q_y) that the object applies to the skin."""
    height_mm: ScalarField
    """The displacement u_z, negative where the skin is pressed in."""
    tangential_mm: VectorField
    """The displacement (u_x, u_y) of the skin that is there now."""
    friction: float | PerContact
    residual_mm: ScalarPerContact = 0.0
    """The largest violation of the contact's conditions: gap under pressure, overlap, or missed stick."""
    iterations: CountPerContact = 0
    """Iterations of both solvers, over all rounds."""
    left: ScalarPerContact = 1.0
    """Part of the elastic tractions that is left in a gel that has relaxed; displacements are those of the elastic ones."""

    @property
    def centre_mm(self) -> tuple[ScalarPerContact, ScalarPerContact]:
        """The (x, y) of the sensor over which the middle of the grid lies."""
        return self.pose.x_mm, self.pose.y_mm

    @cached_property
    def thickness_change_mm(self) -> ScalarField:
        """The change of the gel's thickness, which is what light shows: the height less that of the gel's bottom."""
        if self.skin.gel.has_rigid_base:
            return self.height_mm
        interface_mm = self.skin.interface_height_mm(self.pressure_mpa, self.shear_mpa)
        return self.height_mm - interface_mm / expand_over_grid(self.left, interface_mm)

    @property
    def touches(self) -> bool:
        """Whether there is pressure anywhere, under any object of a batch."""
        return bool(array_namespace_of(self.pressure_mpa).any(self.pressure_mpa > 0))

    @property
    def stick_mask(self) -> PointMask:
        """The points where the skin moves with the object; a point under pressure that does not stick slips."""
        return (self.pressure_mpa > 0) & ~slip_mask(self.shear_mpa, self.friction * self.pressure_mpa)

    def wrench(self, about_mm: Float64[Array, "3"] | None = None) -> Wrench:
        """Return what the object applies to the skin, summed over the deformed surface; for a single contact.

        about_mm: the point of the torque, by default the middle of the undeformed skin.
        """
        six = to_numpy(self._summed_wrench(self.skin.grid.positions_mm))
        wrench = Wrench(six[:3], six[3:])
        return wrench if about_mm is None else wrench.about(about_mm)

    def wrenches(self) -> Float64[Any, "batch 6"]:
        """Return the wrench of each contact of a batch: force in N, torque in N·m about the middle of the undeformed skin.

        They stay where the fields are.
        """
        return self._summed_wrench(self.skin.coordinates_mm)

    def _summed_wrench(self, coordinates_mm: Any) -> Float64[Any, "*batch 6"]:
        """Return force and torque, summed in double precision on the device where the fields are.

        coordinates_mm: x and y of the grid's points.
        """
        z, cell = _to_double(self.height_mm), self.skin.grid.cell_area_mm2
        f_x, f_y = (_to_double(self.shear_mpa[..., axis, :, :]) * cell for axis in (0, 1))
        f_z = -_to_double(self.pressure_mpa) * cell
        xp = array_namespace_of(z)
        x, y = (
            xp.asarray(axis, dtype=z.dtype, device=device(z)) + expand_over_grid(middle, z)
            for axis, middle in zip(coordinates_mm, self.centre_mm, strict=True)
        )
        torques = (y * f_z - z * f_y, z * f_x - x * f_z, x * f_y - y * f_x)
        forces = [sum_over_grid(force) for force in (f_x, f_y, f_z)]
        sums = [*forces, *(sum_over_grid(torque) / 1e3 for torque in torques)]
        return xp.concat(sums, axis=-1)[..., 0, :]

    @property
    def surface_points_mm(self) -> Float64[Array, "*batch 3 rows cols"]:
        """The (x, y, z) of the skin at every point of the grid, in the sensor's frame."""
        height = to_numpy(self.height_mm)[..., None, :, :]
        x, y = (np.asarray(middle, float)[..., None, None] for middle in self.centre_mm)
        across, along = (coordinate + 0 * height[..., 0, :, :] for coordinate in self.skin.grid.positions_mm)
        return np.concatenate([np.stack([across + x, along + y], axis=-3), height], axis=-3)

    @staticmethod
    def stack(contacts: Sequence["Contact"]) -> "Contact":
        """Return single contacts on equal grids as a batch; skin and friction are those of the first."""
        first, stack = contacts[0], array_namespace_of(contacts[0].height_mm).stack
        pressure, shear = stack([one.pressure_mpa for one in contacts]), stack([one.shear_mpa for one in contacts])
        height, tangential = stack([one.height_mm for one in contacts]), stack([one.tangential_mm for one in contacts])
        pose = Pose.stack([one.pose for one in contacts])
        left = np.array([one.left for one in contacts])
        return Contact(first.skin, pose, pressure, shear, height, tangential, first.friction, left=left)

    def unstack(self) -> list["Contact"]:
        """Return the contacts of a batch as single contacts."""
        poses = self.pose.unstack()
        numbers = (self.residual_mm, self.iterations, self.left)
        each = zip(*(np.broadcast_to(of, len(poses)).tolist() for of in numbers), strict=True)
        fields = zip(self.pressure_mpa, self.shear_mpa, self.height_mm, self.tangential_mm, strict=True)
        return [
            Contact(self.skin, pose, *four, self.friction, *three)
            for pose, four, three in zip(poses, fields, each, strict=True)
        ]

    def on_skin(self, skin: Skin) -> "Contact":
        """Return the contact with its fields in the array library and on the device of this skin."""
        names = ("pressure_mpa", "shear_mpa", "height_mm", "tangential_mm")
        return replace(self, skin=skin, **{name: skin.asarray(to_numpy(getattr(self, name))) for name in names})

    def select(self, indices: Sequence[int], skin: Skin, friction: float) -> "Contact":
        """Return some contacts of a batch, all on this skin with this friction."""
        xp, where = array_namespace_of(self.height_mm), np.array(indices)
        there = xp.asarray(where, device=device(self.height_mm))
        names = ("pressure_mpa", "shear_mpa", "height_mm", "tangential_mm")
        fields = {name: xp.take(getattr(self, name), there, axis=0) for name in names}
        pose = {name: values[where] for name, values in vars(self.pose).items() if isinstance(values, np.ndarray)}
        shape, of_each = self.pose.batch_shape, ("residual_mm", "iterations", "left")
        numbers = {name: np.broadcast_to(getattr(self, name), shape)[where] for name in of_each}
        return replace(self, skin=skin, friction=friction, pose=Pose(**pose), **fields, **numbers)


def periodic_image_error_mm(contact: Contact, times: int = 3) -> Float64[Array, "rows cols"]:
    """Return how much higher the periodic images make the skin under one contact than the same tractions alone would.

    The contact alone is approximated by a grid `times` (odd) as long and as wide, whose periodic images are far away.
    """
    grid = contact.skin.grid
    larger = replace(contact.skin, grid=PeriodicGrid(times * grid.rows, times * grid.cols, grid.pitch_mm))
    around = [(0, 0), *((cells * (times // 2),) * 2 for cells in grid.shape)]
    tractions = np.pad(np.concatenate([to_numpy(contact.pressure_mpa)[None], to_numpy(contact.shear_mpa)]), around)
    alone, _ = larger.operators.displacement_mm(larger.asarray(tractions[0]), larger.asarray(tractions[1:]))
    inside = tuple(slice(before, before + cells) for (before, _), cells in zip(around[1:], grid.shape, strict=True))
    return to_numpy(contact.height_mm) - to_numpy(alone)[inside]


def require_depth_within_gel(deepest_mm: float, gel: Gel) -> None:
    """Refuse an object that reaches deeper than the gel allows, and depths that are not finite; raises `InvalidPose`."""
    if not deepest_mm < gel.max_depth_mm:
        raise InvalidPose(
            expected=f"the object less deep in the skin than the gel allows, {gel.max_depth_mm:g} mm",
            got=f"{deepest_mm:g} mm",
            remedy="press less, or give the skin its true thickness",
        )


def least_gel_mm(contact: Contact) -> ScalarPerContact:
    """Return the thickness of the gel where a contact leaves least of it, for each contact of a batch."""
    xp, change_mm = array_namespace_of(contact.height_mm), contact.thickness_change_mm
    return contact.skin.gel.thickness_mm + to_numpy(xp.min(change_mm, axis=(-2, -1)))


def require_gel_left(gel: Gel, left_mm: ScalarPerContact) -> None:
    """Refuse contacts under which nothing would be left of the gel; raises `InvalidPose`."""
    if not np.all(np.asarray(left_mm) > 0):
        raise InvalidPose(
            expected=f"the gel of {gel.thickness_mm:g} mm thinner by less than that",
            got=f"by {gel.thickness_mm - np.min(left_mm):g} mm",
            remedy="press less, or give the gel its true thickness",
        )


def require_inside_grid(grid: PeriodicGrid, field: ScalarField) -> None:
    """Refuse pressure (or overlap) above zero at the grid's border; raises `ContactLeavesGrid`."""
    xp = array_namespace_of(field)
    borders = {"left": field[..., 0], "right": field[..., -1], "upper": field[..., 0, :], "lower": field[..., -1, :]}
    reached = [name for name, border in borders.items() if bool(xp.any(border > 0))]
    if reached:
        raise ContactLeavesGrid(
            expected=f"the contact inside the grid of {grid.width_mm:g} x {grid.height_mm:g} mm",
            got=f"it at the {' and '.join(reached)} border",
            remedy="give the grid a wider margin, or press less deep",
        )


def positive_at_border(field: ScalarField) -> Bool[Any, " batch"]:
    """Return for each contact of a batch whether pressure (or overlap) is above zero at the grid's border."""
    above, xp = field > 0, array_namespace_of(field)
    sides = (above[:, :, 0], above[:, :, -1], above[:, 0, :], above[:, -1, :])
    return xp.any(xp.concat(sides, axis=1), axis=1)


@dataclass(frozen=True)
class ContactLimits:
    """The extremes of each contact of a batch, from which one sees whether the grid and the gel allow it."""

    at_border: Bool[Array, " batch"]
    """Whether there is pressure at the grid's border."""
    reach_mm: Float64[Array, "batch 2"]
    """The largest |x| and |y| of the sensor under pressure."""
    max_overlap_mm: Float64[Array, " batch"]
    """Largest overlap of the object with the undeformed skin."""
    overlap_at_border: Bool[Array, " batch"]
    """Whether the object overlaps with it at the grid's border."""
    least_gel_mm: Float64[Array, " batch"]
    """Thickness of the gel where the contact leaves least of it."""


def contact_limits(solved: Contact, corrected: Contact, overlap_mm: ScalarField) -> ContactLimits:
    """Return the extremes of each contact of a batch; the processor waits once for a device.

    corrected: the same contacts at finite strain. overlap_mm: overlap with the undeformed skin at the given poses.
    """
    pressed, xp = solved.pressure_mpa > 0, array_namespace_of(solved.pressure_mpa)
    at_border, by_col, by_row, overlap, overlaps, change_mm = to_numpy_together(
        positive_at_border(solved.pressure_mpa),
        xp.any(pressed, axis=1),
        xp.any(pressed, axis=2),
        max_over_grid(overlap_mm),
        positive_at_border(overlap_mm),
        xp.min(corrected.thickness_change_mm, axis=(-2, -1)),
    )
    thickness_mm, reach = solved.skin.gel.thickness_mm, _reach_mm(solved, by_col, by_row)
    return ContactLimits(at_border > 0, reach, overlap[:, 0, 0], overlaps > 0, thickness_mm + change_mm)


def reach_mm(contacts: Contact) -> Float64[Array, "batch 2"]:
    """Return the largest |x| and |y| of the sensor under pressure, for each contact of a batch."""
    pressed, xp = contacts.pressure_mpa > 0, array_namespace_of(contacts.pressure_mpa)
    return _reach_mm(contacts, *to_numpy_together(xp.any(pressed, axis=1), xp.any(pressed, axis=2)))


def _reach_mm(
    contacts: Contact, by_col: Float64[Array, "batch cols"], by_row: Float64[Array, "batch rows"]
) -> Float64[Array, "batch 2"]:
    (x, y), pose = contacts.skin.grid.positions_mm, contacts.pose
    reach = (
        np.max(np.abs(axis_mm + np.asarray(middle)[:, None]) * touched, axis=1)
        for axis_mm, middle, touched in ((x[0], pose.x_mm, by_col), (y[:, 0], pose.y_mm, by_row))
    )
    return np.stack(list(reach), axis=1)


def require_positive_load(load_n: ScalarPerContact) -> None:
    """Refuse a load that does not press; raises `NonPositiveLoad`."""
    if not np.all((np.asarray(load_n) > 0) & np.isfinite(load_n)):
        raise NonPositiveLoad(
            expected="a load above zero",
            got=f"{load_n} N",
            remedy="press with a force, or lift the object off by its depth",
        )


def require_converged(
    residual_mm: ScalarPerContact, tolerance_mm: ScalarPerContact, iterations: CountPerContact
) -> None:
    """Refuse a solution that misses its tolerance; raises `SimulationError`."""
    residuals, wanted, counts = np.broadcast_arrays(np.atleast_1d(residual_mm), tolerance_mm, iterations)
    missed = np.flatnonzero(~(residuals <= wanted))
    if len(missed):
        which, many = missed[0], f", {len(missed)} of {len(residuals)} contacts" if len(residuals) > 1 else ""
        raise SimulationError(
            expected=f"the contact solved to {wanted[which]:.2g} mm",
            got=f"{residuals[which]:.2g} mm after {counts[which]} iterations{many}",
            remedy="take smaller steps, or allow more rounds",
        )


def _to_double(field: Float[Any, "*shape"]) -> Float[Any, "*shape"]:
    xp = array_namespace_of(field)
    return xp.astype(field, xp.float64)

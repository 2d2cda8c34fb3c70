"""Skin and object on the way from one step to the next, on a grid that travels with the object.

A rigid object on the skin, pose by pose: press, drag, twist, tilt, lift.

Each step starts from the one before, because friction has memory: a point that sticks is carried with the object. Fields
travel with the object (`mechanics.touch`), so a point that sticks keeps its place on the grid. The object goes to a given
depth, or sinks in under a given load. A pose with arrays in it is a batch: as many contacts are solved at once, each as it
would be alone.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ninedtact.mechanics.active_region import ActiveRegion, find_active_region, whole_grid_region
from ninedtact.mechanics.alternating_solver import AlternatingSolver, AlternationResult, SolverSettings
from ninedtact.mechanics.array_namespace import array_namespace_of, forward_transform, inverse_transform
from ninedtact.mechanics.batching import PerContact, ScalarPerContact, expand_over_grid, to_counts, to_scalars
from ninedtact.mechanics.contact import (
    Contact,
    require_above_base,
    require_converged,
    require_inside_grid,
    require_positive_load,
)
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.normal_contact import ContactConstraint, DepthConstraint, LoadConstraint
from ninedtact.mechanics.pose import Pose, rigid_displacement_mm
from ninedtact.mechanics.skin import PointMask, ScalarField, Skin, VectorField


@dataclass(frozen=True)
class ContactProblem:
    """An object on its way into the skin."""

    pose: Pose
    held: ContactConstraint
    overlap_mm: ScalarField
    """How far the object reaches into the untouched skin."""
    carried_mm: VectorField
    """Where the skin's points come to if all that touched stick."""
    pressure_mpa: ScalarField
    """Of the step before, a first guess, as is the shear."""
    shear_mpa: VectorField

    @property
    def depth_mm(self) -> PerContact:
        """Of the object, as its overlap has it."""
        return 0 * self.overlap_mm[..., :1, :1] + expand_over_grid(self.pose.depth_mm, self.overlap_mm)

    @property
    def deepest_mm(self) -> float:
        """Of the overlap; the largest of a batch."""
        return float(array_namespace_of(self.overlap_mm).max(self.overlap_mm))


def pose_contact_problem(last: Contact, indenter: Indenter, pose: Pose, held: ContactConstraint) -> ContactProblem:
    """The object where it goes, over skin whose points it carries along as if all that touched stuck."""
    overlap = -indenter.over_skin_mm(replace(pose, x_mm=0.0, y_mm=0.0), *last.skin.places_mm)
    carried, pressure, shear = carried_displacement_mm(last, pose), last.pressure_mpa, last.shear_mpa
    overlap, pressure = (_broadcast_to_batch(pose, field, axes=2) for field in (overlap, pressure))
    carried, shear = (_broadcast_to_batch(pose, vectors, axes=3) for vectors in (carried, shear))
    return ContactProblem(pose, held, overlap, carried, pressure, shear)


def _broadcast_to_batch(pose: Pose, field: Any, axes: int) -> Any:
    """One field for every pose of a batch, also where there is one for all."""
    return array_namespace_of(field).broadcast_to(field, (*pose.batch_shape, *field.shape[-axes:]))


def carried_displacement_mm(last: Contact, pose: Pose) -> VectorField:
    """Tangential displacement of the skin at every point of the new grid, if all that touched stuck.

    A point that touched keeps its grid point and has moved with the object. A point that did not keeps its place on the
    sensor, so it is another point of the grid now. Twists turn no fields, since one step turns but little.
    """
    if not last.touches:
        return last.moved_mm
    by = pose.x_mm - last.pose.x_mm, pose.y_mm - last.pose.y_mm
    free = _shift_periodic_field(last.skin, last.moved_mm, by) if any(map(np.any, by)) else last.moved_mm
    before, after = replace(last.pose, x_mm=0.0, y_mm=0.0), replace(pose, x_mm=by[0], y_mm=by[1])
    stuck = last.moved_mm + rigid_displacement_mm(before, after, last.skin.place_mm)
    return array_namespace_of(free).where((last.pressure_mpa > 0)[..., None, :, :], stuck, free)


def _shift_periodic_field(skin: Skin, field: Any, by_mm: tuple[Any, Any]) -> Any:
    """A periodic field as it is this much farther along x and y, by the phase of its waves."""
    (k_x, k_y), shape, xp = skin.waves, skin.patch.shape, array_namespace_of(field)
    phase = xp.exp(1j * k_x * expand_over_grid(by_mm[0], k_x)) * xp.exp(1j * k_y * expand_over_grid(by_mm[1], k_y))
    return inverse_transform(forward_transform(field, shape) * phase[..., None, :, :], shape, shape)


@dataclass(frozen=True)
class ContactModel:
    """A skin with friction, ready to be pressed."""

    skin: Skin
    friction: float = 1.0
    effort: SolverSettings = field(default_factory=SolverSettings)

    def untouched(self) -> Contact:
        """The skin before anything is near."""
        return self.clear(Pose(), self.skin.asarray(np.zeros(self.skin.patch.shape)))

    def follow(self, indenter: Indenter, poses: Iterable[Pose]) -> Iterator[Contact]:
        """The contact at each pose in turn, from untouched skin on."""
        contact = self.untouched()
        for pose in poses:
            contact = self.step(contact, indenter, pose)
            yield contact

    def step(self, last: Contact, indenter: Indenter, pose: Pose) -> Contact:
        """The contact after the object moved on from the last pose to this one.

        Raises `PoseImpossible` where the object would reach the base, `ContactLeavesGrid` where the contact would meet
        its own periodic image, `ContactNotConverged`.
        """
        met = pose_contact_problem(last, indenter, pose, DepthConstraint())
        require_above_base(met.deepest_mm, self.skin.thickness_mm)
        if met.deepest_mm <= 0:
            return self.clear(pose, met.overlap_mm)
        require_inside_grid(self.skin.patch, met.overlap_mm)
        return self.solved(met)

    def step_to_load(self, last: Contact, indenter: Indenter, pose: Pose, load_n: ScalarPerContact) -> Contact:
        """The contact after the object moved on and was pressed with this load; its pose has the depth that was found.

        The depth of `pose` is a first guess. Raises `InvalidLoad`, and what `step` raises.
        """
        require_positive_load(load_n)
        total = self.skin.asarray(np.asarray(load_n, float)[..., None, None] / self.skin.patch.cell_mm2)
        each = replace(pose, depth_mm=pose.depth_mm + 0 * np.asarray(load_n))
        return self.solved(pose_contact_problem(last, indenter, each, LoadConstraint(total)))

    def solved(self, met: ContactProblem) -> Contact:
        """In the window that the contact should fit in; where skin beyond rises into the object, on the whole patch."""
        window = find_active_region(self.skin, met.overlap_mm)
        contact, risen = self.solved_in(window, met)
        if not window.holds(risen):
            contact, _ = self.solved_in(whole_grid_region(self.skin), met)
        return self.accepted(contact)

    def solved_in(self, window: ActiveRegion, met: ContactProblem) -> tuple[Contact, PointMask]:
        """The contact, and where on the patch its skin is inside the object by more than the tolerance."""
        overlap, carried = window.cut(met.overlap_mm), window.cut(met.carried_mm)
        turns = AlternatingSolver(window.response, met.held, overlap, met.depth_mm, carried, self.friction, self.effort)
        settled = turns.settled(turns.begun(window.cut(met.pressure_mpa), window.cut(met.shear_mpa)))
        contact, deeper = self.whole(window, met.pose, settled), settled.turn.pressed.deeper_mm
        level = self.effort.tolerance_mm(met.depth_mm + deeper) - deeper
        return contact, contact.height_mm + met.overlap_mm > level

    def whole(self, window: ActiveRegion, pose: Pose, settled: AlternationResult) -> Contact:
        """What was found in a window, on the whole patch."""
        turn = settled.turn
        pressure, shear = window.put(turn.pressed.pressure_mpa), window.put(turn.sheared.shear_mpa)
        height, moved = self.skin.response.displaced_mm(pressure, shear)
        return Contact(
            self.skin,
            replace(pose, depth_mm=pose.depth_mm + to_scalars(turn.pressed.deeper_mm)),
            *(pressure, shear, height, moved, self.friction),
            *(to_scalars(settled.residual_mm), to_counts(settled.iterations)),
        )

    def clear(self, pose: Pose, field: ScalarField) -> Contact:
        """Untouched skin, with fields of this kind."""
        zero = 0 * field
        pair = array_namespace_of(zero).stack((zero, zero), axis=-3)
        return Contact(self.skin, pose, zero, pair, zero, pair, self.friction)

    def accepted(self, contact: Contact) -> Contact:
        """Refuse an answer that is none."""
        require_inside_grid(self.skin.patch, contact.pressure_mpa)
        require_above_base(float(np.max(contact.pose.depth_mm)), self.skin.thickness_mm)
        if self.effort.must_converge:
            wanted = self.effort.tolerance_mm(contact.pose.depth_mm)
            require_converged(contact.residual_mm, wanted, contact.iterations)
        return contact

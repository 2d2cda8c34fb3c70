"""A rigid object on the skin, pose by pose: press, drag, twist, tilt, lift.

Each step starts from the one before, because friction has memory: a point that sticks is carried with the object. Fields
travel with the object (`mechanics.touch`), so a point that sticks keeps its place on the grid. The object goes to a given
depth, or sinks in under a given load. A pose with arrays in it is a batch: as many contacts are solved at once, each as it
would be alone.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.normal import HeldDepth, HeldLoad
from ninedtact.mechanics.per_contact import Number, counted, plain
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.refusals import (
    ContactLeavesPatch,
    LoadImpossible,
    NotConverged,
    require_above_base,
    require_converged,
    require_inside,
    require_load,
)
from ninedtact.mechanics.response import Field, Points
from ninedtact.mechanics.skin import Skin
from ninedtact.mechanics.touch import Contact
from ninedtact.mechanics.travel import Meeting, meeting
from ninedtact.mechanics.turns import Effort, Settled, Turns
from ninedtact.mechanics.window import Window, whole_patch, window_around

__all__ = ["Contact", "ContactLeavesPatch", "ContactModel", "Effort", "LoadImpossible", "NotConverged"]


@dataclass(frozen=True)
class ContactModel:
    """A skin with friction, ready to be pressed."""

    skin: Skin
    friction: float = 1.0
    effort: Effort = field(default_factory=Effort)

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

        Raises `PoseImpossible` where the object would reach the base, `ContactLeavesPatch` where the contact would meet
        its own periodic image, `NotConverged`.
        """
        met = meeting(last, indenter, pose, HeldDepth())
        require_above_base(met.deepest_mm, self.skin.thickness_mm)
        if met.deepest_mm <= 0:
            return self.clear(pose, met.overlap_mm)
        require_inside(self.skin.patch, met.overlap_mm)
        return self.solved(met)

    def step_to_load(self, last: Contact, indenter: Indenter, pose: Pose, load_n: Number) -> Contact:
        """The contact after the object moved on and was pressed with this load; its pose has the depth that was found.

        The depth of `pose` is a first guess. Raises `LoadImpossible`, and what `step` raises.
        """
        require_load(load_n)
        total = self.skin.asarray(np.asarray(load_n, float)[..., None, None] / self.skin.patch.cell_mm2)
        each = replace(pose, depth_mm=pose.depth_mm + 0 * np.asarray(load_n))
        return self.solved(meeting(last, indenter, each, HeldLoad(total)))

    def solved(self, met: Meeting) -> Contact:
        """In the window that the contact should fit in; where skin beyond rises into the object, on the whole patch."""
        window = window_around(self.skin, met.overlap_mm)
        contact, risen = self.solved_in(window, met)
        if not window.holds(risen):
            contact, _ = self.solved_in(whole_patch(self.skin), met)
        return self.accepted(contact)

    def solved_in(self, window: Window, met: Meeting) -> tuple[Contact, Points]:
        """The contact, and where on the patch its skin is inside the object by more than the tolerance."""
        overlap, carried = window.cut(met.overlap_mm), window.cut(met.carried_mm)
        turns = Turns(window.response, met.held, overlap, met.depth_mm, carried, self.friction, self.effort)
        settled = turns.settled(turns.begun(window.cut(met.pressure_mpa), window.cut(met.shear_mpa)))
        contact, deeper = self.whole(window, met.pose, settled), settled.turn.pressed.deeper_mm
        level = self.effort.tolerance_mm(met.depth_mm + deeper) - deeper
        return contact, contact.height_mm + met.overlap_mm > level

    def whole(self, window: Window, pose: Pose, settled: Settled) -> Contact:
        """What was found in a window, on the whole patch."""
        turn = settled.turn
        pressure, shear = window.put(turn.pressed.pressure_mpa), window.put(turn.sheared.shear_mpa)
        height, moved = self.skin.response.displaced_mm(pressure, shear)
        return Contact(
            self.skin,
            replace(pose, depth_mm=pose.depth_mm + plain(turn.pressed.deeper_mm)),
            *(pressure, shear, height, moved, self.friction),
            *(plain(settled.residual_mm), counted(settled.iterations)),
        )

    def clear(self, pose: Pose, field: Field) -> Contact:
        """Untouched skin, with fields of this kind."""
        zero = 0 * field
        pair = library_of(zero).stack((zero, zero), axis=-3)
        return Contact(self.skin, pose, zero, pair, zero, pair, self.friction)

    def accepted(self, contact: Contact) -> Contact:
        """Refuse an answer that is none."""
        require_inside(self.skin.patch, contact.pressure_mpa)
        require_above_base(float(np.max(contact.pose.depth_mm)), self.skin.thickness_mm)
        if self.effort.must_converge:
            wanted = self.effort.tolerance_mm(contact.pose.depth_mm)
            require_converged(contact.residual_mm, wanted, contact.iterations)
        return contact

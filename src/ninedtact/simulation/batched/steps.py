"""One batch of steps: what `Twin.step` does with one object on one sensor, done with many on many.

Every contact takes the path that it would take alone, from its own first guess in its own window to its own last iteration;
only rounding differs. What refuses one contact is the answer to that one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from array_api_compat import device

from ninedtact.mechanics.alternating_solver import AlternatingSolver, AlternationResult, SolverSettings
from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.mechanics.batching import expand_over_grid, to_counts, to_scalars
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.contact_model import carried_displacement_mm
from ninedtact.mechanics.indenter import NO_OBJECT_MM
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField
from ninedtact.simulation.batched.held import HeldEach
from ninedtact.simulation.batched.objects import Shelf
from ninedtact.simulation.batched.requests import Step
from ninedtact.simulation.batched.skins import Skins
from ninedtact.simulation.batched.weighing import stacked
from ninedtact.simulation.batched.windows import Rectangle, inside, whole, windows_around


@dataclass(frozen=True)
class Steps:
    """Steps of many hands, on their way to their contacts. Skin and friction of the batches in here are those of the first,
    which nobody asks for; `of_sensor` gives each sensor's contacts their own."""

    asked: Sequence[Step]
    skins: Skins
    shelf: Shelf

    @cached_property
    def which(self) -> list[int]:
        """Numbers of their sensors among the skins."""
        return [self.skins.numbers[step.bench] for step in self.asked]

    @cached_property
    def pose(self) -> Pose:
        """Of all objects; the depth of those that are pressed to a load is a first guess."""
        return Pose.batch([step.pose for step in self.asked])

    @cached_property
    def last(self) -> Contact:
        """What all go on from."""
        blank = self.skins.blank
        return stacked([step.last or replace(blank, pose=step.pose) for step in self.asked])

    @cached_property
    def overlap_mm(self) -> ScalarField:
        """How far each object reaches into the untouched skin."""
        objects = self.shelf.several([step.indenter for step in self.asked])
        return -objects.over_skin_mm(replace(self.pose, x_mm=0.0, y_mm=0.0), *self.skins.grid.places_mm)

    @cached_property
    def windows(self) -> list[Rectangle]:
        """Where each contact may be."""
        patch, windows = whole(self.skins.grid.patch.shape), windows_around(self.overlap_mm)
        return [patch if step.widely else window for step, window in zip(self.asked, windows, strict=True)]

    @cached_property
    def inside(self) -> PointMask:
        """The points of those windows."""
        return inside(self.windows, self.overlap_mm)

    @cached_property
    def response(self) -> DisplacementOperators:
        """Of each sensor's skin in its contact's window."""
        return self.skins.response(self.which, self.windows, self.inside)

    @property
    def effort(self) -> SolverSettings:
        """The same for all twins."""
        return self.asked[0].bench.twin.solver_settings

    @property
    def held(self) -> HeldEach:
        """By load or by depth, each as it is asked."""
        loads, xp = [step.load_n for step in self.asked], array_namespace_of(self.overlap_mm)
        totals = expand_over_grid(
            np.array([load or 0.0 for load in loads]) / self.skins.grid.patch.cell_mm2, self.overlap_mm
        )
        by_load = np.array([load is not None for load in loads])[:, None, None]
        return HeldEach(totals, xp.asarray(by_load, device=device(self.overlap_mm)), self.response.inside)

    @cached_property
    def settled(self) -> AlternationResult:
        """All of them solved, each to its own end."""
        overlap, window = self.overlap_mm, self.response.inside
        turns = AlternatingSolver(
            self.response,
            self.held,
            array_namespace_of(overlap).where(self.inside, overlap, -NO_OBJECT_MM),
            expand_over_grid(self.pose.depth_mm, overlap),
            carried_displacement_mm(self.last, self.pose),
            expand_over_grid(np.array([step.bench.twin.friction for step in self.asked]), overlap),
            self.effort,
        )
        return turns.settled(turns.begun(self.last.pressure_mpa * window, self.last.shear_mpa * window[:, None]))

    @cached_property
    def contacts(self) -> Contact:
        """What came of them."""
        pressed, sheared = self.settled.turn.pressed, self.settled.turn.sheared
        height, moved = replace(self.response, inside=None).displaced_mm(pressed.pressure_mpa, sheared.shear_mpa)
        return Contact(
            self.last.skin,
            replace(self.pose, depth_mm=self.pose.depth_mm + to_scalars(pressed.deeper_mm)),
            *(pressed.pressure_mpa, sheared.shear_mpa, height, moved, self.last.friction),
            *(to_scalars(self.settled.residual_mm), to_counts(self.settled.iterations)),
        )

    @cached_property
    def too_small(self) -> PointMask:
        """Where skin beyond a contact's own window is inside its object by more than the tolerance."""
        contacts, deeper = self.contacts, self.settled.turn.pressed.deeper_mm
        level = self.effort.tolerance_mm(expand_over_grid(self.pose.depth_mm, deeper) + deeper) - deeper
        return (contacts.height_mm + self.overlap_mm > level) & ~self.inside

    def of_sensor(self, chosen: Sequence[int]) -> Contact:
        """The chosen contacts, all of one sensor, as a batch with its skin and friction."""
        first, found = chosen[0], self.contacts
        skin, friction = self.skins.here[self.which[first]], self.asked[first].bench.twin.friction
        return replace(picked(found, chosen), skin=skin, friction=friction)


def picked(contacts: Contact, chosen: Sequence[int]) -> Contact:
    """Some contacts of a batch."""
    xp, where = array_namespace_of(contacts.height_mm), np.array(chosen)
    there = xp.asarray(where, device=device(contacts.height_mm))
    names = ("pressure_mpa", "shear_mpa", "height_mm", "moved_mm")
    fields = {name: xp.take(getattr(contacts, name), there, axis=0) for name in names}
    pose = Pose(
        **{name: values[where] for name, values in vars(contacts.pose).items() if isinstance(values, np.ndarray)}
    )
    counts = {name: np.asarray(getattr(contacts, name))[where] for name in ("residual_mm", "iterations")}
    return replace(contacts, pose=pose, **fields, **counts)

"""One batch of steps: what `Twin.step` does with one object on one sensor, done with many on many.

Every contact takes the path that it would take alone, from its own first guess in its own window to its own last iteration;
only rounding differs. What refuses one contact is the answer to that one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from array_api_compat import device

from ninedtact.mechanics.contact import Contact, Effort
from ninedtact.mechanics.indenter import NOTHING_MM
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.per_contact import counted, over_grid, plain
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.response import Field, Points, Response
from ninedtact.mechanics.travel import carried_along
from ninedtact.mechanics.turns import Settled, Turns
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
    def overlap_mm(self) -> Field:
        """How far each object reaches into the untouched skin."""
        objects = self.shelf.several([step.indenter for step in self.asked])
        return -objects.over_skin_mm(replace(self.pose, x_mm=0.0, y_mm=0.0), *self.skins.grid.places_mm)

    @cached_property
    def windows(self) -> list[Rectangle]:
        """Where each contact may be."""
        patch, windows = whole(self.skins.grid.patch.shape), windows_around(self.overlap_mm)
        return [patch if step.widely else window for step, window in zip(self.asked, windows, strict=True)]

    @cached_property
    def inside(self) -> Points:
        """The points of those windows."""
        return inside(self.windows, self.overlap_mm)

    @cached_property
    def response(self) -> Response:
        """Of each sensor's skin in its contact's window."""
        return self.skins.response(self.which, self.windows, self.inside)

    @property
    def effort(self) -> Effort:
        """The same for all twins."""
        return self.asked[0].bench.twin.effort

    @property
    def held(self) -> HeldEach:
        """By load or by depth, each as it is asked."""
        loads, xp = [step.load_n for step in self.asked], library_of(self.overlap_mm)
        totals = over_grid(np.array([load or 0.0 for load in loads]) / self.skins.grid.patch.cell_mm2, self.overlap_mm)
        by_load = np.array([load is not None for load in loads])[:, None, None]
        return HeldEach(totals, xp.asarray(by_load, device=device(self.overlap_mm)), self.response.inside)

    @cached_property
    def settled(self) -> Settled:
        """All of them solved, each to its own end."""
        overlap, window = self.overlap_mm, self.response.inside
        turns = Turns(
            self.response,
            self.held,
            library_of(overlap).where(self.inside, overlap, -NOTHING_MM),
            over_grid(self.pose.depth_mm, overlap),
            carried_along(self.last, self.pose),
            over_grid(np.array([step.bench.twin.friction for step in self.asked]), overlap),
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
            replace(self.pose, depth_mm=self.pose.depth_mm + plain(pressed.deeper_mm)),
            *(pressed.pressure_mpa, sheared.shear_mpa, height, moved, self.last.friction),
            *(plain(self.settled.residual_mm), counted(self.settled.iterations)),
        )

    @cached_property
    def too_small(self) -> Points:
        """Where skin beyond a contact's own window is inside its object by more than the tolerance."""
        contacts, deeper = self.contacts, self.settled.turn.pressed.deeper_mm
        level = self.effort.tolerance_mm(over_grid(self.pose.depth_mm, deeper) + deeper) - deeper
        return (contacts.height_mm + self.overlap_mm > level) & ~self.inside

    def of_sensor(self, chosen: Sequence[int]) -> Contact:
        """The chosen contacts, all of one sensor, as a batch with its skin and friction."""
        first, found = chosen[0], self.contacts
        skin, friction = self.skins.here[self.which[first]], self.asked[first].bench.twin.friction
        return replace(picked(found, chosen), skin=skin, friction=friction)


def picked(contacts: Contact, chosen: Sequence[int]) -> Contact:
    """Some contacts of a batch."""
    xp, where = library_of(contacts.height_mm), np.array(chosen)
    there = xp.asarray(where, device=device(contacts.height_mm))
    names = ("pressure_mpa", "shear_mpa", "height_mm", "moved_mm")
    fields = {name: xp.take(getattr(contacts, name), there, axis=0) for name in names}
    pose = Pose(
        **{name: values[where] for name, values in vars(contacts.pose).items() if isinstance(values, np.ndarray)}
    )
    counts = {name: np.asarray(getattr(contacts, name))[where] for name in ("residual_mm", "iterations")}
    return replace(contacts, pose=pose, **fields, **counts)

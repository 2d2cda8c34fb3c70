"""One object on one sensor: pressed to a load, then dragged, twisted and tilted from station to station.

A hand feels force: it presses to a load and pulls until the shear is what it wants, or until the object slips. So each step
sinks in under its load, and moves sideways by what is missing in shear over the contact's stiffness.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.mechanics.contact import Contact, ContactLeavesPatch, LoadImpossible
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose, PoseImpossible
from ninedtact.simulation.dataset.hand import Aim, Hand
from ninedtact.simulation.population.member import SensorMember
from ninedtact.simulation.twin import ObjectTooLarge, PoseOutOfView, Twin

LIFTED = (PoseOutOfView, LoadImpossible, ContactLeavesPatch, ObjectTooLarge)
"""Where no contact can be: the hand lifts the object."""
FARTHEST_MM = 0.5
"""One step sideways at most."""
NEAR_MM = 1.0
"""What of the underside is lower than this is expected to touch."""
MARGIN_MM = 0.5
"""Between a contact and the edge of the sensing area."""
LOOSE, LOOSE_MM = 0.03, 0.002
"""Part of the deepest indentation, and mm: a contact that is solved less well ends the touch."""


@dataclass
class Touch:
    """A hand with an object on a sensor."""

    member: SensorMember
    twin: Twin
    """The member's, made once."""
    indenter: Indenter
    hand: Hand
    rng: np.random.Generator
    contact: Contact = field(init=False)
    """As the model solved it: the next step goes on from it."""
    turn_rad: float = field(init=False)

    def __post_init__(self) -> None:
        self.turn_rad = float(self.rng.uniform(-np.pi, np.pi))
        room = room_mm(self.indenter, self.turn_rad, self.twin.area_mm)
        x, y = self.hand.place(self.rng, room)
        self.contact = replace(self.twin.model.untouched(), pose=Pose(x, y, 0.0, self.turn_rad))

    def stations(self) -> Iterator[Contact]:
        """Felt contacts, step by step, until the hand has had enough or the object cannot stay."""
        aim = replace(self.hand.aim(self.rng), load_n=0.0, shear_n=np.zeros(2))
        fewest, most = self.hand.stations
        for _ in range(self.rng.integers(fewest, most + 1)):
            before, aim = aim, self.hand.aim(self.rng)
            for step in range(1, self.hand.steps + 1):
                if not self.stepped(between(before, aim, step / self.hand.steps)):
                    return
                yield self.felt

    def lightly(self, load_n: float) -> Iterator[Contact]:
        """The felt contact under this load alone, if there is one."""
        if self.stepped(replace(self.hand.aim(self.rng), load_n=load_n, shear_n=np.zeros(2), twist_rad=0.0)):
            yield self.felt

    @property
    def felt(self) -> Contact:
        """As it is seen and weighed."""
        return self.twin.felt(self.contact)

    def stepped(self, aim: Aim) -> bool:
        """Move on towards an aim; whether there is a contact to go on from."""
        try:
            contact = self.sunk(self.towards(aim), aim.load_n / self.stiffer)
        except LIFTED:
            return False
        self.contact = contact
        return bool(contact.touches and contact.residual_mm < LOOSE * deepest_mm(contact) + LOOSE_MM)

    def sunk(self, pose: Pose, load_n: float) -> Contact:
        """Under the load, or as deep as a hand goes."""
        try:
            contact = self.twin.step(self.contact, self.indenter, pose, load_n)
        except PoseImpossible:
            # The object would go through the gel: no hand presses a needle that hard.
            return self.sunk(pose, load_n / 2)
        too_deep = deepest_mm(contact) - self.hand.deepest * self.member.gel.thickness_mm
        if too_deep <= 0:
            return contact
        return self.twin.step(self.contact, self.indenter, replace(pose, depth_mm=contact.pose.depth_mm - too_deep))

    def towards(self, aim: Aim) -> Pose:
        """The pose of the next step; its depth is a guess."""
        tilt_x, tilt_y = aim.tilt_rad.tolist()
        pose = replace(self.contact.pose, twist_rad=self.turn_rad + aim.twist_rad, tilt_x_rad=tilt_x, tilt_y_rad=tilt_y)
        if not self.contact.touches:
            return pose
        missing = aim.shear_n - self.felt.wrench().force_n[:2]
        by = np.clip(missing / self.stiffness_n_per_mm, -FARTHEST_MM, FARTHEST_MM).tolist()
        return replace(pose, x_mm=pose.x_mm + by[0], y_mm=pose.y_mm + by[1])

    @property
    def stiffer(self) -> float:
        """How much heavier the contact is felt than the model solved it."""
        if not self.contact.touches:
            return 1.0
        return float(self.felt.pressure_mpa.sum() / self.contact.pressure_mpa.sum())

    @property
    def stiffness_n_per_mm(self) -> float:
        """Of the contact against dragging, roughly: a disc of its area on a half-space, and the layer below it in shear."""
        area = float((self.contact.pressure_mpa > 0).sum()) * self.twin.model.skin.patch.cell_mm2
        return self.member.gel.shear_modulus_mpa * (
            16 / 3 * np.sqrt(area / np.pi) + area / self.member.gel.thickness_mm
        )


def between(before: Aim, after: Aim, part: float) -> Aim:
    """Part of the way from one aim to the next."""
    ways = {name: getattr(before, name) + part * (value - getattr(before, name)) for name, value in vars(after).items()}
    return Aim(**ways)


def deepest_mm(contact: Contact) -> float:
    """The largest indentation of the skin."""
    return -float(contact.height_mm.min())


def room_mm(indenter: Indenter, turn_rad: float, area_mm: tuple[float, float]) -> Float64[Array, "2"]:
    """How far the object's middle may be from the sensor's along x and y with its contact in view."""
    axis = np.linspace(-12, 12, 97)
    x, y = np.meshgrid(axis, axis)
    near = indenter.over_skin_mm(Pose(twist_rad=turn_rad), x, y) < NEAR_MM
    reach = np.array([np.abs(x[near]).max(initial=0), np.abs(y[near]).max(initial=0)])
    return np.maximum(np.array(area_mm) / 2 - MARGIN_MM - reach, 0)

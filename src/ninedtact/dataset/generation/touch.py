"""One object on one sensor: pressed to a load, then dragged, twisted and tilted from station to station.

A hand feels force: it presses to a load and pulls until the shear is what it wants, or until the object slips. So each step
sinks in under its load, and moves sideways by what is missing in shear over the contact's stiffness.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.dataset.generation.hand import Aim, Hand
from ninedtact.mechanics.contact import ContactLeavesGrid, InvalidLoad
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.simulation.batched.requests import Asking, Bench, Felt, Step
from ninedtact.simulation.twin import ObjectTooLarge, PoseOutOfView

LIFTED = (PoseOutOfView, InvalidLoad, ContactLeavesGrid, ObjectTooLarge)
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

    bench: Bench
    indenter: Indenter
    hand: Hand
    rng: np.random.Generator
    pose: Pose = field(init=False)
    """Of the object."""
    felt: Felt | None = field(init=False, default=None)
    """The contact; the next step goes on from it. None before the first."""
    turn_rad: float = field(init=False)

    def __post_init__(self) -> None:
        self.turn_rad = float(self.rng.uniform(-np.pi, np.pi))
        area = self.bench.twin.area_mm
        x, y = self.hand.place(self.rng, room_mm(self.indenter, self.turn_rad, area), area)
        self.pose = Pose(x, y, 0.0, self.turn_rad)

    def aims(self) -> Iterator[Aim]:
        """Step by step from station to station, until the hand has had enough; each is drawn when its turn comes."""
        aim = self.loaded(0.0)
        fewest, most = self.hand.stations
        for _ in range(self.rng.integers(fewest, most + 1)):
            before, aim = aim, self.hand.aim(self.rng)
            for step in range(1, self.hand.steps + 1):
                yield between(before, aim, step / self.hand.steps)

    def lightly(self, load_n: float) -> Asking[Felt | None]:
        """The contact under this load alone, if there is one."""
        return self.stepped(replace(self.loaded(load_n), twist_rad=0.0))

    def loaded(self, load_n: float) -> Aim:
        """An aim with this load and no shear."""
        return replace(self.hand.aim(self.rng), load_n=load_n, shear_n=np.zeros(2))

    def stepped(self, aim: Aim) -> Asking[Felt | None]:
        """Move on towards an aim; the contact, if there is one to go on from."""
        try:
            felt = yield from self.sunk(self.towards(aim), aim.load_n / (self.felt.stiffer if self.felt else 1.0))
        except LIFTED:
            return None
        self.felt, self.pose = felt, felt.pose
        return felt if felt.touches and felt.contact.residual_mm < LOOSE * felt.deepest_mm + LOOSE_MM else None

    def sunk(self, pose: Pose, load_n: float) -> Asking[Felt]:
        """Under the load, or as deep as a hand goes."""
        try:
            felt: Felt = yield self.step(pose, load_n)
        except InvalidPose:
            # The object would go through the gel: no hand presses a needle that hard.
            return (yield from self.sunk(pose, load_n / 2))
        too_deep = felt.deepest_mm - self.hand.deepest * self.bench.member.gel.thickness_mm
        if too_deep <= 0:
            return felt
        return (yield self.step(replace(pose, depth_mm=felt.pose.depth_mm - too_deep)))

    def step(self, pose: Pose, load_n: float | None = None) -> Step:
        """From the contact that there is."""
        return Step(self.bench, self.felt.contact if self.felt else None, self.indenter, pose, load_n)

    def towards(self, aim: Aim) -> Pose:
        """The pose of the next step; its depth is a guess."""
        tilt_x, tilt_y = aim.tilt_rad.tolist()
        pose = replace(self.pose, twist_rad=self.turn_rad + aim.twist_rad, tilt_x_rad=tilt_x, tilt_y_rad=tilt_y)
        if self.felt is None or not self.felt.touches:
            return pose
        missing = aim.shear_n - self.felt.wrench.force_n[:2]
        by = np.clip(missing / self.stiffness_n_per_mm(self.felt), -FARTHEST_MM, FARTHEST_MM).tolist()
        return replace(pose, x_mm=pose.x_mm + by[0], y_mm=pose.y_mm + by[1])

    def stiffness_n_per_mm(self, felt: Felt) -> float:
        """Of a contact against dragging, roughly: a disc of its area on a half-space, and the layer below it in shear."""
        gel, area = self.bench.member.gel, felt.area_mm2
        return gel.shear_modulus_mpa * (16 / 3 * np.sqrt(area / np.pi) + area / gel.thickness_mm)


def between(before: Aim, after: Aim, part: float) -> Aim:
    """Part of the way from one aim to the next."""
    ways = {name: getattr(before, name) + part * (value - getattr(before, name)) for name, value in vars(after).items()}
    return Aim(**ways)


def room_mm(indenter: Indenter, turn_rad: float, area_mm: tuple[float, float]) -> Float64[Array, "2"]:
    """How far the object's middle may be from the sensor's along x and y with its contact in view."""
    axis = np.linspace(-12, 12, 97)
    x, y = np.meshgrid(axis, axis)
    near = indenter.over_skin_mm(Pose(twist_rad=turn_rad), x, y) < NEAR_MM
    reach = np.array([np.abs(x[near]).max(initial=0), np.abs(y[near]).max(initial=0)])
    return np.maximum(np.array(area_mm) / 2 - MARGIN_MM - reach, 0)

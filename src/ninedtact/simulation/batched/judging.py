"""What each hand of a batch is told: what it feels, that there can be no such contact, or to ask again more widely."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.array_namespace import array_namespace_of, to_numpy
from ninedtact.mechanics.batching import max_over_grid, to_scalars
from ninedtact.mechanics.contact import (
    ContactLeavesGrid,
    require_above_base,
    require_inside_grid,
    require_positive_load,
)
from ninedtact.mechanics.skin import ScalarField
from ninedtact.simulation.batched.requests import Felt, Step
from ninedtact.simulation.batched.steps import Steps, picked
from ninedtact.simulation.batched.weighing import felt_by_each

Told = Felt | Step | NinedtactError
Flags = Bool[Array, " batch"]


@dataclass(frozen=True)
class Judge:
    """Of one batch, solved. All are looked at together; the doubtful ones again, one by one, by those who judge one contact."""

    steps: Steps

    def told(self) -> list[Told]:
        """For every step."""
        told: dict[int, Told] = {}
        for number, step in enumerate(self.steps.asked):
            if answer := self.refused(number, step):
                told[number] = answer
        told |= self.felt([number for number in range(len(self.steps.asked)) if number not in told])
        return [told[number] for number in range(len(self.steps.asked))]

    def refused(self, number: int, step: Step) -> NinedtactError | Step | None:
        """Why there is no contact, in the order in which `Twin.step` asks; or the same step, more widely."""
        try:
            if step.load_n is None:
                require_above_base(float(self.deepest_mm[number]), step.bench.twin.thickness_mm)
                if self.overlap_at_border[number]:
                    require_inside_grid(self.steps.skins.grid.patch, self.steps.overlap_mm[number])
            if self.window_too_small[number]:
                return replace(step, widely=True)
            if self.doubtful[number]:
                contact = picked(self.steps.contacts, [number]).each()[0]
                step.bench.twin.model.accepted(contact)
                step.bench.twin.require_on_gel(step.indenter, contact)
        except ContactLeavesGrid:
            return step.bench.twin.object_too_large(step.indenter, "more than that")
        except NinedtactError as refusal:
            return refusal
        return None

    def felt(self, numbers: Iterable[int]) -> dict[int, Felt]:
        """By the hands that have a contact, sensor by sensor."""
        of_sensor: dict[int, list[int]] = defaultdict(list)
        for number in numbers:
            of_sensor[self.steps.which[number]].append(number)
        felt: dict[int, Felt] = {}
        for chosen in of_sensor.values():
            contacts = self.steps.of_sensor(chosen)
            seen = self.steps.asked[chosen[0]].bench.twin.correct_contact(contacts)
            felt |= dict(zip(chosen, felt_by_each(contacts, seen), strict=True))
        return felt

    @cached_property
    def deepest_mm(self) -> Float64[Array, " batch"]:
        """Of the overlaps."""
        return np.asarray(to_scalars(max_over_grid(self.steps.overlap_mm)))

    @cached_property
    def overlap_at_border(self) -> Flags:
        """Whether an object reaches into the skin at the patch's border."""
        return at_border(self.steps.overlap_mm)

    @cached_property
    def window_too_small(self) -> Flags:
        """Whether a contact is larger than its window."""
        return flags(array_namespace_of(self.steps.too_small).any(self.steps.too_small, axis=(1, 2)))

    @cached_property
    def doubtful(self) -> Flags:
        """Whether a contact may be none: at the border, through the base, over the gel's rim, or perhaps not converged."""
        contacts, steps = self.steps.contacts, self.steps.asked
        thickness = np.array([step.bench.twin.thickness_mm for step in steps])
        through = ~(np.asarray(contacts.pose.depth_mm) < thickness)
        beyond = (self.reach_mm > np.array([step.bench.twin.gel_mm for step in steps]) / 2).any(axis=1)
        return np.asarray(at_border(contacts.pressure_mpa) | through | beyond | self.steps.effort.must_converge)

    @cached_property
    def reach_mm(self) -> Float64[Array, "batch 2"]:
        """Largest |x| and |y| of the sensor under pressure."""
        contacts, pressed = self.steps.contacts, self.steps.contacts.pressure_mpa > 0
        place = contacts.skin.patch.place_mm
        axes = ((1, place[0][0], contacts.pose.x_mm), (2, place[1][:, 0], contacts.pose.y_mm))
        reach = []
        for over, along, middle in axes:
            touched = flags(array_namespace_of(pressed).any(pressed, axis=over))
            reach.append(np.max(np.abs(along + np.asarray(middle)[:, None]) * touched, axis=1))
        return np.stack(reach, axis=1)


def at_border(field: ScalarField) -> Flags:
    """Whether it is above zero at the patch's border."""
    above, xp = field > 0, array_namespace_of(field)
    sides = (above[:, :, 0], above[:, :, -1], above[:, 0, :], above[:, -1, :])
    return flags(xp.any(xp.concat(sides, axis=1), axis=1))


def flags(values: Bool[Any, "*shape"]) -> Bool[Array, "*shape"]:
    """On the processor."""
    return to_numpy(values) > 0


def refused_before(step: Step) -> NinedtactError | None:
    """What is refused without looking at the skin."""
    try:
        step.bench.twin.require_in_view(step.pose)
        if step.load_n is not None:
            require_positive_load(step.load_n)
    except NinedtactError as refusal:
        return refusal
    return None

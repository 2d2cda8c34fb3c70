"""Contacts of one sensor in numbers, as `asking.felt` has them of one contact, all in one go."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Float64
from numpy import ndarray as Array

from ninedtact.mechanics.array_namespace import array_namespace_of, to_numpy
from ninedtact.mechanics.batching import expand_over_grid, sum_over_grid
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Wrench
from ninedtact.simulation.batched.requests import Felt


def stacked(contacts: Sequence[Contact]) -> Contact:
    """Contacts on one grid as a batch; skin and friction are those of the first."""
    first, stack = contacts[0], array_namespace_of(contacts[0].height_mm).stack
    pressure, shear = stack([one.pressure_mpa for one in contacts]), stack([one.shear_mpa for one in contacts])
    height, moved = stack([one.height_mm for one in contacts]), stack([one.moved_mm for one in contacts])
    return Contact(
        first.skin, Pose.batch([one.pose for one in contacts]), pressure, shear, height, moved, first.friction
    )


def felt_by_each(contacts: Contact, seen: Contact) -> list[Felt]:
    """What the hand on every contact of a batch feels."""
    six, rest = wrenches(seen), numbers(contacts, seen)
    return [
        Felt(one, shown, Wrench(of[:3], of[3:]), pressed > 0, deepest, pressed * contacts.skin.patch.cell_mm2, stiffer)
        for one, shown, of, (pressed, deepest, stiffer) in zip(
            contacts.each(), seen.each(), six, rest.tolist(), strict=True
        )
    ]


def numbers(contacts: Contact, seen: Contact) -> Float64[Array, "batch 3"]:
    """Points under pressure, the largest indentation, and how much heavier each is felt than it was solved."""
    xp, pressed = array_namespace_of(contacts.height_mm), contacts.pressure_mpa > 0
    solved = sum_over_grid(contacts.pressure_mpa)
    stiffer = xp.where(solved > 0, sum_over_grid(seen.pressure_mpa) / xp.where(solved > 0, solved, 1.0), 1.0)
    deepest = -xp.min(contacts.height_mm, axis=(-2, -1), keepdims=True)
    every = (xp.astype(sum_over_grid(pressed), deepest.dtype), deepest, stiffer)
    return to_numpy(xp.concat(every, axis=-1))[:, 0, :]


def wrenches(seen: Contact) -> Float64[Array, "batch 6"]:
    """As `Contact.wrench`, about the skin's centre, of every contact; added up in double precision where the fields are."""
    patch, z = seen.skin.patch, double(seen.height_mm)
    f_x, f_y = (double(seen.shear_mpa[:, axis]) * patch.cell_mm2 for axis in (0, 1))
    f_z = -double(seen.pressure_mpa) * patch.cell_mm2
    x, y = (
        double(place) + expand_over_grid(np.asarray(middle), z)
        for place, middle in zip(seen.skin.places_mm, seen.centre_mm, strict=True)
    )
    torques = (y * f_z - z * f_y, z * f_x - x * f_z, x * f_y - y * f_x)
    every = [*(sum_over_grid(force) for force in (f_x, f_y, f_z)), *(sum_over_grid(torque) / 1e3 for torque in torques)]
    return to_numpy(array_namespace_of(z).concat(every, axis=-1))[:, 0, :]


def double(field: Float[Any, "*shape"]) -> Float[Any, "*shape"]:
    """In double precision."""
    xp = array_namespace_of(field)
    return xp.astype(field, xp.float64)

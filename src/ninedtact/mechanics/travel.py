"""Skin and object on the way from one step to the next, on a grid that travels with the object."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.normal import Held
from ninedtact.mechanics.per_contact import PerContact, over_grid
from ninedtact.mechanics.pose import Pose, carried_mm
from ninedtact.mechanics.response import Field, Vectors
from ninedtact.mechanics.skin import Skin
from ninedtact.mechanics.touch import Contact
from ninedtact.mechanics.transform import field_of, spectrum


@dataclass(frozen=True)
class Meeting:
    """An object on its way into the skin."""

    pose: Pose
    held: Held
    overlap_mm: Field
    """How far the object reaches into the untouched skin."""
    carried_mm: Vectors
    """Where the skin's points come to if all that touched stick."""
    pressure_mpa: Field
    """Of the step before, a first guess, as is the shear."""
    shear_mpa: Vectors

    @property
    def depth_mm(self) -> PerContact:
        """Of the object, as its overlap has it."""
        return 0 * self.overlap_mm[..., :1, :1] + over_grid(self.pose.depth_mm, self.overlap_mm)

    @property
    def deepest_mm(self) -> float:
        """Of the overlap; the largest of a batch."""
        return float(library_of(self.overlap_mm).max(self.overlap_mm))


def meeting(last: Contact, indenter: Indenter, pose: Pose, held: Held) -> Meeting:
    """The object where it goes, over skin whose points it carries along as if all that touched stuck."""
    overlap = -indenter.over_skin_mm(replace(pose, x_mm=0.0, y_mm=0.0), *last.skin.places_mm)
    carried, pressure, shear = carried_along(last, pose), last.pressure_mpa, last.shear_mpa
    overlap, pressure = (for_each(pose, field, axes=2) for field in (overlap, pressure))
    carried, shear = (for_each(pose, vectors, axes=3) for vectors in (carried, shear))
    return Meeting(pose, held, overlap, carried, pressure, shear)


def for_each(pose: Pose, field: Any, axes: int) -> Any:
    """One field for every pose of a batch, also where there is one for all."""
    return library_of(field).broadcast_to(field, (*pose.batch_shape, *field.shape[-axes:]))


def carried_along(last: Contact, pose: Pose) -> Vectors:
    """Tangential displacement of the skin at every point of the new grid, if all that touched stuck.

    A point that touched keeps its grid point and has moved with the object. A point that did not keeps its place on the
    sensor, so it is another point of the grid now. Twists turn no fields, since one step turns but little.
    """
    if not last.touches:
        return last.moved_mm
    by = pose.x_mm - last.pose.x_mm, pose.y_mm - last.pose.y_mm
    free = shifted(last.skin, last.moved_mm, by) if any(map(np.any, by)) else last.moved_mm
    before, after = replace(last.pose, x_mm=0.0, y_mm=0.0), replace(pose, x_mm=by[0], y_mm=by[1])
    stuck = last.moved_mm + carried_mm(before, after, last.skin.place_mm)
    return library_of(free).where((last.pressure_mpa > 0)[..., None, :, :], stuck, free)


def shifted(skin: Skin, field: Any, by_mm: tuple[Any, Any]) -> Any:
    """A periodic field as it is this much farther along x and y, by the phase of its waves."""
    (k_x, k_y), shape, xp = skin.waves, skin.patch.shape, library_of(field)
    phase = xp.exp(1j * k_x * over_grid(by_mm[0], k_x)) * xp.exp(1j * k_y * over_grid(by_mm[1], k_y))
    return field_of(spectrum(field, shape) * phase[..., None, :, :], shape, shape)

"""What a touch is: tractions on the skin, where they have moved it, and the wrench they add up to.

Fields travel with the object: the middle of their patch lies over the object's origin. They are read in space: a value at
(x, y) is of the skin that is there now, wherever it came from. (Against finite elements that reading is several times
closer than one by the points' old places: docs/mechanics.md.)
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.mechanics.friction import slipping
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.per_contact import Count, Number, on_cpu
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.response import Field, Points, Vectors
from ninedtact.mechanics.skin import Skin
from ninedtact.quantities import Wrench


@dataclass(frozen=True)
class Contact:
    """The skin under one object, or under each of a batch, and how well it was solved."""

    skin: Skin
    pose: Pose
    pressure_mpa: Field
    shear_mpa: Vectors
    """(q_x, q_y), what the object applies to the skin."""
    height_mm: Field
    """u_z: negative where pressed in."""
    moved_mm: Vectors
    """(u_x, u_y) of the skin that is there now."""
    friction: float
    residual_mm: Number = 0.0
    """The largest violation of the contact's conditions: gap under pressure, overlap, or missed stick."""
    iterations: Count = 0
    """Of both solvers, over all turns."""

    @property
    def centre_mm(self) -> tuple[Number, Number]:
        """(x, y) of the sensor over which the middle of the patch lies."""
        return self.pose.x_mm, self.pose.y_mm

    @property
    def touches(self) -> bool:
        """Whether anything is pressed, by any object of a batch."""
        return bool(library_of(self.pressure_mpa).any(self.pressure_mpa > 0))

    @property
    def stuck(self) -> Points:
        """Where the skin moves with the object; what is pressed and not stuck slips."""
        return (self.pressure_mpa > 0) & ~slipping(self.shear_mpa, self.friction * self.pressure_mpa)

    def wrench(self, about_mm: Float64[Array, "3"] | None = None) -> Wrench:
        """What the object applies to the skin, summed over the deformed surface; for one contact, not a batch."""
        force, place = self.cell_forces_n, self.surface_mm
        torque = np.cross(place.reshape(3, -1), force.reshape(3, -1), axis=0).sum(axis=1) / 1e3
        wrench = Wrench(force.sum(axis=(1, 2)), torque)
        return wrench if about_mm is None else wrench.about(about_mm)

    def each(self) -> list["Contact"]:
        """The contacts of a batch, one by one."""
        poses = self.pose.each()
        residuals, counts = (np.broadcast_to(of, len(poses)).tolist() for of in (self.residual_mm, self.iterations))
        fields = zip(self.pressure_mpa, self.shear_mpa, self.height_mm, self.moved_mm, strict=True)
        return [
            Contact(self.skin, pose, *four, self.friction, residual, count)
            for pose, four, residual, count in zip(poses, fields, residuals, counts, strict=True)
        ]

    @property
    def cell_forces_n(self) -> Float64[Array, "*batch 3 rows cols"]:
        """Force on every cell."""
        pressure, shear = on_cpu(self.pressure_mpa), on_cpu(self.shear_mpa)
        return np.concatenate([shear, -pressure[..., None, :, :]], axis=-3) * self.skin.patch.cell_mm2

    @property
    def surface_mm(self) -> Float64[Array, "*batch 3 rows cols"]:
        """(x, y, z) of the skin at every point of the grid, in the sensor's frame."""
        height = on_cpu(self.height_mm)[..., None, :, :]
        x, y = (np.asarray(middle, float)[..., None, None] for middle in self.centre_mm)
        across, along = (place + 0 * height[..., 0, :, :] for place in self.skin.patch.place_mm)
        return np.concatenate([np.stack([across + x, along + y], axis=-3), height], axis=-3)

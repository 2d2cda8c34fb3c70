"""The pose of a rigid object: position and rotation of the object's frame in the sensor's frame.

The object's frame has its origin at the object's lowest point (the first to touch when it comes straight down) and z away
from the skin. The twist about z is applied first, then the tilts about the x and y axes of the sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.errors import InputError
from ninedtact.mechanics.numpy_or_torch_arrays import ScalarPerContact, array_namespace_of, expand_over_grid


class InvalidPose(InputError):
    """Raised for a pose that is not finite, or that would put the object through the gel."""


@checks_arguments
@dataclass(frozen=True)
class Pose:
    """The position of the object's origin in mm and its rotation in rad.

    A batch of poses has arrays (batch,) in place of some or all numbers. Raises `InvalidPose` unless all are finite.
    """

    x_mm: ScalarPerContact = 0.0
    y_mm: ScalarPerContact = 0.0
    depth_mm: ScalarPerContact = 0.0
    """How far the origin is below the undeformed skin, −z; negative above it."""
    twist_rad: ScalarPerContact = 0.0
    tilt_x_rad: ScalarPerContact = 0.0
    tilt_y_rad: ScalarPerContact = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.isfinite(value).all():
                raise InvalidPose(expected=f"a finite {name}", got=f"{value}", remedy="correct the pose")

    @cached_property
    def rotation(self) -> Float[Array, "*batch 3 3"]:
        """The rotation matrix, whose columns are the object's axes in the sensor's frame."""
        turned = (
            _rotation_about_axis(1, self.tilt_y_rad)
            @ _rotation_about_axis(0, self.tilt_x_rad)
            @ _rotation_about_axis(2, self.twist_rad)
        )
        return np.broadcast_to(turned, (*self.batch_shape, 3, 3))

    @property
    def origin_mm(self) -> Float[Array, "*batch 3"]:
        """The (x, y, z) of the object's origin in the sensor's frame."""
        place = np.broadcast_arrays(self.x_mm, self.y_mm, -np.asarray(self.depth_mm, float), np.zeros(self.batch_shape))
        return np.stack(place[:3], axis=-1)

    @cached_property
    def batch_shape(self) -> tuple[int, ...]:
        """The shape (batch,) of a batch of poses, or () of a single pose."""
        return np.broadcast_shapes(*(np.shape(getattr(self, field.name)) for field in fields(self)))

    @property
    def is_level(self) -> bool:
        """Whether the object is not tilted; for a batch, whether no object is."""
        return not (np.any(self.tilt_x_rad) or np.any(self.tilt_y_rad))

    @checks_arguments
    def interpolate(self, other: "Pose", part: float) -> "Pose":
        """Return the pose at this part, 0 to 1, of the way to another pose."""
        pairs = ((name.name, getattr(self, name.name), getattr(other, name.name)) for name in fields(self))
        return Pose(**{name: start + part * (end - start) for name, start, end in pairs})

    def unstack(self) -> list["Pose"]:
        """Return the poses of a batch as single poses."""
        numbers = np.broadcast_arrays(*(np.atleast_1d(getattr(self, field.name)) for field in fields(self)))
        return [Pose(*one) for one in np.stack(numbers, axis=-1).astype(float).tolist()]

    @staticmethod
    def from_frame(origin_mm: Float[Array, "*batch 3"], rotation: Float[Array, "*batch 3 3"]) -> "Pose":
        """Return the pose of an object whose frame has this origin and, as columns, these axes in the sensor's frame."""
        x_mm, y_mm, z_mm = (origin_mm[..., axis] for axis in range(3))
        tilt_x = -np.arcsin(np.clip(rotation[..., 1, 2], -1, 1))
        twist = np.arctan2(rotation[..., 1, 0], rotation[..., 1, 1])
        tilt_y = np.arctan2(rotation[..., 0, 2], rotation[..., 2, 2])
        numbers = x_mm, y_mm, -z_mm, twist, tilt_x, tilt_y
        return Pose(*numbers) if origin_mm.ndim > 1 else Pose(*map(float, numbers))

    @staticmethod
    @checks_arguments
    def stack(poses: Sequence["Pose"]) -> "Pose":
        """Return single poses as one batch."""
        return Pose(*np.array([[getattr(pose, field.name) for field in fields(Pose)] for pose in poses], float).T)


def _rotation_about_axis(axis: int, angle_rad: ScalarPerContact) -> Float[Array, "*batch 3 3"]:
    """Return the right-handed rotation about a coordinate axis (0, 1 or 2)."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*np.shape(angle_rad), 3, 3))
    matrix[..., axis, axis] = 1
    matrix[..., first, first] = matrix[..., second, second] = np.cos(angle_rad)
    matrix[..., second, first] = np.sin(angle_rad)
    matrix[..., first, second] = -matrix[..., second, first]
    return matrix


def rigid_displacement_mm(before: Pose, after: Pose, positions_mm: Any) -> Any:
    """Return how far (x, y) the points of a rigid object move between two poses, in mm.

    positions_mm: where the points are in the skin's plane before, (…, 2, rows, cols). The result has the same shape, with the
    batch of the poses.
    """
    step = after.rotation @ np.swapaxes(before.rotation, -1, -2)
    turned = step[..., :2, :2] - np.eye(2)
    # A point of the plane lies above the object's origin by the depth, which matters only for tilts.
    shift = (after.origin_mm - before.origin_mm)[..., :2] + step[..., :2, 2] * np.asarray(before.depth_mm)[..., None]
    x = positions_mm[..., 0, :, :] - expand_over_grid(before.x_mm, positions_mm)
    y = positions_mm[..., 1, :, :] - expand_over_grid(before.y_mm, positions_mm)
    rows = [[*(turned[..., row, col] for col in (0, 1)), shift[..., row]] for row in (0, 1)]
    rows = [[expand_over_grid(number, positions_mm) for number in row] for row in rows]
    return array_namespace_of(positions_mm).stack([by_x * x + by_y * y + by for by_x, by_y, by in rows], axis=-3)

"""Where a rigid object is: its own frame in the sensor's.

The object's frame has its origin at the object's lowest point (the first to touch when it comes straight down) and z away
from the skin. Tilts turn about the sensor's x and y axes, the twist, about z, comes first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.mechanics.batching import ScalarPerContact, expand_over_grid


class InvalidPose(InputError):
    """A place where no object can be, or none that this skin can answer for."""


@dataclass(frozen=True)
class Pose:
    """Position of the object's origin, mm, and its turn, rad.

    A batch of poses has arrays (batch,) in place of some or all numbers. Raises `InvalidPose` unless all are finite.
    """

    x_mm: ScalarPerContact = 0.0
    y_mm: ScalarPerContact = 0.0
    depth_mm: ScalarPerContact = 0.0
    """How far the origin is below the untouched skin, −z; negative above it."""
    twist_rad: ScalarPerContact = 0.0
    tilt_x_rad: ScalarPerContact = 0.0
    tilt_y_rad: ScalarPerContact = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.isfinite(value).all():
                raise InvalidPose(f"expected a finite {name}, got {value}; correct the pose")

    @cached_property
    def rotation(self) -> Float[Array, "*batch 3 3"]:
        """Columns are the object's axes in the sensor's frame."""
        turned = (
            _rotation_about_axis(1, self.tilt_y_rad)
            @ _rotation_about_axis(0, self.tilt_x_rad)
            @ _rotation_about_axis(2, self.twist_rad)
        )
        return np.broadcast_to(turned, (*self.batch_shape, 3, 3))

    @property
    def origin_mm(self) -> Float[Array, "*batch 3"]:
        """The object's origin in the sensor's frame."""
        place = np.broadcast_arrays(self.x_mm, self.y_mm, -np.asarray(self.depth_mm, float), np.zeros(self.batch_shape))
        return np.stack(place[:3], axis=-1)

    @cached_property
    def batch_shape(self) -> tuple[int, ...]:
        """(batch,), or () for a single pose."""
        return np.broadcast_shapes(*(np.shape(getattr(self, field.name)) for field in fields(self)))

    @property
    def level(self) -> bool:
        """Whether the object is not tilted; in a batch, whether none is."""
        return not (np.any(self.tilt_x_rad) or np.any(self.tilt_y_rad))

    def towards(self, other: "Pose", part: float) -> "Pose":
        """The pose this part of the way to another."""
        pairs = ((name.name, getattr(self, name.name), getattr(other, name.name)) for name in fields(self))
        return Pose(**{name: start + part * (end - start) for name, start, end in pairs})

    def each(self) -> list["Pose"]:
        """The poses of a batch, one by one."""
        numbers = np.broadcast_arrays(*(np.atleast_1d(getattr(self, field.name)) for field in fields(self)))
        return [Pose(*one) for one in np.stack(numbers, axis=-1).astype(float).tolist()]

    @staticmethod
    def batch(poses: Sequence["Pose"]) -> "Pose":
        """Single poses as one batch."""
        return Pose(*np.array([[getattr(pose, field.name) for field in fields(Pose)] for pose in poses], float).T)


def _rotation_about_axis(axis: int, angle_rad: ScalarPerContact) -> Float[Array, "*batch 3 3"]:
    """Rotation about a coordinate axis, right-handed."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*np.shape(angle_rad), 3, 3))
    matrix[..., axis, axis] = 1
    matrix[..., first, first] = matrix[..., second, second] = np.cos(angle_rad)
    matrix[..., second, first] = np.sin(angle_rad)
    matrix[..., first, second] = -matrix[..., second, first]
    return matrix


def rigid_displacement_mm(before: Pose, after: Pose, place_mm: Any) -> Any:
    """How far (x, y) the points of a rigid object at these places of the skin's plane move between two poses.

    place_mm: (…, 2, rows, cols); the result has the same shape, with the batch of the poses.
    """
    step = after.rotation @ np.swapaxes(before.rotation, -1, -2)
    turned = step[..., :2, :2] - np.eye(2)
    # A point of the plane stands origin depth above the object's origin, which matters for tilts alone.
    shift = (after.origin_mm - before.origin_mm)[..., :2] + step[..., :2, 2] * np.asarray(before.depth_mm)[..., None]
    x = place_mm[..., 0, :, :] - expand_over_grid(before.x_mm, place_mm)
    y = place_mm[..., 1, :, :] - expand_over_grid(before.y_mm, place_mm)
    rows = [[*(turned[..., row, col] for col in (0, 1)), shift[..., row]] for row in (0, 1)]
    rows = [[expand_over_grid(number, place_mm) for number in row] for row in rows]
    return array_namespace_of(place_mm).stack([by_x * x + by_y * y + by for by_x, by_y, by in rows], axis=-3)

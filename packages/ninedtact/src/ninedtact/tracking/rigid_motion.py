"""Rigid motions in the sensor's frame, and how errors of one are moved to another place and time.

An error of a motion is six numbers: the displacement of a given point of the object in mm, then a small rotation vector in rad,
both in the axes of the sensor after the motion.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

Covariance = Float[Array, "6 6"]


@dataclass(frozen=True)
class RigidMotion:
    """The motion p → R·p + t of the points of a rigid object."""

    rotation: Float[Array, "3 3"] = field(default_factory=lambda: np.eye(3))
    translation_mm: Float[Array, "3"] = field(default_factory=lambda: np.zeros(3))

    def __call__(self, points_mm: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Return the points after the motion."""
        return np.asarray(points_mm @ self.rotation.T + self.translation_mm)

    def after(self, earlier: "RigidMotion") -> "RigidMotion":
        """Return the motion that an earlier one and this one make together."""
        return RigidMotion(self.rotation @ earlier.rotation, self(earlier.translation_mm))

    @property
    def inverse(self) -> "RigidMotion":
        """The inverse motion."""
        return RigidMotion(self.rotation.T, -self.rotation.T @ self.translation_mm)

    @property
    def rotation_vector_rad(self) -> Float[Array, "3"]:
        """Axis of the rotation times its angle in rad, at most π."""
        return np.asarray(Rotation.from_matrix(self.rotation).as_rotvec())

    @property
    def yaw_rad(self) -> float:
        """Angle of the rotation about the sensor's z axis, −π to π, whatever the object was tilted."""
        return float(np.arctan2(self.rotation[1, 0] - self.rotation[0, 1], self.rotation[0, 0] + self.rotation[1, 1]))

    def perturbed(self, about_mm: Float[Array, "3"], error: Float[Array, "6"]) -> "RigidMotion":
        """Return the motion followed by a small one that displaces `about_mm`, a point after the motion, and turns about it."""
        turn = cv2.Rodrigues(error[3:])[0]
        rotation = turn @ self.rotation
        # Rounding errors of a product of many rotations would double from image to image.
        rotation = rotation @ (3 * np.eye(3) - rotation.T @ rotation) / 2
        return RigidMotion(rotation, turn @ (self.translation_mm - about_mm) + about_mm + error[:3])

    def difference(self, other: "RigidMotion", point_mm: Float[Array, "3"]) -> Float[Array, "6"]:
        """Return the error of this motion if the other is true, at a point of the object before the motion."""
        turn = Rotation.from_matrix(self.rotation @ other.rotation.T).as_rotvec()
        return np.concatenate([self(point_mm) - other(point_mm), turn])


def move_error(covariance: Covariance, from_mm: Float[Array, "3"], to_mm: Float[Array, "3"]) -> Covariance:
    """Return the covariance of an error that is stated at one point of the object at another one."""
    x, y, z = (to_mm - from_mm).tolist()
    shift = np.eye(6)
    shift[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # error + rotation × (to − from)
    return np.asarray(shift @ covariance @ shift.T)


def turn_error(covariance: Covariance, rotation: Float[Array, "3 3"]) -> Covariance:
    """Return the covariance of an error after the object has turned further."""
    both = np.kron(np.eye(2), rotation)
    return np.asarray(both @ covariance @ both.T)

"""The depth at which the camera's lines of sight meet a ball that is pressed into the skin.

The camera stands `distance_mm` below the middle of the skin; the line through a point of the untouched plane is followed
until it meets the sphere that cuts the plane in the contact circle. (The refraction on the way is in the lens model and
in the distance; what that leaves open is in docs/accuracy.md.)
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.shape.rectification import skin_grid_mm


def seen_depth_mm(
    shape: tuple[int, int],
    mm_per_px: float,
    centre_mm: tuple[float, float],
    edge_radius_mm: float,
    ball_radius_mm: float,
    camera_distance_mm: float,
) -> Float[Array, "rows cols"]:
    """Depth of the ball's surface on every pixel's line of sight, zero where the line misses the disc."""
    camera = np.array([0.0, 0.0, -camera_distance_mm])
    ball = np.array([*centre_mm, np.sqrt(ball_radius_mm**2 - edge_radius_mm**2)])
    x, y = skin_grid_mm(shape, mm_per_px)
    sight = np.stack([x, y, np.full_like(x, camera_distance_mm)], axis=-1).astype(float)
    part = first_meeting(camera - ball, sight, ball_radius_mm)
    return np.maximum(camera_distance_mm * (1 - part), 0)


def first_meeting(
    start: Float[Array, "3"], sight: Float[Array, "rows cols 3"], radius: float
) -> Float[Array, "rows cols"]:
    """The smaller t at which start + t·sight lies on the sphere about zero; 1 (the plane) where it never does."""
    square, product = (sight**2).sum(axis=-1), sight @ start
    discriminant = product**2 - square * (start @ start - radius**2)
    return np.where(discriminant > 0, (-product - np.sqrt(np.maximum(discriminant, 0))) / square, 1)

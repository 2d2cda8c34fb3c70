"""Signed distances in mm to shapes in the plane (negative inside), and height fields made from them."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.simulation.objects.grid_and_dimension_sampler import Heightfield

Points = Float[Array, "points 2"]


def box_sdf(x: Heightfield, y: Heightfield, length_mm: float, width_mm: float, corner_mm: float = 0.0) -> Heightfield:
    """Return the signed distance to a rectangle with rounded corners."""
    beyond_x = np.abs(x) - length_mm / 2 + corner_mm
    beyond_y = np.abs(y) - width_mm / 2 + corner_mm
    outside = np.hypot(np.maximum(beyond_x, 0), np.maximum(beyond_y, 0))
    return outside + np.minimum(np.maximum(beyond_x, beyond_y), 0) - corner_mm


def polygon_sdf(x: Heightfield, y: Heightfield, points: Points) -> Heightfield:
    """Return the signed distance to a closed polygon, with the even-odd rule; the last point joins the first."""
    nearest, inside = np.full(x.shape, np.inf), np.zeros(x.shape, bool)
    for (ax, ay), (bx, by) in zip(points.tolist(), np.roll(points, -1, axis=0).tolist(), strict=True):
        nearest = np.minimum(nearest, segment_sdf(x, y, (ax, ay), (bx, by)))
        if ay != by:
            crossing = ((ay > y) != (by > y)) & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
            inside ^= crossing
    return np.where(inside, -nearest, nearest)


def segment_sdf(x: Heightfield, y: Heightfield, start: tuple[float, float], end: tuple[float, float]) -> Heightfield:
    """Return the distance to a line segment."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    along = ((x - start[0]) * dx + (y - start[1]) * dy) / max(dx**2 + dy**2, 1e-12)
    along = np.clip(along, 0, 1)
    return np.hypot(x - start[0] - along * dx, y - start[1] - along * dy)


def polyline_sdf(x: Heightfield, y: Heightfield, points: Points) -> Heightfield:
    """Return the distance to a polyline."""
    pairs = zip(points[:-1].tolist(), points[1:].tolist(), strict=True)
    return np.minimum.reduce([segment_sdf(x, y, (a[0], a[1]), (b[0], b[1])) for a, b in pairs])


def polygon_corners(corners: int, radius_mm: float, turn_rad: float = 0.0) -> Points:
    """Return the corners of a regular polygon."""
    angle = turn_rad + np.arange(corners) * 2 * np.pi / corners
    return radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def wrap_to_pitch(place: Heightfield, pitch_mm: float) -> Heightfield:
    """Return a coordinate relative to the centre of the nearest repeat."""
    return place - pitch_mm * np.round(place / pitch_mm)


def flat_face(distance: Heightfield, edge_mm: float = 0.2) -> Heightfield:
    """Return a flat face at height zero with this outline and a rounded edge; infinite outside."""
    over = np.clip(distance + edge_mm, 0, edge_mm)
    return np.where(distance > 0, np.inf, edge_mm - np.sqrt(edge_mm**2 - over**2))


def raise_outside(distance: Heightfield, height_mm: float, flank_mm: float = 0.3) -> Heightfield:
    """Return zero inside the outline and a height outside, with a smooth flank that starts at the outline."""
    part = np.clip(distance / flank_mm, 0, 1)
    return height_mm * part**2 * (3 - 2 * part)


def recess_heights(distance: Heightfield, depth_mm: float, flank_mm: float = 0.3) -> Heightfield:
    """Return a recess: a depth inside the outline, zero outside."""
    return raise_outside(-distance, depth_mm, flank_mm)


def round_bar_heights(distance: Heightfield, radius_mm: float) -> Heightfield:
    """Return a round bar on the plane along the zero line of a distance; infinite beside it."""
    left = radius_mm**2 - distance**2
    return np.where(left > 0, radius_mm - np.sqrt(np.maximum(left, 0)), np.inf)


def smooth_abs(heights: Heightfield, rounding_mm: float) -> Heightfield:
    """Return |height| with a rounded minimum, zero at zero."""
    return np.sqrt(heights**2 + rounding_mm**2) - rounding_mm

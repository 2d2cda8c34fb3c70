"""The height fields of generated objects: the square grid, the sampler of dimensions, and signed distances to shapes in the plane.

A height field holds mm above the plane that the object touches, and infinity where there is no object. The union of two solids
is the minimum of their fields, their intersection the maximum. Signed distances are in mm, negative inside.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from zlib import crc32

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

Heightfield = Float[Array, "rows cols"]

GOLDEN = (5**0.5 - 1) / 2
ROOTS = (GOLDEN, *(root % 1 for root in np.sqrt([2, 3, 7, 11, 13, 17, 19, 23]).tolist()))
"""Steps of the dimensions from one object of a family to the next; multiples of these fill an interval evenly."""
ROUNDING_MM = 0.07
"""Standard deviation of the smoothing that gives every edge a radius of at least 0.1 mm."""


@dataclass(frozen=True)
class CoordinateGrid:
    """The coordinates (x, y, distance, angle) of the points of a square grid centred on the object's origin."""

    side_mm: float = 22.0
    pitch_mm: float = 0.1

    @cached_property
    def x(self) -> Heightfield:
        """x of every grid point in mm; it grows along the columns."""
        samples = round(self.side_mm / self.pitch_mm) + 1
        axis = (np.arange(samples) - (samples - 1) / 2) * self.pitch_mm
        return np.broadcast_to(axis, (samples, samples))

    @cached_property
    def y(self) -> Heightfield:
        """y of every grid point in mm; it grows along the rows."""
        return self.x.T

    @cached_property
    def r(self) -> Heightfield:
        """Distance of every grid point from the origin in mm."""
        return np.hypot(self.x, self.y)

    @cached_property
    def angle(self) -> Heightfield:
        """Polar angle of every grid point, −π to π rad."""
        return np.arctan2(self.y, self.x)

    def rotated_axes(self, angle_rad: float) -> tuple[Heightfield, Heightfield]:
        """Return x and y of every grid point in a frame rotated by an angle."""
        cos, sin = np.cos(angle_rad), np.sin(angle_rad)
        return cos * self.x + sin * self.y, cos * self.y - sin * self.x

    def smooth(self, heights: Heightfield, sigma_mm: float = ROUNDING_MM) -> Heightfield:
        """Return a height field with its edges rounded and its footprint unchanged."""
        from scipy.ndimage import gaussian_filter

        seen, sigma = np.isfinite(heights), sigma_mm / self.pitch_mm
        weight = np.maximum(gaussian_filter(seen.astype(float), sigma), 1e-6)
        return np.where(seen, gaussian_filter(np.where(seen, heights, 0.0), sigma) / weight, np.inf)


class DimensionSampler:
    """Samples the dimensions of one object, one per call, from its seed, family and number alone.

    Successive objects of a family differ most in the dimension that is sampled first.
    """

    def __init__(self, seed: int, family: str, number: int) -> None:
        self.number = number
        self.start = np.random.default_rng([seed, crc32(family.encode())])
        self.random = np.random.default_rng([seed, crc32(family.encode()), number])
        """Generator for all that is not a dimension: noise, scattered positions, letters."""
        self.count = 0

    def fraction(self) -> float:
        """Sample the next number from 0 to 1."""
        step = ROOTS[self.count % len(ROOTS)]
        self.count += 1
        return float((self.start.random() + self.number * step) % 1)

    def between(self, low: float, high: float) -> float:
        """Sample a dimension between two limits."""
        return low + (high - low) * self.fraction()

    def integer(self, low: int, high: int) -> int:
        """Sample an integer between two limits, both included."""
        return low + int(self.fraction() * (high - low + 1))

    def scatter(self, count: int, radius_mm: float) -> Float[Array, "count 2"]:
        """Sample positions in a disc that keep apart: each is the most isolated of eight candidates (Mitchell's algorithm)."""
        places = [np.zeros(2)]
        for _ in range(count - 1):
            angle, far = self.random.random(8) * 2 * np.pi, radius_mm * np.sqrt(self.random.random(8))
            tries = np.stack([far * np.cos(angle), far * np.sin(angle)], axis=1)
            lonely = np.linalg.norm(tries[:, None] - np.array(places), axis=2).min(axis=1)
            places.append(tries[lonely.argmax()])
        return np.array(places)


HeightfieldFunction = Callable[[DimensionSampler, CoordinateGrid], Heightfield]
"""A family of objects: the heights of one object, from the dimensions that it samples."""


Points = Float[Array, "points 2"]


def rounded_rectangle_sdf(
    x: Heightfield, y: Heightfield, length_mm: float, width_mm: float, corner_mm: float = 0.0
) -> Heightfield:
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


def heights_raised_outside(distance: Heightfield, height_mm: float, flank_mm: float = 0.3) -> Heightfield:
    """Return zero inside the outline and a height outside, with a smooth flank that starts at the outline."""
    part = np.clip(distance / flank_mm, 0, 1)
    return height_mm * part**2 * (3 - 2 * part)


def recess_heights(distance: Heightfield, depth_mm: float, flank_mm: float = 0.3) -> Heightfield:
    """Return a recess: a depth inside the outline, zero outside."""
    return heights_raised_outside(-distance, depth_mm, flank_mm)


def round_bar_heights(distance: Heightfield, radius_mm: float) -> Heightfield:
    """Return a round bar on the plane along the zero line of a distance; infinite beside it."""
    left = radius_mm**2 - distance**2
    return np.where(left > 0, radius_mm - np.sqrt(np.maximum(left, 0)), np.inf)


def smooth_abs(heights: Heightfield, rounding_mm: float) -> Heightfield:
    """Return |height| with a rounded minimum, zero at zero."""
    return np.sqrt(heights**2 + rounding_mm**2) - rounding_mm

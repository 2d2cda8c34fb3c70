"""Simple solids and unions of them as height grids: balls, cylinders, cones, pyramids, tori and others.

To add a solid, write its function and list it in `SOLIDS`.
"""

import numpy as np

from ninedtact.simulation.objects.grid_and_dimension_sampler import (
    DimensionSampler,
    Heightfield,
    HeightfieldFunction,
    HeightGrid,
)
from ninedtact.simulation.objects.signed_distance import (
    box_sdf,
    flat_face,
    polygon_corners,
    polygon_sdf,
    raise_outside,
    round_bar_heights,
    segment_sdf,
    smooth_abs,
)


def _ball(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a sphere."""
    return round_bar_heights(grid.r, sample.between(2, 8))


def _ellipsoid(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of an ellipsoid with three different axes."""
    x, y = grid.rotated_axes(sample.between(0, np.pi))
    length, width, height = sample.between(4, 9), sample.between(2, 4), sample.between(2, 6)
    return height * round_bar_heights(np.hypot(x / length, y / width), 1.0)


def _cylinder(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a cylinder that lies on its side."""
    radius, length = sample.between(1.5, 7), sample.between(8, 19)
    x, y = grid.rotated_axes(sample.between(0, np.pi))
    return round_bar_heights(y, radius) + flat_face(box_sdf(x, y, length, 2 * radius), 0.3)


def _capsule(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a rod with round ends, or of two rods joined at an angle."""
    radius, half, bend = sample.between(1, 3.5), sample.between(3, 6), sample.between(-1.2, 1.2)
    arm = segment_sdf(grid.x, grid.y, (0.0, 0.0), (-half, 0.0))
    other = segment_sdf(grid.x, grid.y, (0.0, 0.0), (half * np.cos(bend), half * np.sin(bend)))
    return round_bar_heights(np.minimum(arm, other), radius)


def _cone(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a cone on its blunt tip."""
    slope, radius = np.tan(sample.between(0.3, 1.1)), sample.between(3, 8)
    return slope * smooth_abs(grid.r, sample.between(0.3, 1.2)) + flat_face(grid.r - radius)


def _frustum(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a cone with a flat or hollow end."""
    face, slope, radius = sample.between(0.8, 4), np.tan(sample.between(0.3, 1.0)), sample.between(5, 8)
    return slope * smooth_abs(np.maximum(grid.r - face, 0), 0.2) + flat_face(grid.r - radius)


def _pyramid(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a pyramid with three to six sides, on its tip."""
    sides, slope, radius = sample.integer(3, 6), np.tan(sample.between(0.25, 0.9)), sample.between(4, 8)
    normals = polygon_corners(sides, 1.0, sample.between(0, np.pi))
    across = np.maximum.reduce([nx * grid.x + ny * grid.y for nx, ny in normals.tolist()])
    return slope * smooth_abs(across, 0.3) + flat_face(across - radius)


def _wedge(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a wedge: an edge that is straight or bent along its length."""
    slope, length, bend = np.tan(sample.between(0.3, 1.0)), sample.between(8, 18), sample.between(-0.06, 0.06)
    return slope * smooth_abs(grid.y - bend * grid.x**2, 0.3) + flat_face(box_sdf(grid.x, grid.y, length, 10, 0.5))


def _cross_roof(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a crossed roof: edges that meet in the middle."""
    arms, slope, turn = sample.integer(3, 5), np.tan(sample.between(0.4, 1.0)), sample.between(0, 1)
    ends = polygon_corners(arms, sample.between(5.5, 7.5), turn)
    ridges = [segment_sdf(grid.x, grid.y, (0.0, 0.0), (x, y)) for x, y in ends.tolist()]
    nearest = np.minimum.reduce(ridges)
    return slope * smooth_abs(nearest, 0.3) + flat_face(nearest - 2.5)


def _torus(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a torus with a round section, whose ring is round or oval."""
    tube, radius = sample.between(0.6, 2.2), sample.between(3, 7)
    return round_bar_heights(np.hypot(grid.x, grid.y * sample.between(1, 1.6)) - radius, tube)


def _saddle(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a saddle: bent down along one axis and up along the other."""
    x, y = grid.rotated_axes(sample.between(0, np.pi))
    waves, height = sample.integer(2, 4), sample.between(0.6, 1.5)
    angle = np.arctan2(y, x)
    return height * (grid.r / 6) ** 2 * (1 + np.cos(waves * angle)) + flat_face(grid.r - sample.between(5, 8), 0.4)


def _ziggurat(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of steps around a round, square or six-sided face."""
    sides, steps, tread = sample.integer(3, 7), sample.integer(2, 4), sample.between(0.9, 1.8)
    outline = polygon_sdf(grid.x, grid.y, polygon_corners(sides, sample.between(1.5, 3), sample.between(0, 1)))
    stairs = [raise_outside(outline - tread * step, sample.between(0.3, 0.8)) for step in range(steps)]
    return np.sum(stairs, axis=0) + flat_face(outline - tread * (steps + 0.3))


def _limpet(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a limpet shell: a ribbed cone."""
    ribs, slope, radius = sample.integer(6, 16), sample.between(0.25, 0.7), sample.between(5, 8)
    rib = sample.between(0.2, 0.45) * np.minimum(grid.r / 3, 1) * (1 - np.cos(ribs * grid.angle))
    return slope * smooth_abs(grid.r, 0.8) + rib + flat_face(grid.r - radius + rib)


def _pebbles(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of pebbles: balls of different sizes at different heights."""
    count, largest, spread = sample.integer(4, 14), sample.between(1.2, 2.6), sample.between(3, 6.5)
    sizes = largest * sample.random.uniform(0.45, 1, count)
    lift = sample.random.uniform(0, 0.5, count)
    places = sample.scatter(count, spread)
    rows = zip(places.tolist(), sizes.tolist(), lift.tolist(), strict=True)
    return np.minimum.reduce(
        [up + round_bar_heights(np.hypot(grid.x - x, grid.y - y), size) for (x, y), size, up in rows]
    )


def _caltrop(sample: DimensionSampler, grid: HeightGrid) -> Heightfield:
    """Return the heights of a plate with cones of different heights."""
    count, height, spread = sample.integer(3, 8), sample.between(1, 2.5), sample.between(3, 5.5)
    lift = sample.random.uniform(0, 0.6, count)
    slope = sample.between(0.8, 1.6)
    cones = [
        up + slope * smooth_abs(np.hypot(grid.x - x, grid.y - y), 0.4)
        for (x, y), up in zip(sample.scatter(count, spread).tolist(), lift.tolist(), strict=True)
    ]
    return np.minimum(np.minimum.reduce(cones), height) + flat_face(grid.r - spread - 2)


SOLIDS: dict[str, HeightfieldFunction] = {
    "ball": _ball,
    "ellipsoid": _ellipsoid,
    "cylinder": _cylinder,
    "capsule": _capsule,
    "cone": _cone,
    "frustum": _frustum,
    "pyramid": _pyramid,
    "wedge": _wedge,
    "cross_roof": _cross_roof,
    "torus": _torus,
    "saddle": _saddle,
    "ziggurat": _ziggurat,
    "limpet": _limpet,
    "pebbles": _pebbles,
    "caltrop": _caltrop,
}

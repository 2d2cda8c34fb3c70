"""Simple solids and unions of them as height grids (balls, cylinders, cones, pyramids, tori and others), and punches: flat faces
with outlines of many kinds.

To add a solid, write its function and list it in `SOLIDS`; to add a punch, in `PUNCHES`.
"""

import numpy as np

from ninedtact.simulation.objects.height_fields import (
    CoordinateGrid,
    DimensionSampler,
    Heightfield,
    HeightfieldFunction,
    Points,
    flat_face,
    heights_raised_outside,
    polygon_corners,
    polygon_sdf,
    polyline_sdf,
    recess_heights,
    round_bar_heights,
    rounded_rectangle_sdf,
    segment_sdf,
    smooth_abs,
)


def _ball(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    return round_bar_heights(grid.r, sample.between(2, 8))


def _ellipsoid(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of an ellipsoid with three different axes."""
    x, y = grid.rotated_axes(sample.between(0, np.pi))
    length, width, height = sample.between(4, 9), sample.between(2, 4), sample.between(2, 6)
    return height * round_bar_heights(np.hypot(x / length, y / width), 1.0)


def _cylinder(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a cylinder that lies on its side."""
    radius, length = sample.between(1.5, 7), sample.between(8, 19)
    x, y = grid.rotated_axes(sample.between(0, np.pi))
    return round_bar_heights(y, radius) + flat_face(rounded_rectangle_sdf(x, y, length, 2 * radius), 0.3)


def _capsule(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a rod with round ends, or of two rods joined at an angle."""
    radius, half, bend = sample.between(1, 3.5), sample.between(3, 6), sample.between(-1.2, 1.2)
    arm = segment_sdf(grid.x, grid.y, (0.0, 0.0), (-half, 0.0))
    other = segment_sdf(grid.x, grid.y, (0.0, 0.0), (half * np.cos(bend), half * np.sin(bend)))
    return round_bar_heights(np.minimum(arm, other), radius)


def _cone(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a cone on its blunt tip."""
    slope, radius = np.tan(sample.between(0.3, 1.1)), sample.between(3, 8)
    return slope * smooth_abs(grid.r, sample.between(0.3, 1.2)) + flat_face(grid.r - radius)


def _frustum(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a cone with a flat or hollow end."""
    face, slope, radius = sample.between(0.8, 4), np.tan(sample.between(0.3, 1.0)), sample.between(5, 8)
    return slope * smooth_abs(np.maximum(grid.r - face, 0), 0.2) + flat_face(grid.r - radius)


def _pyramid(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a pyramid with three to six sides, on its tip."""
    sides, slope, radius = sample.integer(3, 6), np.tan(sample.between(0.25, 0.9)), sample.between(4, 8)
    normals = polygon_corners(sides, 1.0, sample.between(0, np.pi))
    across = np.maximum.reduce([nx * grid.x + ny * grid.y for nx, ny in normals.tolist()])
    return slope * smooth_abs(across, 0.3) + flat_face(across - radius)


def _wedge(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a wedge: an edge that is straight or bent along its length."""
    slope, length, bend = np.tan(sample.between(0.3, 1.0)), sample.between(8, 18), sample.between(-0.06, 0.06)
    return slope * smooth_abs(grid.y - bend * grid.x**2, 0.3) + flat_face(
        rounded_rectangle_sdf(grid.x, grid.y, length, 10, 0.5)
    )


def _cross_roof(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a crossed roof: edges that meet in the middle."""
    arms, slope, turn = sample.integer(3, 5), np.tan(sample.between(0.4, 1.0)), sample.between(0, 1)
    ends = polygon_corners(arms, sample.between(5.5, 7.5), turn)
    ridges = [segment_sdf(grid.x, grid.y, (0.0, 0.0), (x, y)) for x, y in ends.tolist()]
    nearest = np.minimum.reduce(ridges)
    return slope * smooth_abs(nearest, 0.3) + flat_face(nearest - 2.5)


def _torus(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a torus with a round section, whose ring is round or oval."""
    tube, radius = sample.between(0.6, 2.2), sample.between(3, 7)
    return round_bar_heights(np.hypot(grid.x, grid.y * sample.between(1, 1.6)) - radius, tube)


def _saddle(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a saddle: bent down along one axis and up along the other."""
    x, y = grid.rotated_axes(sample.between(0, np.pi))
    waves, height = sample.integer(2, 4), sample.between(0.6, 1.5)
    angle = np.arctan2(y, x)
    return height * (grid.r / 6) ** 2 * (1 + np.cos(waves * angle)) + flat_face(grid.r - sample.between(5, 8), 0.4)


def _ziggurat(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of steps around a round, square or six-sided face."""
    sides, steps, tread = sample.integer(3, 7), sample.integer(2, 4), sample.between(0.9, 1.8)
    outline = polygon_sdf(grid.x, grid.y, polygon_corners(sides, sample.between(1.5, 3), sample.between(0, 1)))
    stairs = [heights_raised_outside(outline - tread * step, sample.between(0.3, 0.8)) for step in range(steps)]
    return np.sum(stairs, axis=0) + flat_face(outline - tread * (steps + 0.3))


def _limpet(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a limpet shell: a ribbed cone."""
    ribs, slope, radius = sample.integer(6, 16), sample.between(0.25, 0.7), sample.between(5, 8)
    rib = sample.between(0.2, 0.45) * np.minimum(grid.r / 3, 1) * (1 - np.cos(ribs * grid.angle))
    return slope * smooth_abs(grid.r, 0.8) + rib + flat_face(grid.r - radius + rib)


def _pebbles(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of pebbles: balls of different sizes at different heights."""
    count, largest, spread = sample.integer(4, 14), sample.between(1.2, 2.6), sample.between(3, 6.5)
    sizes = largest * sample.random.uniform(0.45, 1, count)
    lift = sample.random.uniform(0, 0.5, count)
    places = sample.scatter(count, spread)
    rows = zip(places.tolist(), sizes.tolist(), lift.tolist(), strict=True)
    return np.minimum.reduce(
        [up + round_bar_heights(np.hypot(grid.x - x, grid.y - y), size) for (x, y), size, up in rows]
    )


def _caltrop(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
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


def _punch(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a round punch, whose edge rounding is from sharp to half of the face."""
    radius = sample.between(2, 7)
    return flat_face(grid.r - radius, radius * sample.between(0.06, 0.5))


def _tile(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a rectangular face."""
    length, width = sample.between(5, 16), sample.between(3, 9)
    return flat_face(
        rounded_rectangle_sdf(*grid.rotated_axes(sample.between(0, np.pi)), length, width, sample.between(0.2, 1.4)),
        sample.between(0.2, 0.8),
    )


def _polygon_punch(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a regular polygon with a round hole."""
    sides, radius = sample.integer(3, 8), sample.between(3, 8)
    outline = polygon_sdf(grid.x, grid.y, polygon_corners(sides, radius, sample.between(0, np.pi)))
    return flat_face(np.maximum(outline, radius * sample.between(0.1, 0.45) - grid.r), 0.25)


def star_corners(points: int, radius_mm: float, waist: float, turn_rad: float) -> Points:
    """Return the corners of a star, tips and waists alternating."""
    tips, waists = (
        polygon_corners(points, radius_mm, turn_rad),
        polygon_corners(points, radius_mm * waist, turn_rad + np.pi / points),
    )
    return np.stack([tips, waists], axis=1).reshape(-1, 2)


def _star(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a star with four to nine points."""
    corners = star_corners(
        sample.integer(4, 9), sample.between(4, 9), sample.between(0.4, 0.7), sample.between(0, np.pi)
    )
    return flat_face(polygon_sdf(grid.x, grid.y, corners) - 0.2, 0.3)


def _cross(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a cross: bars through the middle."""
    arms, width, length = sample.integer(3, 5), sample.between(0.8, 2.2), sample.between(5, 8)
    ends = polygon_corners(arms, length, sample.between(0, np.pi))
    frames = (grid.rotated_axes(float(np.arctan2(y, x))) for x, y in ends.tolist())
    bars = [rounded_rectangle_sdf(*frame, 2 * length, width, 0.2) for frame in frames]
    return flat_face(np.minimum.reduce(bars), 0.3)


def _ring(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of one to three flat concentric rings."""
    rings, width, outer = sample.integer(1, 3), sample.between(0.6, 1.2), sample.between(5, 8.5)
    radii = [outer - 2 * width * step for step in range(rings)]
    return flat_face(np.minimum.reduce([np.abs(grid.r - radius) - width / 2 for radius in radii]), 0.25)


def _crescent(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a crescent: a disc from which another disc is cut."""
    radius, bite = sample.between(4, 8), sample.between(0.55, 0.9)
    x, y = grid.rotated_axes(sample.between(0, 2 * np.pi))
    inner = np.hypot(x - radius * (1.25 - bite), y) - radius * bite
    return flat_face(np.maximum(grid.r - radius, -inner), 0.3)


def _heart(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a heart: two lobes and a tip."""
    size, (x, y) = sample.between(0.3, 0.5), grid.rotated_axes(sample.between(-1, 1))
    t = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    bows = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)
    return flat_face(
        polygon_sdf(x, y, size * np.stack([16 * np.sin(t) ** 3, -bows], axis=1)), sample.between(0.25, 1.5)
    )


def _arrow(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of an arrow: a head on a shaft."""
    length, shaft, head = sample.between(8, 17), sample.between(1, 2.2), sample.between(4, 8)
    tip, neck, wing = length / 2, length / 2 - head * 0.7, head / 2
    half = [[-tip, shaft / 2], [neck, shaft / 2], [neck, wing], [tip, 0]]
    points = np.array([*half, *([px, -py] for px, py in half[-2::-1])])
    return flat_face(polygon_sdf(*grid.rotated_axes(sample.between(0, 2 * np.pi)), points), 0.25)


def _blob(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a face with a smooth closed outline, flat or domed."""
    size, dome = sample.between(3.5, 7), sample.between(0, 1.2)
    orders, phases = np.arange(2, 7), sample.random.uniform(0, 2 * np.pi, 5)
    waves = [np.cos(n * grid.angle + phase) / n for n, phase in zip(orders.tolist(), phases.tolist(), strict=True)]
    outline = grid.r - size * (1 + 0.45 * np.sum(waves, axis=0))
    return dome * (grid.r / size) ** 2 + flat_face(outline, 0.3)


def _profile_bar(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of the end of a rolled bar with an L, T, U, Z or H profile."""
    kind, size, wall = sample.integer(0, 4), sample.between(3, 6.5), sample.between(0.5, 1.1)
    paths = ("00 02 22", "00 20 10 12", "00 02 22 20", "00 10 12 22", "00 02 01 21 20 22")
    points = (np.array([[int(pair[0]), int(pair[1])] for pair in paths[kind].split()], float) - 1) * size
    return flat_face(polyline_sdf(*grid.rotated_axes(sample.between(0, np.pi)), points) - wall, 0.25)


def _pin_array(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of flat pins of different widths."""
    count, width, spread = sample.integer(5, 14), sample.between(0.7, 1.4), sample.between(4, 7)
    radii = width * sample.random.uniform(0.6, 1.2, count)
    places = zip(sample.scatter(count, spread).tolist(), radii.tolist(), strict=True)
    return flat_face(np.minimum.reduce([np.hypot(grid.x - x, grid.y - y) - radius for (x, y), radius in places]), 0.25)


def _slotted_disc(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a disc with slots of different depths from the rim inwards."""
    slots, radius, width = sample.integer(3, 9), sample.between(5, 8), sample.between(0.8, 1.6)
    ends = polygon_corners(slots, radius + 2)
    starts = ends * sample.random.uniform(0.25, 0.6, (slots, 1))
    pairs = zip(starts.tolist(), ends.tolist(), strict=True)
    cuts = np.minimum.reduce([segment_sdf(grid.x, grid.y, (a[0], a[1]), (b[0], b[1])) for a, b in pairs])
    return recess_heights(cuts - width / 2, 1.2) + flat_face(grid.r - radius)


PUNCHES: dict[str, HeightfieldFunction] = {
    "punch": _punch,
    "tile": _tile,
    "polygon_punch": _polygon_punch,
    "star": _star,
    "cross": _cross,
    "ring": _ring,
    "crescent": _crescent,
    "heart": _heart,
    "arrow": _arrow,
    "blob": _blob,
    "profile_bar": _profile_bar,
    "pin_array": _pin_array,
    "slotted_disc": _slotted_disc,
}

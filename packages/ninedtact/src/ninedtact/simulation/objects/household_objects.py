"""Household objects as height grids: leaf, flower, button, toy brick and others.

To add an object, write its function and list it in `HOUSEHOLD_OBJECTS`.
"""

import numpy as np

from ninedtact.simulation.objects.height_fields import (
    CoordinateGrid,
    DimensionSampler,
    Heightfield,
    HeightfieldFunction,
    flat_face,
    heights_raised_outside,
    polygon_corners,
    polyline_sdf,
    recess_heights,
    round_bar_heights,
    rounded_rectangle_sdf,
    smooth_abs,
    wrap_to_pitch,
)


def _leaf(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a leaf: a blade with a midrib and side veins."""
    length, width, veins = sample.between(10, 17), sample.between(4, 9), sample.integer(4, 8)
    along = np.clip(grid.x / length + 0.5, 0, 1)
    blade = np.abs(grid.y) - width / 2 * np.sin(np.pi * along**0.8)
    pitch = length / veins
    side = np.abs(wrap_to_pitch(grid.x - 0.9 * np.abs(grid.y), pitch)) * 0.74 - 0.12
    vein = np.minimum(np.abs(grid.y) - 0.3 * (1.2 - along), side)
    return heights_raised_outside(vein, sample.between(0.3, 0.6), 0.3) + flat_face(
        np.maximum(blade, np.abs(grid.x) - length / 2), 0.15
    )


def _flower(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a flower: domed petals around a bead."""
    petals, radius = sample.integer(4, 9), sample.between(3, 5)
    size = radius * np.sin(np.pi / petals) * sample.between(0.85, 1.1)
    places = polygon_corners(petals, radius).tolist()
    domes = [size * 0.5 * round_bar_heights(np.hypot(grid.x - x, grid.y - y) / size, 1.0) for x, y in places]
    heart = round_bar_heights(grid.r, sample.between(1, 2))
    return np.minimum(np.minimum.reduce(domes) + sample.between(0, 0.4), heart)


def _snowflake(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a snowflake: six arms with side branches."""
    radius, branches, bar = sample.between(6, 9), sample.integer(1, 3), sample.between(0.35, 0.6)
    turn = wrap_to_pitch(grid.angle, np.pi / 3)
    x, y = grid.r * np.cos(turn), grid.r * np.abs(np.sin(turn))
    arms = [polyline_sdf(x, y, np.array([[0.0, 0.0], [radius, 0.0]]))]
    for at in np.linspace(0.35, 0.8, branches).tolist():
        reach = radius * (1 - at) * sample.between(0.6, 1.1) + 0.4
        arms.append(polyline_sdf(x, y, np.array([[at * radius, 0.0], [at * radius + reach / 2, reach * 0.8]])))
    return flat_face(np.minimum.reduce(arms) - bar, 0.25)


def _button(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a button: a rim and two to five holes."""
    holes, radius = sample.integer(2, 5), sample.between(4.5, 8.5)
    outline = grid.r - radius
    for x, y in polygon_corners(holes, 0.28 * radius).tolist():
        outline = np.maximum(outline, 0.13 * radius - np.hypot(grid.x - x, grid.y - y))
    well = recess_heights(grid.r - radius * sample.between(0.55, 0.8), sample.between(0.4, 1), 0.8)
    return well + flat_face(outline, 0.3)


def _brick(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a toy brick: round studs on a plate."""
    cols, rows, pitch = sample.integer(2, 4), sample.integer(1, 3), sample.between(3, 4.5)
    places = [(col - (cols - 1) / 2, row - (rows - 1) / 2) for col in range(cols) for row in range(rows)]
    studs = np.minimum.reduce([np.hypot(grid.x - pitch * x, grid.y - pitch * y) for x, y in places]) - 0.32 * pitch
    return heights_raised_outside(studs, sample.between(0.8, 1.6), 0.3) + flat_face(
        rounded_rectangle_sdf(grid.x, grid.y, cols * pitch, rows * pitch, 0.3)
    )


def _puzzle(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a piece of a jigsaw puzzle: a knob or a hole on each side."""
    size, knob = sample.between(3, 5), sample.between(0.26, 0.34)
    outline = rounded_rectangle_sdf(grid.x, grid.y, 2 * size, 2 * size, 0.2)
    kinds = sample.random.integers(0, 2, 4).tolist()
    for (x, y), out in zip(polygon_corners(4, 1.0).tolist(), kinds, strict=True):
        reach = size * (1 + (knob if out else -knob) * 0.75)
        disc = np.hypot(grid.x - reach * x, grid.y - reach * y) - knob * size
        outline = np.minimum(outline, disc) if out else np.maximum(outline, -disc)
    return flat_face(outline, 0.25)


def _paw(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a paw: a pad and toes."""
    toes, size = sample.integer(3, 5), sample.between(2.4, 3.6)
    pad = 2 * round_bar_heights(np.hypot(grid.x / size, (grid.y - 2) / (0.85 * size)), 1.0)
    angles = np.linspace(-1, 1, toes) * sample.between(0.8, 1.1) - np.pi / 2
    toe = [
        1.2
        * round_bar_heights(
            np.hypot(grid.x - 1.75 * size * np.cos(a), grid.y - 2 - 1.75 * size * np.sin(a)) / (0.4 * size), 1.0
        )
        for a in angles.tolist()
    ]
    return np.minimum(pad, np.minimum.reduce(toe) + sample.between(0, 0.3))


def _molar(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a molar tooth: cusps with fissures between them."""
    cusps, size, relief = sample.integer(3, 5), sample.between(4, 6.5), sample.between(0.8, 1.6)
    places = polygon_corners(cusps, 0.55 * size, sample.between(0, 1)) * sample.random.uniform(0.85, 1.15, (cusps, 1))
    lift = sample.random.uniform(0, 0.3, cusps).tolist()
    domes = [
        up + relief * (np.hypot(grid.x - x, grid.y - y) / (0.6 * size)) ** 2
        for (x, y), up in zip(places.tolist(), lift, strict=True)
    ]
    crown = grid.r - size * (1 + 0.08 * np.cos(cusps * grid.angle - sample.between(0, 3)))
    return np.minimum.reduce(domes) + flat_face(crown, 0.8)


def _shell(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a scallop shell: ribs that fan out, with growth rings across."""
    ribs, size, relief = sample.integer(7, 15), sample.between(8, 12), sample.between(0.2, 0.4)
    x, y = grid.x, grid.y + size / 2
    far, angle = np.hypot(x, y), np.arctan2(x, y)
    fan = relief * np.minimum(far / 4, 1) * (1 + np.cos(ribs * np.pi * angle)) + 0.08 * np.cos(2 * np.pi * far / 1.5)
    outline = np.maximum(far - size * (1 - 0.1 * angle**2), (np.abs(angle) - 1.0) * far)
    return fan + 0.03 * grid.r**2 + flat_face(outline, 0.4)


def _pretzel(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a pretzel: a round bar bent to a closed curve with lobes."""
    lobes, size, bar = sample.integer(2, 5), sample.between(5, 7.5), sample.between(0.6, 1.1)
    t = np.linspace(0, 2 * np.pi, 120)
    reach = size * (0.58 + 0.42 * np.cos(lobes * t))
    curve = np.stack([reach * np.cos(t), reach * np.sin(t)], axis=1)
    return round_bar_heights(polyline_sdf(grid.x, grid.y, curve), bar) + 0.15 * (1 + np.cos(3 * grid.angle))


def _maze(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a maze: walls along one of the two diagonals of every field."""
    pitch, relief = sample.between(1.8, 3.2), sample.between(0.5, 1.1)
    kind = sample.random.integers(0, 2, (30, 30))
    flips = np.where(kind[np.round(grid.x / pitch).astype(int) % 30, np.round(grid.y / pitch).astype(int) % 30], 1, -1)
    u, v = wrap_to_pitch(grid.x, pitch), wrap_to_pitch(grid.y, pitch) * flips
    wall = np.minimum(np.abs(u - v), pitch - np.abs(u - v)) / np.sqrt(2) - 0.13 * pitch
    return heights_raised_outside(wall, relief, 0.35) + flat_face(
        rounded_rectangle_sdf(grid.x, grid.y, 6 * pitch, 5 * pitch, 0.5)
    )


def _droplets(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of droplets on a plate that run into each other."""
    count, height = sample.integer(5, 16), sample.between(0.8, 1.6)
    sizes = sample.random.uniform(0.9, 2.2, count).tolist()
    places = sample.scatter(count, 6).tolist()
    field = sum(
        np.exp(-((grid.x - x) ** 2 + (grid.y - y) ** 2) / size**2) for (x, y), size in zip(places, sizes, strict=True)
    )
    return height * smooth_abs(np.maximum(1 - field, 0), 0.05) + flat_face(grid.r - 8)


HOUSEHOLD_OBJECTS: dict[str, HeightfieldFunction] = {
    "leaf": _leaf,
    "flower": _flower,
    "snowflake": _snowflake,
    "button": _button,
    "brick": _brick,
    "puzzle": _puzzle,
    "paw": _paw,
    "molar": _molar,
    "shell": _shell,
    "pretzel": _pretzel,
    "maze": _maze,
    "droplets": _droplets,
}

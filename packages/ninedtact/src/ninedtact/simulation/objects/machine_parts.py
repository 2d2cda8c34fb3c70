"""Machine parts as height grids: screws, gears, bearings, keys and others.

To add a part, write its function and list it in `MACHINE_PARTS`.
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
    polygon_sdf,
    polyline_sdf,
    recess_heights,
    round_bar_heights,
    rounded_rectangle_sdf,
    segment_sdf,
    wrap_to_pitch,
)
from ninedtact.simulation.objects.solids import star_corners

HEXAGON = np.pi / 6


def _screw(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a threaded rod that lies on its side."""
    radius, pitch, length = sample.between(1.5, 4.5), sample.between(0.8, 2), sample.between(10, 18)
    across = np.arcsin(np.clip(grid.y / radius, -1, 1))
    groove = np.abs(wrap_to_pitch(grid.x + pitch * across / (2 * np.pi), pitch)) * 1.1
    return (
        round_bar_heights(grid.y, radius)
        + groove
        + flat_face(rounded_rectangle_sdf(grid.x, grid.y, length, 2 * radius), 0.4)
    )


def _bolt(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a bolt head seen from above: round or six-sided, with a slot, cross, hexagon or star to drive it."""
    drive, radius, depth = sample.integer(0, 3), sample.between(3, 7), sample.between(0.6, 1.5)
    drive_recess = (
        rounded_rectangle_sdf(grid.x, grid.y, 3 * radius, 0.28 * radius),
        np.minimum(
            rounded_rectangle_sdf(grid.x, grid.y, 1.2 * radius, 0.25 * radius),
            rounded_rectangle_sdf(grid.y, grid.x, 1.2 * radius, 0.25 * radius),
        ),
        polygon_sdf(grid.x, grid.y, polygon_corners(6, 0.5 * radius)),
        grid.r - radius * (0.45 + 0.09 * np.cos(6 * grid.angle)),
    )[drive]
    hexagon = polygon_sdf(grid.x, grid.y, polygon_corners(6, radius, HEXAGON))
    head = hexagon if sample.fraction() < 0.4 else grid.r - radius
    return recess_heights(drive_recess, depth) + sample.between(0, 1.2) * (grid.r / radius) ** 2 + flat_face(head, 0.4)


def _nut(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a nut: square to eight-sided, with chamfered corners, and a flange on some."""
    sides, radius, bore = sample.integer(4, 8), sample.between(4, 8), sample.between(0.45, 0.62)
    outline = polygon_sdf(grid.x, grid.y, polygon_corners(sides, radius, np.pi / sides))
    chamfer = 0.6 * np.maximum(grid.r - radius * np.cos(np.pi / sides), 0)
    return chamfer + flat_face(np.maximum(outline, bore * radius - grid.r), 0.35)


def _gear(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a gear: teeth, a bore, and holes in the web."""
    teeth, radius, bore = sample.integer(8, 24), sample.between(4.5, 8.5), sample.between(0.15, 0.3)
    tooth = min(2 * radius / teeth, 1.4)
    wave = np.clip(1.6 * np.cos(teeth * grid.angle), -1, 1)
    outline = grid.r - radius - tooth * wave
    holes, where = sample.integer(0, 6), polygon_corners(6, radius * 0.6)
    for x, y in where[:holes].tolist():
        outline = np.maximum(outline, 0.17 * radius - np.hypot(grid.x - x, grid.y - y))
    return flat_face(np.maximum(outline, bore * radius - grid.r), 0.25)


def _spring(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a coil spring that lies on its side: round wire, seen from below as slanted arcs."""
    radius, wire, pitch = sample.between(2, 4.5), sample.between(0.35, 0.7), sample.between(1.3, 3)
    length = sample.between(9, 16)
    across = np.arcsin(np.clip(grid.y / radius, -1, 1))
    coil = wrap_to_pitch(grid.x + pitch * across / (2 * np.pi), pitch)
    tube = np.where(np.abs(coil) < wire, wire - np.sqrt(np.maximum(wire**2 - coil**2, 0)), np.inf)
    return (
        round_bar_heights(grid.y, radius)
        + tube
        + flat_face(rounded_rectangle_sdf(grid.x, grid.y, length, 2 * radius), 0.3)
    )


def _chain(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a chain: oval links in a row, every other one lower."""
    pitch, wire = sample.between(3, 4.6), sample.between(0.5, 0.9)
    links = []
    for step in range(-1, 3):
        x = grid.x - (step - 0.5) * pitch
        oval = segment_sdf(x, grid.y, (-pitch / 2, 0.0), (pitch / 2, 0.0)) - pitch * 0.33
        links.append(round_bar_heights(oval, wire) + (step % 2) * wire * 0.6)
    return np.minimum.reduce(links)


def _bearing(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a ball bearing: balls between two races."""
    balls, radius = sample.integer(6, 12), sample.between(4, 6.5)
    size = 0.8 * radius * np.sin(np.pi / balls)
    beads = [
        round_bar_heights(np.hypot(grid.x - x, grid.y - y), size) for x, y in polygon_corners(balls, radius).tolist()
    ]
    races = np.abs(np.abs(grid.r - radius) - 1.25 * size) - sample.between(0.3, 0.6)
    return np.minimum(np.minimum.reduce(beads), flat_face(races, 0.25) + sample.between(0, 0.4))


def _rack(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a rack: straight or slanted teeth on a bar."""
    pitch, height, length = sample.between(1.4, 3.2), sample.between(0.6, 1.6), sample.between(12, 18)
    slant = sample.between(-0.5, 0.5)
    teeth = heights_raised_outside(
        np.abs(wrap_to_pitch(grid.x + slant * grid.y, pitch)) - pitch * 0.18, height, pitch * 0.3
    )
    return teeth + flat_face(rounded_rectangle_sdf(grid.x, grid.y, length, sample.between(4, 9), 0.3))


def _fan(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a fan: slanted blades around a hub."""
    blades, radius, sweep = sample.integer(3, 8), sample.between(6, 9), sample.between(-0.5, 0.5)
    around_blade = wrap_to_pitch(grid.angle + sweep * grid.r / 3, 2 * np.pi / blades)
    blade = np.abs(around_blade) * grid.r - grid.r * np.pi / blades * 0.55
    slope = sample.between(0.15, 0.35) * (1 + np.clip(around_blade * grid.r, -3, 3) / 3)
    wheel = flat_face(np.maximum(np.minimum(blade, 0.25 * radius - grid.r), grid.r - radius), 0.25) + slope * 2
    return np.minimum(wheel, flat_face(grid.r - 0.25 * radius, 0.4))


def _cable(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a cable: strands twisted around each other."""
    strands, radius, lay = sample.integer(2, 6), sample.between(1.2, 3), sample.between(6, 14)
    turn = 2 * np.pi * grid.x / lay
    place = [turn + 2 * np.pi * strand / strands for strand in range(strands)]
    size = radius / (1.2 if strands == 2 else 1.6)
    wires = [round_bar_heights(grid.y - radius * np.sin(at), size) + radius * (1 - np.cos(at)) for at in place]
    return np.minimum.reduce(wires) + flat_face(rounded_rectangle_sdf(grid.x, grid.y, sample.between(12, 18), 12), 0.3)


def _spanner(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a spanner: an open jaw on a handle, with a ring at its end."""
    jaw, handle = sample.between(2.2, 3.6), sample.between(0.7, 1.3)
    x, y = grid.x, grid.y
    head = np.hypot(x + 6, y) - jaw
    mouth = rounded_rectangle_sdf(*_sheet_frame(x + 6 + jaw * 0.6, y, sample.between(-0.4, 0.4)), 1.9 * jaw, 0.9 * jaw)
    end = np.abs(np.hypot(x - 6.5, y) - 0.62 * jaw) - 0.3 * jaw
    shaft = rounded_rectangle_sdf(x - 0.3, y, 10, 2 * handle)
    shaft = np.maximum(shaft, 0.62 * jaw - np.hypot(x - 6.5, y))
    whole = np.minimum(np.minimum(np.maximum(head, -mouth), end), shaft)
    return recess_heights(rounded_rectangle_sdf(x - 0.2, y, 6, handle, 0.3), 0.4) + flat_face(whole, 0.3)


def _sheet_frame(x: Heightfield, y: Heightfield, angle_rad: float) -> tuple[Heightfield, Heightfield]:
    """Return the coordinates of the grid points in a rotated frame."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return cos * x + sin * y, cos * y - sin * x


def _key(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a key: a bow with a hole, a grooved blade, and random bitting."""
    bow, width, cuts = sample.between(3, 4.2), sample.between(2, 3), sample.integer(4, 7)
    x, y = grid.x, grid.y
    depths = sample.random.uniform(0.1, 0.55, cuts) * width
    stations = np.linspace(-0.8, 8, cuts)
    edge = np.interp(grid.x[0], np.ravel(np.c_[stations - 0.35, stations + 0.35]), np.repeat(depths, 2))
    blade = np.maximum(rounded_rectangle_sdf(x - 3, y, 13, width, 0.3), y - width / 2 + np.broadcast_to(edge, y.shape))
    grip = np.maximum(np.hypot(x + 6, y) - bow, 0.35 * bow - np.hypot(x + 7, y))
    groove = rounded_rectangle_sdf(x - 3, y + 0.2 * width, 13, 0.22 * width)
    return recess_heights(np.maximum(groove, -x - 2), 0.45, 0.25) + flat_face(np.minimum(grip, blade), 0.2)


def _cutter(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a saw blade or milling cutter: slanted teeth, deeper towards the rim."""
    teeth, radius, rake = sample.integer(5, 14), sample.between(5, 8.5), sample.between(0.2, 0.5)
    turn = np.mod(grid.angle * teeth / (2 * np.pi), 1)
    outline = grid.r - radius * (1 - rake * turn * 0.8)
    hub = np.minimum(outline, grid.r - 0.5 * radius)
    return recess_heights(0.6 * radius - grid.r, 0.5, 0.6) + flat_face(np.maximum(hub, 0.16 * radius - grid.r), 0.25)


def _spline(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of the end of a splined shaft with a centre hole, on a collar."""
    splines, radius = sample.integer(5, 12), sample.between(2.5, 5)
    outline = polygon_sdf(grid.x, grid.y, star_corners(splines, radius, sample.between(0.72, 0.88), 0.0)) - 0.15
    hole = np.maximum(sample.between(0.25, 0.4) * radius - grid.r, 0) * 1.2
    return (
        heights_raised_outside(outline, sample.between(0.8, 1.8))
        + hole
        + flat_face(grid.r - radius - sample.between(1, 3))
    )


def _circuit(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of an electronic chip with its legs."""
    legs, pitch, body = sample.integer(3, 7), sample.between(1.2, 2), sample.between(4, 7)
    x, y = grid.x, grid.y
    length = legs * pitch
    row = np.maximum(
        np.abs(wrap_to_pitch(x - (pitch / 2 if legs % 2 == 0 else 0), pitch)) - 0.25 * pitch, np.abs(x) - length / 2
    )
    leg = np.maximum(row, np.abs(y) - body / 2 - 2)
    mark = np.hypot(x + length / 2 - 1, y) - 0.5
    case = flat_face(rounded_rectangle_sdf(x, y, length, body, 0.3), 0.3) + recess_heights(mark, 0.4)
    return np.minimum(case, flat_face(leg, 0.2) + 0.7 - 0.35 * np.maximum(np.abs(y) - body / 2 - 0.3, 0))


def _hook(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of bent wire: a hook, an S, or a clip."""
    kind, size, wire = sample.integer(0, 2), sample.between(2, 3.5), sample.between(0.5, 1)
    t = np.linspace(0, 1, 40)
    bow = np.stack([np.cos(np.pi * 1.3 * t), np.sin(np.pi * 1.3 * t)], axis=1)
    paths = (
        np.r_[[[1.0, -3.0]], bow] + np.array([0, 0.8]),
        np.r_[bow[::-1] - np.array([1, 0]), np.array([1, 0]) - bow[1:]],
        np.array([[-2, 1], [2, 1], [2, -1], [-2, -1], [-2, 0.4], [1.3, 0.4], [1.3, -0.4], [-1, -0.4]]) * 1.1,
    )
    return round_bar_heights(polyline_sdf(*grid.rotated_axes(sample.between(0, np.pi)), paths[kind] * size), wire)


MACHINE_PARTS: dict[str, HeightfieldFunction] = {
    "screw": _screw,
    "bolt": _bolt,
    "nut": _nut,
    "gear": _gear,
    "spring": _spring,
    "chain": _chain,
    "bearing": _bearing,
    "rack": _rack,
    "fan": _fan,
    "cable": _cable,
    "spanner": _spanner,
    "key": _key,
    "cutter": _cutter,
    "spline": _spline,
    "circuit": _circuit,
    "hook": _hook,
}

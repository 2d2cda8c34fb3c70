"""Flat faces with all kinds of outlines."""

import numpy as np

from ninedtact.simulation.objects.outline import Points, around, box, line, polygon, prism, stroke, sunk
from ninedtact.simulation.objects.sheet import Draw, Heights, Sheet


def punch(draw: Draw, sheet: Sheet) -> Heights:
    """Round, with a rounding from sharp to half of the face."""
    radius = draw.between(2, 7)
    return prism(sheet.r - radius, radius * draw.between(0.06, 0.5))


def tile(draw: Draw, sheet: Sheet) -> Heights:
    """A rectangle."""
    length, width = draw.between(5, 16), draw.between(3, 9)
    return prism(
        box(*sheet.turned(draw.between(0, np.pi)), length, width, draw.between(0.2, 1.4)), draw.between(0.2, 0.8)
    )


def polygon_punch(draw: Draw, sheet: Sheet) -> Heights:
    """A regular polygon with a round hole."""
    sides, radius = draw.whole(3, 8), draw.between(3, 8)
    outline = polygon(sheet.x, sheet.y, around(sides, radius, draw.between(0, np.pi)))
    return prism(np.maximum(outline, radius * draw.between(0.1, 0.45) - sheet.r), 0.25)


def starred(points: int, radius_mm: float, waist: float, turn_rad: float) -> Points:
    """Corners of a star."""
    tips, waists = around(points, radius_mm, turn_rad), around(points, radius_mm * waist, turn_rad + np.pi / points)
    return np.stack([tips, waists], axis=1).reshape(-1, 2)


def star(draw: Draw, sheet: Sheet) -> Heights:
    """Four to nine points."""
    corners = starred(draw.whole(4, 9), draw.between(4, 9), draw.between(0.4, 0.7), draw.between(0, np.pi))
    return prism(polygon(sheet.x, sheet.y, corners) - 0.2, 0.3)


def cross(draw: Draw, sheet: Sheet) -> Heights:
    """Bars through the middle."""
    arms, width, length = draw.whole(3, 5), draw.between(0.8, 2.2), draw.between(5, 8)
    ends = around(arms, length, draw.between(0, np.pi))
    return prism(np.minimum.reduce([box(*bar(sheet, end), 2 * length, width, 0.2) for end in ends.tolist()]), 0.3)


def bar(sheet: Sheet, end: list[float]) -> tuple[Heights, Heights]:
    """The frame of a bar through this point."""
    return sheet.turned(float(np.arctan2(end[1], end[0])))


def ring(draw: Draw, sheet: Sheet) -> Heights:
    """One to three flat rings within each other."""
    rings, width, outer = draw.whole(1, 3), draw.between(0.6, 1.2), draw.between(5, 8.5)
    radii = [outer - 2 * width * step for step in range(rings)]
    return prism(np.minimum.reduce([np.abs(sheet.r - radius) - width / 2 for radius in radii]), 0.25)


def crescent(draw: Draw, sheet: Sheet) -> Heights:
    """A disc with a disc taken out."""
    radius, bite = draw.between(4, 8), draw.between(0.55, 0.9)
    x, y = sheet.turned(draw.between(0, 2 * np.pi))
    inner = np.hypot(x - radius * (1.25 - bite), y) - radius * bite
    return prism(np.maximum(sheet.r - radius, -inner), 0.3)


def heart(draw: Draw, sheet: Sheet) -> Heights:
    """Two bows and a tip."""
    size, (x, y) = draw.between(0.3, 0.5), sheet.turned(draw.between(-1, 1))
    t = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    bows = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)
    return prism(polygon(x, y, size * np.stack([16 * np.sin(t) ** 3, -bows], axis=1)), draw.between(0.25, 1.5))


def arrow(draw: Draw, sheet: Sheet) -> Heights:
    """A head on a shaft."""
    length, shaft, head = draw.between(8, 17), draw.between(1, 2.2), draw.between(4, 8)
    tip, neck, wing = length / 2, length / 2 - head * 0.7, head / 2
    half = [[-tip, shaft / 2], [neck, shaft / 2], [neck, wing], [tip, 0]]
    points = np.array([*half, *([px, -py] for px, py in half[-2::-1])])
    return prism(polygon(*sheet.turned(draw.between(0, 2 * np.pi)), points), 0.25)


def blob(draw: Draw, sheet: Sheet) -> Heights:
    """A smooth closed curve, flat or domed."""
    size, dome = draw.between(3.5, 7), draw.between(0, 1.2)
    orders, phases = np.arange(2, 7), draw.random.uniform(0, 2 * np.pi, 5)
    waves = [np.cos(n * sheet.angle + phase) / n for n, phase in zip(orders.tolist(), phases.tolist(), strict=True)]
    outline = sheet.r - size * (1 + 0.45 * np.sum(waves, axis=0))
    return dome * (sheet.r / size) ** 2 + prism(outline, 0.3)


def profile_bar(draw: Draw, sheet: Sheet) -> Heights:
    """The end of a rolled bar: L, T, U, Z or H."""
    kind, size, wall = draw.whole(0, 4), draw.between(3, 6.5), draw.between(0.5, 1.1)
    paths = ("00 02 22", "00 20 10 12", "00 02 22 20", "00 10 12 22", "00 02 01 21 20 22")
    points = (np.array([[int(pair[0]), int(pair[1])] for pair in paths[kind].split()], float) - 1) * size
    return prism(line(*sheet.turned(draw.between(0, np.pi)), points) - wall, 0.25)


def pin_array(draw: Draw, sheet: Sheet) -> Heights:
    """Flat pins of different widths."""
    count, width, spread = draw.whole(5, 14), draw.between(0.7, 1.4), draw.between(4, 7)
    radii = width * draw.random.uniform(0.6, 1.2, count)
    places = zip(draw.scatter(count, spread).tolist(), radii.tolist(), strict=True)
    return prism(np.minimum.reduce([np.hypot(sheet.x - x, sheet.y - y) - radius for (x, y), radius in places]), 0.25)


def slotted_disc(draw: Draw, sheet: Sheet) -> Heights:
    """Slots from the rim inwards, not all alike."""
    slots, radius, width = draw.whole(3, 9), draw.between(5, 8), draw.between(0.8, 1.6)
    ends = around(slots, radius + 2)
    starts = ends * draw.random.uniform(0.25, 0.6, (slots, 1))
    pairs = zip(starts.tolist(), ends.tolist(), strict=True)
    cuts = np.minimum.reduce([stroke(sheet.x, sheet.y, (a[0], a[1]), (b[0], b[1])) for a, b in pairs])
    return sunk(cuts - width / 2, 1.2) + prism(sheet.r - radius)


PUNCHES = (
    *(punch, tile, polygon_punch, star, cross, ring, crescent, heart, arrow, blob, profile_bar, pin_array),
    slotted_disc,
)

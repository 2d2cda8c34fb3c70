"""Simple solids and unions of them."""

import numpy as np

from ninedtact.simulation.objects.outline import around, box, polygon, prism, raised, round_bar, softly, stroke
from ninedtact.simulation.objects.sheet import Draw, Heights, Sheet


def ball(draw: Draw, sheet: Sheet) -> Heights:
    """A sphere."""
    return round_bar(sheet.r, draw.between(2, 8))


def ellipsoid(draw: Draw, sheet: Sheet) -> Heights:
    """Three different axes."""
    x, y = sheet.turned(draw.between(0, np.pi))
    length, width, height = draw.between(4, 9), draw.between(2, 4), draw.between(2, 6)
    return height * round_bar(np.hypot(x / length, y / width), 1.0)


def cylinder(draw: Draw, sheet: Sheet) -> Heights:
    """Lying on its side."""
    radius, length = draw.between(1.5, 7), draw.between(8, 19)
    x, y = sheet.turned(draw.between(0, np.pi))
    return round_bar(y, radius) + prism(box(x, y, length, 2 * radius), 0.3)


def capsule(draw: Draw, sheet: Sheet) -> Heights:
    """A rod with round ends, or two joined at an angle."""
    radius, half, bend = draw.between(1, 3.5), draw.between(3, 6), draw.between(-1.2, 1.2)
    arm = stroke(sheet.x, sheet.y, (0.0, 0.0), (-half, 0.0))
    other = stroke(sheet.x, sheet.y, (0.0, 0.0), (half * np.cos(bend), half * np.sin(bend)))
    return round_bar(np.minimum(arm, other), radius)


def cone(draw: Draw, sheet: Sheet) -> Heights:
    """On its blunt tip."""
    slope, radius = np.tan(draw.between(0.3, 1.1)), draw.between(3, 8)
    return slope * softly(sheet.r, draw.between(0.3, 1.2)) + prism(sheet.r - radius)


def frustum(draw: Draw, sheet: Sheet) -> Heights:
    """A cone with a flat or hollow end."""
    face, slope, radius = draw.between(0.8, 4), np.tan(draw.between(0.3, 1.0)), draw.between(5, 8)
    return slope * softly(np.maximum(sheet.r - face, 0), 0.2) + prism(sheet.r - radius)


def pyramid(draw: Draw, sheet: Sheet) -> Heights:
    """Three to six sides, on its tip."""
    sides, slope, radius = draw.whole(3, 6), np.tan(draw.between(0.25, 0.9)), draw.between(4, 8)
    normals = around(sides, 1.0, draw.between(0, np.pi))
    across = np.maximum.reduce([nx * sheet.x + ny * sheet.y for nx, ny in normals.tolist()])
    return slope * softly(across, 0.3) + prism(across - radius)


def wedge(draw: Draw, sheet: Sheet) -> Heights:
    """An edge, straight or bent along its length."""
    slope, length, bend = np.tan(draw.between(0.3, 1.0)), draw.between(8, 18), draw.between(-0.06, 0.06)
    return slope * softly(sheet.y - bend * sheet.x**2, 0.3) + prism(box(sheet.x, sheet.y, length, 10, 0.5))


def cross_roof(draw: Draw, sheet: Sheet) -> Heights:
    """Edges that meet in the middle."""
    arms, slope, turn = draw.whole(3, 5), np.tan(draw.between(0.4, 1.0)), draw.between(0, 1)
    ends = around(arms, draw.between(5.5, 7.5), turn)
    ridges = [stroke(sheet.x, sheet.y, (0.0, 0.0), (x, y)) for x, y in ends.tolist()]
    nearest = np.minimum.reduce(ridges)
    return slope * softly(nearest, 0.3) + prism(nearest - 2.5)


def torus(draw: Draw, sheet: Sheet) -> Heights:
    """A ring with a round section, round or oval."""
    tube, radius = draw.between(0.6, 2.2), draw.between(3, 7)
    return round_bar(np.hypot(sheet.x, sheet.y * draw.between(1, 1.6)) - radius, tube)


def saddle(draw: Draw, sheet: Sheet) -> Heights:
    """Bent down along one axis and up along the other."""
    x, y = sheet.turned(draw.between(0, np.pi))
    waves, height = draw.whole(2, 4), draw.between(0.6, 1.5)
    angle = np.arctan2(y, x)
    return height * (sheet.r / 6) ** 2 * (1 + np.cos(waves * angle)) + prism(sheet.r - draw.between(5, 8), 0.4)


def ziggurat(draw: Draw, sheet: Sheet) -> Heights:
    """Steps around a round, square or six-sided face."""
    sides, steps, tread = draw.whole(3, 7), draw.whole(2, 4), draw.between(0.9, 1.8)
    outline = polygon(sheet.x, sheet.y, around(sides, draw.between(1.5, 3), draw.between(0, 1)))
    stairs = [raised(outline - tread * step, draw.between(0.3, 0.8)) for step in range(steps)]
    return np.sum(stairs, axis=0) + prism(outline - tread * (steps + 0.3))


def limpet(draw: Draw, sheet: Sheet) -> Heights:
    """A ribbed cone."""
    ribs, slope, radius = draw.whole(6, 16), draw.between(0.25, 0.7), draw.between(5, 8)
    rib = draw.between(0.2, 0.45) * np.minimum(sheet.r / 3, 1) * (1 - np.cos(ribs * sheet.angle))
    return slope * softly(sheet.r, 0.8) + rib + prism(sheet.r - radius + rib)


def pebbles(draw: Draw, sheet: Sheet) -> Heights:
    """Balls of different sizes, not all equally low."""
    count, largest, spread = draw.whole(4, 14), draw.between(1.2, 2.6), draw.between(3, 6.5)
    sizes = largest * draw.random.uniform(0.45, 1, count)
    lift = draw.random.uniform(0, 0.5, count)
    places = draw.scatter(count, spread)
    rows = zip(places.tolist(), sizes.tolist(), lift.tolist(), strict=True)
    return np.minimum.reduce([up + round_bar(np.hypot(sheet.x - x, sheet.y - y), size) for (x, y), size, up in rows])


def caltrop(draw: Draw, sheet: Sheet) -> Heights:
    """A plate with cones of different heights."""
    count, height, spread = draw.whole(3, 8), draw.between(1, 2.5), draw.between(3, 5.5)
    lift = draw.random.uniform(0, 0.6, count)
    slope = draw.between(0.8, 1.6)
    cones = [
        up + slope * softly(np.hypot(sheet.x - x, sheet.y - y), 0.4)
        for (x, y), up in zip(draw.scatter(count, spread).tolist(), lift.tolist(), strict=True)
    ]
    return np.minimum(np.minimum.reduce(cones), height) + prism(sheet.r - spread - 2)


SOLIDS = (
    *(ball, ellipsoid, cylinder, capsule, cone, frustum, pyramid, wedge, cross_roof, torus, saddle, ziggurat, limpet),
    *(pebbles, caltrop),
)

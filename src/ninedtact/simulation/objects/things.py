"""Everyday things."""

import numpy as np

from ninedtact.simulation.objects.outline import (
    around,
    box,
    folded,
    line,
    prism,
    raised,
    round_bar,
    softly,
    sunk,
)
from ninedtact.simulation.objects.sheet import Draw, Heights, Sheet


def leaf(draw: Draw, sheet: Sheet) -> Heights:
    """A blade with a midrib and side veins."""
    length, width, veins = draw.between(10, 17), draw.between(4, 9), draw.whole(4, 8)
    along = np.clip(sheet.x / length + 0.5, 0, 1)
    blade = np.abs(sheet.y) - width / 2 * np.sin(np.pi * along**0.8)
    pitch = length / veins
    side = np.abs(folded(sheet.x - 0.9 * np.abs(sheet.y), pitch)) * 0.74 - 0.12
    vein = np.minimum(np.abs(sheet.y) - 0.3 * (1.2 - along), side)
    return raised(vein, draw.between(0.3, 0.6), 0.3) + prism(np.maximum(blade, np.abs(sheet.x) - length / 2), 0.15)


def flower(draw: Draw, sheet: Sheet) -> Heights:
    """Domed petals around a bead."""
    petals, radius = draw.whole(4, 9), draw.between(3, 5)
    size = radius * np.sin(np.pi / petals) * draw.between(0.85, 1.1)
    places = around(petals, radius).tolist()
    domes = [size * 0.5 * round_bar(np.hypot(sheet.x - x, sheet.y - y) / size, 1.0) for x, y in places]
    heart = round_bar(sheet.r, draw.between(1, 2))
    return np.minimum(np.minimum.reduce(domes) + draw.between(0, 0.4), heart)


def snowflake(draw: Draw, sheet: Sheet) -> Heights:
    """Six arms with side branches."""
    radius, branches, bar = draw.between(6, 9), draw.whole(1, 3), draw.between(0.35, 0.6)
    turn = folded(sheet.angle, np.pi / 3)
    x, y = sheet.r * np.cos(turn), sheet.r * np.abs(np.sin(turn))
    arms = [line(x, y, np.array([[0.0, 0.0], [radius, 0.0]]))]
    for at in np.linspace(0.35, 0.8, branches).tolist():
        reach = radius * (1 - at) * draw.between(0.6, 1.1) + 0.4
        arms.append(line(x, y, np.array([[at * radius, 0.0], [at * radius + reach / 2, reach * 0.8]])))
    return prism(np.minimum.reduce(arms) - bar, 0.25)


def button(draw: Draw, sheet: Sheet) -> Heights:
    """A rim and two to five holes."""
    holes, radius = draw.whole(2, 5), draw.between(4.5, 8.5)
    outline = sheet.r - radius
    for x, y in around(holes, 0.28 * radius).tolist():
        outline = np.maximum(outline, 0.13 * radius - np.hypot(sheet.x - x, sheet.y - y))
    well = sunk(sheet.r - radius * draw.between(0.55, 0.8), draw.between(0.4, 1), 0.8)
    return well + prism(outline, 0.3)


def brick(draw: Draw, sheet: Sheet) -> Heights:
    """A toy brick: round studs on a plate."""
    cols, rows, pitch = draw.whole(2, 4), draw.whole(1, 3), draw.between(3, 4.5)
    places = [(col - (cols - 1) / 2, row - (rows - 1) / 2) for col in range(cols) for row in range(rows)]
    studs = np.minimum.reduce([np.hypot(sheet.x - pitch * x, sheet.y - pitch * y) for x, y in places]) - 0.32 * pitch
    return raised(studs, draw.between(0.8, 1.6), 0.3) + prism(box(sheet.x, sheet.y, cols * pitch, rows * pitch, 0.3))


def puzzle(draw: Draw, sheet: Sheet) -> Heights:
    """A piece of a jigsaw: a knob or a hole on each side."""
    size, knob = draw.between(3, 5), draw.between(0.26, 0.34)
    outline = box(sheet.x, sheet.y, 2 * size, 2 * size, 0.2)
    kinds = draw.random.integers(0, 2, 4).tolist()
    for (x, y), out in zip(around(4, 1.0).tolist(), kinds, strict=True):
        reach = size * (1 + (knob if out else -knob) * 0.75)
        disc = np.hypot(sheet.x - reach * x, sheet.y - reach * y) - knob * size
        outline = np.minimum(outline, disc) if out else np.maximum(outline, -disc)
    return prism(outline, 0.25)


def paw(draw: Draw, sheet: Sheet) -> Heights:
    """A pad and toes."""
    toes, size = draw.whole(3, 5), draw.between(2.4, 3.6)
    pad = 2 * round_bar(np.hypot(sheet.x / size, (sheet.y - 2) / (0.85 * size)), 1.0)
    angles = np.linspace(-1, 1, toes) * draw.between(0.8, 1.1) - np.pi / 2
    toe = [
        1.2
        * round_bar(
            np.hypot(sheet.x - 1.75 * size * np.cos(a), sheet.y - 2 - 1.75 * size * np.sin(a)) / (0.4 * size), 1.0
        )
        for a in angles.tolist()
    ]
    return np.minimum(pad, np.minimum.reduce(toe) + draw.between(0, 0.3))


def molar(draw: Draw, sheet: Sheet) -> Heights:
    """A tooth: cusps with fissures between them."""
    cusps, size, relief = draw.whole(3, 5), draw.between(4, 6.5), draw.between(0.8, 1.6)
    places = around(cusps, 0.55 * size, draw.between(0, 1)) * draw.random.uniform(0.85, 1.15, (cusps, 1))
    lift = draw.random.uniform(0, 0.3, cusps).tolist()
    domes = [
        up + relief * (np.hypot(sheet.x - x, sheet.y - y) / (0.6 * size)) ** 2
        for (x, y), up in zip(places.tolist(), lift, strict=True)
    ]
    crown = sheet.r - size * (1 + 0.08 * np.cos(cusps * sheet.angle - draw.between(0, 3)))
    return np.minimum.reduce(domes) + prism(crown, 0.8)


def shell(draw: Draw, sheet: Sheet) -> Heights:
    """A scallop: ribs that fan out, growth rings across."""
    ribs, size, relief = draw.whole(7, 15), draw.between(8, 12), draw.between(0.2, 0.4)
    x, y = sheet.x, sheet.y + size / 2
    far, angle = np.hypot(x, y), np.arctan2(x, y)
    fan = relief * np.minimum(far / 4, 1) * (1 + np.cos(ribs * np.pi * angle)) + 0.08 * np.cos(2 * np.pi * far / 1.5)
    outline = np.maximum(far - size * (1 - 0.1 * angle**2), (np.abs(angle) - 1.0) * far)
    return fan + 0.03 * sheet.r**2 + prism(outline, 0.4)


def pretzel(draw: Draw, sheet: Sheet) -> Heights:
    """A round bar bent to a closed curve with lobes."""
    lobes, size, bar = draw.whole(2, 5), draw.between(5, 7.5), draw.between(0.6, 1.1)
    t = np.linspace(0, 2 * np.pi, 120)
    reach = size * (0.58 + 0.42 * np.cos(lobes * t))
    curve = np.stack([reach * np.cos(t), reach * np.sin(t)], axis=1)
    return round_bar(line(sheet.x, sheet.y, curve), bar) + 0.15 * (1 + np.cos(3 * sheet.angle))


def maze(draw: Draw, sheet: Sheet) -> Heights:
    """Walls of a labyrinth: one diagonal or the other in every field."""
    pitch, relief = draw.between(1.8, 3.2), draw.between(0.5, 1.1)
    kind = draw.random.integers(0, 2, (30, 30))
    flips = np.where(
        kind[np.round(sheet.x / pitch).astype(int) % 30, np.round(sheet.y / pitch).astype(int) % 30], 1, -1
    )
    u, v = folded(sheet.x, pitch), folded(sheet.y, pitch) * flips
    wall = np.minimum(np.abs(u - v), pitch - np.abs(u - v)) / np.sqrt(2) - 0.13 * pitch
    return raised(wall, relief, 0.35) + prism(box(sheet.x, sheet.y, 6 * pitch, 5 * pitch, 0.5))


def droplets(draw: Draw, sheet: Sheet) -> Heights:
    """Drops that run into each other, on a plate."""
    count, height = draw.whole(5, 16), draw.between(0.8, 1.6)
    sizes = draw.random.uniform(0.9, 2.2, count).tolist()
    places = draw.scatter(count, 6).tolist()
    field = sum(
        np.exp(-((sheet.x - x) ** 2 + (sheet.y - y) ** 2) / size**2) for (x, y), size in zip(places, sizes, strict=True)
    )
    return height * softly(np.maximum(1 - field, 0), 0.05) + prism(sheet.r - 8)


THINGS = (leaf, flower, snowflake, button, brick, puzzle, paw, molar, shell, pretzel, maze, droplets)

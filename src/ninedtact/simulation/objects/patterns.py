"""Regular reliefs on plates."""

import numpy as np

from ninedtact.simulation.objects.outline import around, box, folded, polygon, prism, raised, round_bar, softly, sunk
from ninedtact.simulation.objects.sheet import Draw, Heights, Sheet


def plate(draw: Draw, sheet: Sheet) -> Heights:
    """What carries a pattern: a disc, a rectangle or a hexagon."""
    kind, size = draw.whole(0, 2), draw.between(5.5, 8.5)
    if kind == 0:
        return prism(sheet.r - size)
    if kind == 1:
        return prism(box(sheet.x, sheet.y, 2.2 * size, 1.6 * size, 0.6))
    return prism(polygon(sheet.x, sheet.y, around(6, size)))


def grid(draw: Draw, sheet: Sheet) -> Heights:
    """Crossing bars."""
    pitch, bar, relief = draw.between(1.6, 4), draw.between(0.15, 0.35), draw.between(0.5, 1.5)
    x, y = sheet.turned(draw.between(0, np.pi / 2))
    bars = np.minimum(np.abs(folded(x, pitch)), np.abs(folded(y, pitch * draw.between(1, 1.6)))) - bar * pitch / 2
    return raised(bars, relief, 0.35) + plate(draw, sheet)


def weave(draw: Draw, sheet: Sheet) -> Heights:
    """Threads over and under each other."""
    pitch, depth = draw.between(1.4, 3.2), draw.between(0.3, 0.7)
    x, y = sheet.turned(draw.between(0, np.pi / 2))
    warp = over(x, y, pitch, depth)
    return np.minimum(warp, over(y, x + pitch, pitch, depth)) + plate(draw, sheet)


def over(x: Heights, y: Heights, pitch_mm: float, depth_mm: float) -> Heights:
    """Threads along y that rise and fall."""
    thread = np.round(x / pitch_mm)
    wave = depth_mm * (1 + np.cos(np.pi * (y / pitch_mm + thread)))
    return wave + pitch_mm * 0.8 * (1 - np.sqrt(np.maximum(1 - (folded(x, pitch_mm) / pitch_mm * 1.9) ** 2, 0.01)))


def dots(draw: Draw, sheet: Sheet) -> Heights:
    """Domes on a square or staggered lattice."""
    pitch, relief, stagger = draw.between(1.6, 3.6), draw.between(0.4, 1.2), draw.whole(0, 1)
    row = np.round(sheet.y / pitch)
    nearest = np.hypot(folded(sheet.x + stagger * pitch / 2 * (row % 2), pitch), sheet.y - pitch * row)
    return relief * np.clip(nearest / (draw.between(0.25, 0.45) * pitch), 0, 1) ** 2 + plate(draw, sheet)


def ridges(draw: Draw, sheet: Sheet) -> Heights:
    """Parallel ridges, sharp or round."""
    pitch, relief = draw.between(1.2, 3.5), draw.between(0.4, 1.2)
    x, _ = sheet.turned(draw.between(0, np.pi))
    part = np.abs(folded(x, pitch)) / (pitch / 2)
    return relief * part ** draw.between(1, 2.5) + plate(draw, sheet)


def waves(draw: Draw, sheet: Sheet) -> Heights:
    """Two crossing wave trains."""
    first, second, relief = draw.between(2, 6), draw.between(2, 6), draw.between(0.3, 0.7)
    (u, _), (v, _) = sheet.turned(draw.between(0, np.pi)), sheet.turned(draw.between(0, np.pi))
    heights = relief * (2 + np.cos(2 * np.pi * u / first) + np.cos(2 * np.pi * v / second))
    return heights + plate(draw, sheet)


def ripples(draw: Draw, sheet: Sheet) -> Heights:
    """Rings on water, from one or two places."""
    length, relief, apart = draw.between(1.5, 3.5), draw.between(0.3, 0.6), draw.between(-5, 5)
    first = np.cos(2 * np.pi * np.hypot(sheet.x - apart, sheet.y) / length)
    second = np.cos(2 * np.pi * np.hypot(sheet.x + apart, sheet.y - 1) / length)
    return relief * (2 - first - second) + plate(draw, sheet)


def knurl(draw: Draw, sheet: Sheet) -> Heights:
    """Crossed grooves on a roller."""
    radius, pitch, length = draw.between(3, 8), draw.between(1, 2), draw.between(10, 17)
    along = np.arcsin(np.clip(sheet.y / radius, -1, 1)) * radius
    grooves = [np.abs(folded(sheet.x + sign * along, 2 * pitch)) for sign in (-1, 1)]
    relief = 0.45 * np.maximum(*grooves)
    return round_bar(sheet.y, radius) + relief + prism(box(sheet.x, sheet.y, length, 2 * radius), 0.4)


def honeycomb(draw: Draw, sheet: Sheet) -> Heights:
    """Six-sided cells."""
    pitch, wall, depth = draw.between(2.2, 4.5), draw.between(0.25, 0.5), draw.between(0.6, 1.5)
    x, y = hexagon_frame(*sheet.turned(draw.between(0, np.pi)), pitch)
    border = np.maximum.reduce([np.abs(nx * x + ny * y) for nx, ny in around(6, 1.0)[:3].tolist()]) - pitch / 2
    return sunk(border + wall, depth, 0.35) + plate(draw, sheet)


def hexagon_frame(x: Heights, y: Heights, pitch_mm: float) -> tuple[Heights, Heights]:
    """x and y counted from the middle of the nearest cell of a honeycomb."""
    step = pitch_mm * np.sqrt(3)
    first = folded(x, pitch_mm), folded(y, step)
    second = folded(x - pitch_mm / 2, pitch_mm), folded(y - step / 2, step)
    nearer = np.hypot(*first) < np.hypot(*second)
    return np.where(nearer, first[0], second[0]), np.where(nearer, first[1], second[1])


def pyramids(draw: Draw, sheet: Sheet) -> Heights:
    """A field of pyramids on their tips."""
    pitch, relief = draw.between(1.6, 4), draw.between(0.6, 1.6)
    x, y = sheet.turned(draw.between(0, np.pi / 2))
    part = np.maximum(np.abs(folded(x, pitch)), np.abs(folded(y, pitch))) / (pitch / 2)
    return relief * softly(part, 0.15) + plate(draw, sheet)


def spiral(draw: Draw, sheet: Sheet) -> Heights:
    """A ridge that winds outwards, one to three times."""
    arms, pitch, relief = draw.whole(1, 3), draw.between(1.6, 3), draw.between(0.5, 1.2)
    turn = sheet.r - arms * pitch * sheet.angle / (2 * np.pi)
    return raised(np.abs(folded(turn, pitch)) - 0.2 * pitch, relief, 0.35) + plate(draw, sheet)


def comb(draw: Draw, sheet: Sheet) -> Heights:
    """Teeth on a back."""
    teeth, width, tooth = draw.whole(4, 9), draw.between(10, 17), draw.between(4, 8)
    pitch = width / teeth
    row = np.maximum(
        np.abs(folded(sheet.x + (0 if teeth % 2 else pitch / 2), pitch)) - 0.28 * pitch, np.abs(sheet.x) - width / 2
    )
    tines = np.maximum(row, np.abs(sheet.y - tooth / 2) - tooth / 2)
    return prism(np.minimum(tines, box(sheet.x, sheet.y + 1, width, 2.6, 0.4)), 0.25)


def ladder(draw: Draw, sheet: Sheet) -> Heights:
    """Two rails with rungs, of round bars."""
    width, pitch, bar = draw.between(4, 8), draw.between(2, 4), draw.between(0.4, 0.8)
    rails = np.hypot(np.abs(sheet.y) - width / 2, 0)
    rungs = np.hypot(folded(sheet.x, pitch), np.maximum(np.abs(sheet.y) - width / 2, 0))
    bars = np.minimum(round_bar(rails, bar), round_bar(rungs, bar * draw.between(0.7, 1)) + draw.between(0, 0.3))
    return bars + prism(np.abs(sheet.x) - draw.between(6, 9))


def bricks(draw: Draw, sheet: Sheet) -> Heights:
    """A wall."""
    length, ratio, joint = draw.between(3, 6), draw.between(0.35, 0.6), draw.between(0.18, 0.35)
    row = np.round(sheet.y / (length * ratio))
    stone = box(
        folded(sheet.x + length / 2 * (row % 2), length), folded(sheet.y, length * ratio), length, length * ratio
    )
    return raised(stone + joint, draw.between(0.4, 0.9), 0.3) + plate(draw, sheet)


def scales(draw: Draw, sheet: Sheet) -> Heights:
    """Overlapping scales."""
    size, tilt = draw.between(2.2, 4.5), draw.between(0.2, 0.4)
    layers = []
    for shift in (0.0, 1.0):
        x, row = folded(sheet.x + shift * size / 2, size), np.floor((sheet.y - shift * size / 2) / size)
        y = sheet.y - shift * size / 2 - row * size
        layers.append(np.where(np.hypot(x, y) < 0.72 * size, tilt * (size - y), tilt * 2 * size))
    return np.minimum(*layers) + plate(draw, sheet)


def checker(draw: Draw, sheet: Sheet) -> Heights:
    """Fields of different heights."""
    pitch, turn = draw.between(1.8, 4), draw.between(0, np.pi / 2)
    x, y = sheet.turned(turn)
    heights = draw.random.uniform(0, draw.between(0.6, 1.3), (40, 40))
    field = heights[np.round(x / pitch).astype(int) % 40, np.round(y / pitch).astype(int) % 40]
    return sheet.smooth(field, 0.15) + plate(draw, sheet)


def tread(draw: Draw, sheet: Sheet) -> Heights:
    """A tyre: slanting blocks and grooves."""
    pitch, slant, depth = draw.between(2, 4), draw.between(0.4, 1.2), draw.between(0.7, 1.4)
    sideways = np.abs(folded(sheet.x + slant * np.abs(sheet.y), pitch)) - 0.13 * pitch
    grooves = np.minimum(sideways, np.abs(np.abs(sheet.y) - draw.between(1.5, 3.5)) - 0.35)
    return sunk(grooves, depth) + 0.02 * sheet.y**2 + prism(box(sheet.x, sheet.y, 17, draw.between(9, 14), 0.5))


PATTERNS = (
    *(grid, weave, dots, ridges, waves, ripples, knurl, honeycomb, pyramids, spiral, comb, ladder, bricks, scales),
    *(checker, tread),
)

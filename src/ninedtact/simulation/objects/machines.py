"""Machine parts."""

import numpy as np

from ninedtact.simulation.objects.outline import (
    around,
    box,
    folded,
    line,
    polygon,
    prism,
    raised,
    round_bar,
    stroke,
    sunk,
)
from ninedtact.simulation.objects.punches import starred
from ninedtact.simulation.objects.sheet import Draw, Heights, Sheet

HEXAGON = np.pi / 6


def screw(draw: Draw, sheet: Sheet) -> Heights:
    """A threaded rod on its side."""
    radius, pitch, length = draw.between(1.5, 4.5), draw.between(0.8, 2), draw.between(10, 18)
    across = np.arcsin(np.clip(sheet.y / radius, -1, 1))
    groove = np.abs(folded(sheet.x + pitch * across / (2 * np.pi), pitch)) * 1.1
    return round_bar(sheet.y, radius) + groove + prism(box(sheet.x, sheet.y, length, 2 * radius), 0.4)


def bolt(draw: Draw, sheet: Sheet) -> Heights:
    """A head seen from above: round or six-sided, with a slot, cross, hexagon or star to drive it."""
    drive, radius, depth = draw.whole(0, 3), draw.between(3, 7), draw.between(0.6, 1.5)
    recess = (
        box(sheet.x, sheet.y, 3 * radius, 0.28 * radius),
        np.minimum(
            box(sheet.x, sheet.y, 1.2 * radius, 0.25 * radius), box(sheet.y, sheet.x, 1.2 * radius, 0.25 * radius)
        ),
        polygon(sheet.x, sheet.y, around(6, 0.5 * radius)),
        sheet.r - radius * (0.45 + 0.09 * np.cos(6 * sheet.angle)),
    )[drive]
    hexagon = polygon(sheet.x, sheet.y, around(6, radius, HEXAGON))
    head = hexagon if draw.part() < 0.4 else sheet.r - radius
    return sunk(recess, depth) + draw.between(0, 1.2) * (sheet.r / radius) ** 2 + prism(head, 0.4)


def nut(draw: Draw, sheet: Sheet) -> Heights:
    """A nut, square to eight-sided, with chamfered corners and a flange on some."""
    sides, radius, bore = draw.whole(4, 8), draw.between(4, 8), draw.between(0.45, 0.62)
    outline = polygon(sheet.x, sheet.y, around(sides, radius, np.pi / sides))
    chamfer = 0.6 * np.maximum(sheet.r - radius * np.cos(np.pi / sides), 0)
    return chamfer + prism(np.maximum(outline, bore * radius - sheet.r), 0.35)


def gear(draw: Draw, sheet: Sheet) -> Heights:
    """Teeth, a bore, and holes in the web."""
    teeth, radius, bore = draw.whole(8, 24), draw.between(4.5, 8.5), draw.between(0.15, 0.3)
    tooth = min(2 * radius / teeth, 1.4)
    wave = np.clip(1.6 * np.cos(teeth * sheet.angle), -1, 1)
    outline = sheet.r - radius - tooth * wave
    holes, where = draw.whole(0, 6), around(6, radius * 0.6)
    for x, y in where[:holes].tolist():
        outline = np.maximum(outline, 0.17 * radius - np.hypot(sheet.x - x, sheet.y - y))
    return prism(np.maximum(outline, bore * radius - sheet.r), 0.25)


def spring(draw: Draw, sheet: Sheet) -> Heights:
    """A coil on its side: round wire, seen from below as slanting bows."""
    radius, wire, pitch = draw.between(2, 4.5), draw.between(0.35, 0.7), draw.between(1.3, 3)
    length = draw.between(9, 16)
    across = np.arcsin(np.clip(sheet.y / radius, -1, 1))
    coil = folded(sheet.x + pitch * across / (2 * np.pi), pitch)
    tube = np.where(np.abs(coil) < wire, wire - np.sqrt(np.maximum(wire**2 - coil**2, 0)), np.inf)
    return round_bar(sheet.y, radius) + tube + prism(box(sheet.x, sheet.y, length, 2 * radius), 0.3)


def chain(draw: Draw, sheet: Sheet) -> Heights:
    """Oval links in a row, every other one lower."""
    pitch, wire = draw.between(3, 4.6), draw.between(0.5, 0.9)
    links = []
    for step in range(-1, 3):
        x = sheet.x - (step - 0.5) * pitch
        oval = stroke(x, sheet.y, (-pitch / 2, 0.0), (pitch / 2, 0.0)) - pitch * 0.33
        links.append(round_bar(oval, wire) + (step % 2) * wire * 0.6)
    return np.minimum.reduce(links)


def bearing(draw: Draw, sheet: Sheet) -> Heights:
    """Balls between two races."""
    balls, radius = draw.whole(6, 12), draw.between(4, 6.5)
    size = 0.8 * radius * np.sin(np.pi / balls)
    beads = [round_bar(np.hypot(sheet.x - x, sheet.y - y), size) for x, y in around(balls, radius).tolist()]
    races = np.abs(np.abs(sheet.r - radius) - 1.25 * size) - draw.between(0.3, 0.6)
    return np.minimum(np.minimum.reduce(beads), prism(races, 0.25) + draw.between(0, 0.4))


def rack(draw: Draw, sheet: Sheet) -> Heights:
    """Straight or slanting teeth on a bar."""
    pitch, height, length = draw.between(1.4, 3.2), draw.between(0.6, 1.6), draw.between(12, 18)
    slant = draw.between(-0.5, 0.5)
    teeth = raised(np.abs(folded(sheet.x + slant * sheet.y, pitch)) - pitch * 0.18, height, pitch * 0.3)
    return teeth + prism(box(sheet.x, sheet.y, length, draw.between(4, 9), 0.3))


def fan(draw: Draw, sheet: Sheet) -> Heights:
    """Slanting blades around a hub."""
    blades, radius, sweep = draw.whole(3, 8), draw.between(6, 9), draw.between(-0.5, 0.5)
    around_blade = folded(sheet.angle + sweep * sheet.r / 3, 2 * np.pi / blades)
    blade = np.abs(around_blade) * sheet.r - sheet.r * np.pi / blades * 0.55
    slope = draw.between(0.15, 0.35) * (1 + np.clip(around_blade * sheet.r, -3, 3) / 3)
    wheel = prism(np.maximum(np.minimum(blade, 0.25 * radius - sheet.r), sheet.r - radius), 0.25) + slope * 2
    return np.minimum(wheel, prism(sheet.r - 0.25 * radius, 0.4))


def cable(draw: Draw, sheet: Sheet) -> Heights:
    """Strands twisted around each other."""
    strands, radius, lay = draw.whole(2, 6), draw.between(1.2, 3), draw.between(6, 14)
    turn = 2 * np.pi * sheet.x / lay
    place = [turn + 2 * np.pi * strand / strands for strand in range(strands)]
    size = radius / (1.2 if strands == 2 else 1.6)
    wires = [round_bar(sheet.y - radius * np.sin(at), size) + radius * (1 - np.cos(at)) for at in place]
    return np.minimum.reduce(wires) + prism(box(sheet.x, sheet.y, draw.between(12, 18), 12), 0.3)


def spanner(draw: Draw, sheet: Sheet) -> Heights:
    """An open jaw on a handle, with a ring at its end."""
    jaw, handle = draw.between(2.2, 3.6), draw.between(0.7, 1.3)
    x, y = sheet.x, sheet.y
    head = np.hypot(x + 6, y) - jaw
    mouth = box(*sheet_frame(x + 6 + jaw * 0.6, y, draw.between(-0.4, 0.4)), 1.9 * jaw, 0.9 * jaw)
    end = np.abs(np.hypot(x - 6.5, y) - 0.62 * jaw) - 0.3 * jaw
    shaft = box(x - 0.3, y, 10, 2 * handle)
    shaft = np.maximum(shaft, 0.62 * jaw - np.hypot(x - 6.5, y))
    whole = np.minimum(np.minimum(np.maximum(head, -mouth), end), shaft)
    return sunk(box(x - 0.2, y, 6, handle, 0.3), 0.4) + prism(whole, 0.3)


def sheet_frame(x: Heights, y: Heights, angle_rad: float) -> tuple[Heights, Heights]:
    """Coordinates in a turned frame."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return cos * x + sin * y, cos * y - sin * x


def key(draw: Draw, sheet: Sheet) -> Heights:
    """A bow with a hole, a grooved blade, and bitting of its own."""
    bow, width, cuts = draw.between(3, 4.2), draw.between(2, 3), draw.whole(4, 7)
    x, y = sheet.x, sheet.y
    depths = draw.random.uniform(0.1, 0.55, cuts) * width
    stations = np.linspace(-0.8, 8, cuts)
    edge = np.interp(sheet.x[0], np.ravel(np.c_[stations - 0.35, stations + 0.35]), np.repeat(depths, 2))
    blade = np.maximum(box(x - 3, y, 13, width, 0.3), y - width / 2 + np.broadcast_to(edge, y.shape))
    grip = np.maximum(np.hypot(x + 6, y) - bow, 0.35 * bow - np.hypot(x + 7, y))
    groove = box(x - 3, y + 0.2 * width, 13, 0.22 * width)
    return sunk(np.maximum(groove, -x - 2), 0.45, 0.25) + prism(np.minimum(grip, blade), 0.2)


def cutter(draw: Draw, sheet: Sheet) -> Heights:
    """A saw blade or milling cutter: slanting teeth, deeper towards the rim."""
    teeth, radius, rake = draw.whole(5, 14), draw.between(5, 8.5), draw.between(0.2, 0.5)
    turn = np.mod(sheet.angle * teeth / (2 * np.pi), 1)
    outline = sheet.r - radius * (1 - rake * turn * 0.8)
    hub = np.minimum(outline, sheet.r - 0.5 * radius)
    return sunk(0.6 * radius - sheet.r, 0.5, 0.6) + prism(np.maximum(hub, 0.16 * radius - sheet.r), 0.25)


def spline(draw: Draw, sheet: Sheet) -> Heights:
    """The end of a splined shaft with a centre hole, on a collar."""
    splines, radius = draw.whole(5, 12), draw.between(2.5, 5)
    outline = polygon(sheet.x, sheet.y, starred(splines, radius, draw.between(0.72, 0.88), 0.0)) - 0.15
    hole = np.maximum(draw.between(0.25, 0.4) * radius - sheet.r, 0) * 1.2
    return raised(outline, draw.between(0.8, 1.8)) + hole + prism(sheet.r - radius - draw.between(1, 3))


def circuit(draw: Draw, sheet: Sheet) -> Heights:
    """A chip with its legs."""
    legs, pitch, body = draw.whole(3, 7), draw.between(1.2, 2), draw.between(4, 7)
    x, y = sheet.x, sheet.y
    length = legs * pitch
    row = np.maximum(
        np.abs(folded(x - (pitch / 2 if legs % 2 == 0 else 0), pitch)) - 0.25 * pitch, np.abs(x) - length / 2
    )
    leg = np.maximum(row, np.abs(y) - body / 2 - 2)
    mark = np.hypot(x + length / 2 - 1, y) - 0.5
    case = prism(box(x, y, length, body, 0.3), 0.3) + sunk(mark, 0.4)
    return np.minimum(case, prism(leg, 0.2) + 0.7 - 0.35 * np.maximum(np.abs(y) - body / 2 - 0.3, 0))


def hook(draw: Draw, sheet: Sheet) -> Heights:
    """Bent wire: a hook, an S, a clip."""
    kind, size, wire = draw.whole(0, 2), draw.between(2, 3.5), draw.between(0.5, 1)
    t = np.linspace(0, 1, 40)
    bow = np.stack([np.cos(np.pi * 1.3 * t), np.sin(np.pi * 1.3 * t)], axis=1)
    paths = (
        np.r_[[[1.0, -3.0]], bow] + np.array([0, 0.8]),
        np.r_[bow[::-1] - np.array([1, 0]), np.array([1, 0]) - bow[1:]],
        np.array([[-2, 1], [2, 1], [2, -1], [-2, -1], [-2, 0.4], [1.3, 0.4], [1.3, -0.4], [-1, -0.4]]) * 1.1,
    )
    return round_bar(line(*sheet.turned(draw.between(0, np.pi)), paths[kind] * size), wire)


MACHINES = (
    *(screw, bolt, nut, gear, spring, chain, bearing, rack, fan, cable, spanner, key, cutter, spline, circuit, hook),
)

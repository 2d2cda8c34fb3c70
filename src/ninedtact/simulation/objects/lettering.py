"""Letters: a font of strokes, and what is written with it."""

from functools import lru_cache

import numpy as np

from ninedtact.simulation.objects.outline import box, folded, line, prism, raised, stroke, sunk
from ninedtact.simulation.objects.sheet import Draw, Heights, Sheet

STROKES = """
A:06 20 46|14 34 ; B:06 00 30 41 42 33 03|33 44 45 36 06 ; C:41 30 10 01 05 16 36 45 ; D:06 00 20 42 44 26 06 ;
E:40 00 06 46|03 33 ; F:40 00 06|03 33 ; G:41 30 10 01 05 16 36 45 43 23 ; H:00 06|40 46|03 43 ;
I:10 30|20 26|16 36 ; J:40 45 36 16 05 ; K:00 06|40 03 46 ; L:00 06 46 ; M:06 00 23 40 46 ; N:06 00 46 40 ;
O:10 30 41 45 36 16 05 01 10 ; P:06 00 30 41 42 33 03 ; Q:10 30 41 45 36 16 05 01 10|24 46 ;
R:06 00 30 41 42 33 03|23 46 ; S:41 30 10 01 02 13 33 44 45 36 16 05 ; T:00 40|20 26 ; U:00 05 16 36 45 40 ;
V:00 26 40 ; W:00 16 23 36 40 ; X:00 46|40 06 ; Y:00 23 40|23 26 ; Z:00 40 06 46 ;
0:10 30 41 45 36 16 05 01 10|14 32 ; 1:11 20 26|16 36 ; 2:01 10 30 41 42 06 46 ; 4:36 30 04 44 ;
3:01 10 30 41 42 33 44 45 36 16 05|13 33 ; 5:40 00 02 32 43 45 36 16 05 ; 7:00 40 16 ;
6:41 30 10 01 05 16 36 45 44 33 03 ; 8:10 30 41 42 33 44 45 36 16 05 04 13 02 01 10|13 33 ;
9:05 16 36 45 41 30 10 01 02 13 43
"""
"""Polylines on a grid of 4 × 6, x to the right and y downwards, as the skin's image shows them."""
GLYPHS = dict(glyph.strip().split(":") for glyph in STROKES.split(";"))


@lru_cache(maxsize=8)
def alphabet() -> tuple[str, ...]:
    """All signs, letters first."""
    return tuple(sorted(GLYPHS, key=lambda sign: (sign.isdigit(), sign)))


def written(x: Heights, y: Heights, text: str, height_mm: float) -> Heights:
    """Distance to the strokes of a line of text in the middle, never negative."""
    unit = height_mm / 6
    strokes = []
    for place, sign in enumerate(text):
        offset = (6 * (place - (len(text) - 1) / 2) - 2) * unit
        for path in GLYPHS[sign].split("|"):
            points = np.array([[int(pair[0]), int(pair[1]) - 3] for pair in path.split()]) * unit
            strokes.append(line(x, y, points + np.array([offset, 0.0])))
    return np.minimum.reduce(strokes)


def signs(draw: Draw, count: int) -> str:
    """Random letters and digits."""
    return "".join(draw.random.choice(alphabet(), count).tolist())


def letter(draw: Draw, sheet: Sheet) -> Heights:
    """One large letter or digit."""
    sign = alphabet()[draw.whole(0, len(GLYPHS) - 1)]
    return prism(written(sheet.x, sheet.y, sign, draw.between(8, 14)) - draw.between(0.6, 1.1), 0.3)


def text(draw: Draw, sheet: Sheet) -> Heights:
    """A word on a plate."""
    count, height, relief = draw.whole(2, 5), draw.between(3, 7), draw.between(0.4, 1)
    height = min(height, 18 / count)
    letters = written(sheet.x, sheet.y, signs(draw, count), height) - height * 0.08
    plate = box(sheet.x, sheet.y, height * count + 2, height + 3, 0.6)
    return raised(letters, relief, 0.25) + prism(plate)


def stamp(draw: Draw, sheet: Sheet) -> Heights:
    """Two lines of text, sunk into a plate."""
    height, depth = draw.between(3, 4.5), draw.between(0.4, 0.9)
    count = 3 if height > 3.8 else 4
    rows = [written(sheet.x, sheet.y + shift * height * 0.75, signs(draw, count), height) for shift in (-1, 1)]
    plate = box(sheet.x, sheet.y, height * count + 1.5, 3 * height, 1)
    return sunk(np.minimum(*rows) - height * 0.11, depth, 0.25) + prism(plate)


def coin(draw: Draw, sheet: Sheet) -> Heights:
    """A rim, beads or notches within it, and a sign in the middle."""
    radius, beads, relief = draw.between(5, 9), draw.whole(16, 40), draw.between(0.25, 0.5)
    rim = np.abs(sheet.r - radius + 0.5) - 0.35
    around_bead = folded(sheet.angle, 2 * np.pi / beads) * sheet.r
    bead = np.hypot(around_bead, sheet.r - radius * 0.8) - radius * 0.8 * np.pi / beads * 0.55
    sign = written(sheet.x, sheet.y, signs(draw, 1), radius * 0.85) - radius * 0.07
    return raised(np.minimum(np.minimum(rim, bead), sign), relief, 0.25) + prism(sheet.r - radius)


def braille(draw: Draw, sheet: Sheet) -> Heights:
    """Cells of up to six dots."""
    scale, height = draw.between(0.9, 1.4), draw.between(0.4, 0.8)
    cells = int(15 / (6 * scale)) + 1
    dots = draw.random.random((cells, 2, 3)) < 0.55
    dots[:, 0, 0] = True
    places = [
        (6 * (cell - (cells - 1) / 2) + 2.5 * col - 1.25, 2.5 * row - 2.5) for cell, col, row in np.argwhere(dots)
    ]
    nearest = np.minimum.reduce([np.hypot(sheet.x - scale * x, sheet.y - scale * y) for x, y in places])
    plate = box(sheet.x, sheet.y, min(6 * cells * scale, 20), 9 * scale, 0.5)
    return height * np.clip(nearest / (0.9 * scale), 0, 1) ** 2 + prism(plate)


def barcode(draw: Draw, sheet: Sheet) -> Heights:
    """Bars of four widths."""
    module, relief, tall = draw.between(0.5, 0.8), draw.between(0.4, 0.9), draw.between(6, 11)
    widths = draw.random.integers(1, 4, 2 * int(4 / module) + 1) * module
    ends = np.cumsum(widths) - widths.sum() / 2
    bars = [np.abs(sheet.x - end + width / 2) - width / 2 for end, width in zip(ends[::2], widths[::2], strict=True)]
    outline = np.maximum(np.minimum.reduce(bars), np.abs(sheet.y) - tall / 2)
    return raised(outline, relief, 0.3) + prism(box(sheet.x, sheet.y, widths.sum() + 1.5, tall + 1.5, 0.3))


def dial(draw: Draw, sheet: Sheet) -> Heights:
    """A clock face: marks and two hands."""
    marks, radius, relief = draw.whole(6, 14), draw.between(6, 9), draw.between(0.4, 0.8)
    ticks = np.maximum(
        np.abs(folded(sheet.angle, 2 * np.pi / marks) * sheet.r) - 0.3, np.abs(sheet.r - 0.82 * radius) - 0.8
    )
    angles = (draw.between(0, 2 * np.pi), draw.between(0, 2 * np.pi))
    hands = [
        stroke(sheet.x, sheet.y, (0.0, 0.0), (size * radius * np.cos(angle), size * radius * np.sin(angle)))
        for size, angle in zip((0.45, 0.62), angles, strict=True)
    ]
    rim = np.abs(sheet.r - radius + 0.25) - 0.25
    return raised(np.minimum(np.minimum(np.minimum(*hands) - 0.4, ticks), rim), relief) + prism(sheet.r - radius)


LETTERING = (letter, text, stamp, coin, braille, barcode, dial)

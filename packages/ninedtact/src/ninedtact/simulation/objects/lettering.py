"""Lettering as height grids: a font of strokes, and objects that carry text or signs (stamps, coins, braille, barcodes).

To add an object, write its function and list it in `LETTERING`.
"""

from functools import lru_cache

import numpy as np

from ninedtact.simulation.objects.height_fields import (
    CoordinateGrid,
    DimensionSampler,
    Heightfield,
    HeightfieldFunction,
    flat_face,
    heights_raised_outside,
    polyline_sdf,
    recess_heights,
    rounded_rectangle_sdf,
    segment_sdf,
    wrap_to_pitch,
)

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
def _alphabet() -> tuple[str, ...]:
    """Return all signs of the font, letters first."""
    return tuple(sorted(GLYPHS, key=lambda sign: (sign.isdigit(), sign)))


def _written(x: Heightfield, y: Heightfield, text: str, height_mm: float) -> Heightfield:
    """Return the distance to the strokes of a line of text in the middle, which is never negative."""
    unit = height_mm / 6
    strokes = []
    for place, sign in enumerate(text):
        offset = (6 * (place - (len(text) - 1) / 2) - 2) * unit
        for path in GLYPHS[sign].split("|"):
            points = np.array([[int(pair[0]), int(pair[1]) - 3] for pair in path.split()]) * unit
            strokes.append(polyline_sdf(x, y, points + np.array([offset, 0.0])))
    return np.minimum.reduce(strokes)


def _signs(sample: DimensionSampler, count: int) -> str:
    """Return random letters and digits."""
    return "".join(sample.random.choice(_alphabet(), count).tolist())


def _letter(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of one large letter or digit."""
    sign = _alphabet()[sample.integer(0, len(GLYPHS) - 1)]
    return flat_face(_written(grid.x, grid.y, sign, sample.between(8, 14)) - sample.between(0.6, 1.1), 0.3)


def _text(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a word on a plate."""
    count, height, relief = sample.integer(2, 5), sample.between(3, 7), sample.between(0.4, 1)
    height = min(height, 18 / count)
    letters = _written(grid.x, grid.y, _signs(sample, count), height) - height * 0.08
    plate = rounded_rectangle_sdf(grid.x, grid.y, height * count + 2, height + 3, 0.6)
    return heights_raised_outside(letters, relief, 0.25) + flat_face(plate)


def _stamp(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a stamp: two lines of text, sunk into a plate."""
    height, depth = sample.between(3, 4.5), sample.between(0.4, 0.9)
    count = 3 if height > 3.8 else 4
    rows = [_written(grid.x, grid.y + shift * height * 0.75, _signs(sample, count), height) for shift in (-1, 1)]
    plate = rounded_rectangle_sdf(grid.x, grid.y, height * count + 1.5, 3 * height, 1)
    return recess_heights(np.minimum(*rows) - height * 0.11, depth, 0.25) + flat_face(plate)


def _coin(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a coin: a rim, beads or notches within it, and a sign in the middle."""
    radius, beads, relief = sample.between(5, 9), sample.integer(16, 40), sample.between(0.25, 0.5)
    rim = np.abs(grid.r - radius + 0.5) - 0.35
    around_bead = wrap_to_pitch(grid.angle, 2 * np.pi / beads) * grid.r
    bead = np.hypot(around_bead, grid.r - radius * 0.8) - radius * 0.8 * np.pi / beads * 0.55
    sign = _written(grid.x, grid.y, _signs(sample, 1), radius * 0.85) - radius * 0.07
    return heights_raised_outside(np.minimum(np.minimum(rim, bead), sign), relief, 0.25) + flat_face(grid.r - radius)


def _braille(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of braille cells of up to six dots."""
    scale, height = sample.between(0.9, 1.4), sample.between(0.4, 0.8)
    cells = int(15 / (6 * scale)) + 1
    dots = sample.random.random((cells, 2, 3)) < 0.55
    dots[:, 0, 0] = True
    places = [
        (6 * (cell - (cells - 1) / 2) + 2.5 * col - 1.25, 2.5 * row - 2.5) for cell, col, row in np.argwhere(dots)
    ]
    nearest = np.minimum.reduce([np.hypot(grid.x - scale * x, grid.y - scale * y) for x, y in places])
    plate = rounded_rectangle_sdf(grid.x, grid.y, min(6 * cells * scale, 20), 9 * scale, 0.5)
    return height * np.clip(nearest / (0.9 * scale), 0, 1) ** 2 + flat_face(plate)


def _barcode(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a barcode: bars of four widths."""
    module, relief, tall = sample.between(0.5, 0.8), sample.between(0.4, 0.9), sample.between(6, 11)
    widths = sample.random.integers(1, 4, 2 * int(4 / module) + 1) * module
    ends = np.cumsum(widths) - widths.sum() / 2
    bars = [np.abs(grid.x - end + width / 2) - width / 2 for end, width in zip(ends[::2], widths[::2], strict=True)]
    outline = np.maximum(np.minimum.reduce(bars), np.abs(grid.y) - tall / 2)
    return heights_raised_outside(outline, relief, 0.3) + flat_face(
        rounded_rectangle_sdf(grid.x, grid.y, widths.sum() + 1.5, tall + 1.5, 0.3)
    )


def _dial(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a clock face: marks and two hands."""
    marks, radius, relief = sample.integer(6, 14), sample.between(6, 9), sample.between(0.4, 0.8)
    ticks = np.maximum(
        np.abs(wrap_to_pitch(grid.angle, 2 * np.pi / marks) * grid.r) - 0.3, np.abs(grid.r - 0.82 * radius) - 0.8
    )
    angles = (sample.between(0, 2 * np.pi), sample.between(0, 2 * np.pi))
    hands = [
        segment_sdf(grid.x, grid.y, (0.0, 0.0), (size * radius * np.cos(angle), size * radius * np.sin(angle)))
        for size, angle in zip((0.45, 0.62), angles, strict=True)
    ]
    rim = np.abs(grid.r - radius + 0.25) - 0.25
    return heights_raised_outside(np.minimum(np.minimum(np.minimum(*hands) - 0.4, ticks), rim), relief) + flat_face(
        grid.r - radius
    )


LETTERING: dict[str, HeightfieldFunction] = {
    "letter": _letter,
    "text": _text,
    "stamp": _stamp,
    "coin": _coin,
    "braille": _braille,
    "barcode": _barcode,
    "dial": _dial,
}

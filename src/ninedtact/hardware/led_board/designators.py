"""Names of parts on the silkscreen, drawn with a pen: beside each part where there is room, else not at all."""

from collections.abc import Iterator
from dataclasses import dataclass

from shapely import LineString, box, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.copper import bare_board, hole_polygon, pad_polygon, via_polygon
from ninedtact.hardware.led_board.layout import Layout
from ninedtact.hardware.led_board.lettering import size_mm, written
from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.placement import Placed, Side

PEN_MM = 0.15
GAP_MM = 0.25
"""Between words and pads, bodies, holes, edges."""
CLEARLY = 1.35
"""Another part is so many times as far from a word as its own, or nobody knows whose it is."""


@dataclass(frozen=True)
class Word:
    """A part's name as lines on the board."""

    reference: str
    lines: tuple[tuple[Place, ...], ...]


def designators(layout: Layout, side: Side) -> tuple[Word, ...]:
    """Of the parts of one side, as far as there is room."""
    taken, room = occupied(layout, side), bare_board(layout.board.outline).buffer(-GAP_MM)
    parts, words = [part for part in layout.parts if part.side == side], []
    for part in parts:
        others = union_all([body(other) for other in parts if other != part])
        for at in around(part):
            lines = tuple(written(part.reference, at, side))
            shape = union_all([LineString(line) for line in lines]).envelope.buffer(PEN_MM / 2)
            free = room.contains(shape) and shape.distance(taken) > GAP_MM
            if free and shape.distance(others) > CLEARLY * shape.distance(body(part)):
                words.append(Word(part.reference, lines))
                taken = taken.union(shape)
                break
    return tuple(words)


def occupied(layout: Layout, side: Side) -> BaseGeometry:
    """Pads, vias, holes, marks and bodies of a side."""
    parts = [part for part in layout.parts if part.side == side]
    marks = [tuple(map(part.onto_board, part.part.footprint.mark_mm)) for part in parts if part.part.footprint.mark_mm]
    return union_all(
        [
            *(pad_polygon(pad) for pad in layout.pads if side in pad.sides),
            *map(via_polygon, layout.routes.vias),
            *map(hole_polygon, layout.holes),
            *(LineString(mark).buffer(PEN_MM / 2) for mark in marks),
            *map(body, parts),
        ]
    )


def body(part: Placed) -> BaseGeometry:
    """What a part covers."""
    footprint = part.part.footprint
    (x, y), (wide, deep) = part.onto_board(footprint.body_at_mm), part.size(footprint.body_mm[:2])
    return box(x - wide / 2, y - deep / 2, x + wide / 2, y + deep / 2)


def around(part: Placed) -> Iterator[Place]:
    """Where the middle of its name may lie: close to it first, below, above, right, left."""
    low_x, low_y, high_x, high_y = body(part).bounds
    x, y = (low_x + high_x) / 2, (low_y + high_y) / 2
    wide, tall = size_mm(part.reference)
    for away in (0.4, 0.6, 0.9, 1.2, 1.6, 2.0):
        for along in (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5):
            yield x + along, low_y - away - tall / 2
            yield x + along, high_y + away + tall / 2
            yield high_x + away + wide / 2, y + along
            yield low_x - away - wide / 2, y + along

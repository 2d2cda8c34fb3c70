"""The silkscreen of the LED board: reference designators in letters of single strokes, beside each component.

A designator for which there is no space is left out.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from shapely import LineString, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact_hardware.led_board.board_outline_and_holes import PointMm
from ninedtact_hardware.led_board.complete_layout import (
    BoardLayout,
    component_outline,
    hole_polygon,
    milled_board_polygon,
    pad_polygon,
    via_polygon,
)
from ninedtact_hardware.led_board.components import BoardSide, PlacedComponent

GRID_MM = 0.25
"""Step of the grid on which letters are drawn: 2 x 4 steps, 3 to the next letter, one mm tall."""
LETTER_WIDTH, LETTER_HEIGHT, LETTER_PITCH = 2, 4, 3
LETTERS: dict[str, tuple[tuple[PointMm, ...], ...]] = {
    "0": (((0, 0), (0, 4), (2, 4), (2, 0), (0, 0)),),
    "1": (((0, 3), (1, 4), (1, 0)), ((0, 0), (2, 0))),
    "2": (((0, 4), (2, 4), (2, 2), (0, 2), (0, 0), (2, 0)),),
    "3": (((0, 4), (2, 4), (2, 0), (0, 0)), ((0, 2), (2, 2))),
    "4": (((0, 4), (0, 2), (2, 2)), ((2, 4), (2, 0))),
    "5": (((2, 4), (0, 4), (0, 2), (2, 2), (2, 0), (0, 0)),),
    "6": (((2, 4), (0, 4), (0, 0), (2, 0), (2, 2), (0, 2)),),
    "7": (((0, 4), (2, 4), (1, 0)),),
    "8": (((0, 0), (0, 4), (2, 4), (2, 0), (0, 0)), ((0, 2), (2, 2))),
    "9": (((2, 2), (0, 2), (0, 4), (2, 4), (2, 0), (0, 0)),),
    "B": (((0, 0), (0, 4), (1.5, 4), (2, 3), (1.5, 2), (2, 1), (1.5, 0), (0, 0)), ((0, 2), (1.5, 2))),
    "C": (((2, 4), (0, 4), (0, 0), (2, 0)),),
    "D": (((0, 0), (0, 4), (1.3, 4), (2, 3), (2, 1), (1.3, 0), (0, 0)),),
    "E": (((2, 4), (0, 4), (0, 0), (2, 0)), ((0, 2), (1.5, 2))),
    "L": (((0, 4), (0, 0), (2, 0)),),
    "R": (((0, 0), (0, 4), (2, 4), (2, 2), (0, 2)), ((1, 2), (2, 0))),
    "S": (((2, 3.5), (1.5, 4), (0, 4), (0, 2), (2, 2), (2, 0), (0, 0), (0, 0.5)),),
    "U": (((0, 4), (0, 0), (2, 0), (2, 4)),),
}
"""Strokes of each letter, in grid steps from its lower left corner."""


def _text_size_mm(text: str) -> PointMm:
    """Return width and height of a text without the width of the pen."""
    return (LETTER_PITCH * len(text) - (LETTER_PITCH - LETTER_WIDTH)) * GRID_MM, LETTER_HEIGHT * GRID_MM


def _letter_strokes(text: str, middle: PointMm, side: BoardSide) -> Iterator[tuple[PointMm, ...]]:
    """Yield the strokes of a text around its middle, mirrored below the board so that it is read from there."""
    mirror = 1 if side == "top" else -1
    left = -_text_size_mm(text)[0] / GRID_MM / 2
    for number, letter in enumerate(text):
        for line in LETTERS[letter]:
            yield tuple(
                (
                    round(middle[0] + mirror * (left + LETTER_PITCH * number + x) * GRID_MM, 6),
                    round(middle[1] + (y - LETTER_HEIGHT / 2) * GRID_MM, 6),
                )
                for x, y in line
            )


PEN_MM = 0.15
GAP_MM = 0.25
"""Distance of texts from pads, bodies, holes and edges."""
OWNERSHIP_RATIO = 1.35
"""Least ratio of the distance to another component over that to its own, so that a text is attributed to the right one."""


@dataclass(frozen=True)
class SilkscreenDesignator:
    """The reference of a component as strokes on the board."""

    reference: str
    lines: tuple[tuple[PointMm, ...], ...]


def place_designators(layout: BoardLayout, side: BoardSide) -> tuple[SilkscreenDesignator, ...]:
    """Return the designators of the components of one side for which there is space."""
    taken, room = _occupied_area(layout, side), milled_board_polygon(layout.board.outline).buffer(-GAP_MM)
    parts, words = [part for part in layout.parts if part.side == side], []
    for part in parts:
        others = union_all([component_outline(other) for other in parts if other != part])
        for at in _candidate_positions(part):
            lines = tuple(_letter_strokes(part.reference, at, side))
            shape = union_all([LineString(line) for line in lines]).envelope.buffer(PEN_MM / 2)
            free = room.contains(shape) and shape.distance(taken) > GAP_MM
            if free and shape.distance(others) > OWNERSHIP_RATIO * shape.distance(component_outline(part)):
                words.append(SilkscreenDesignator(part.reference, lines))
                taken = taken.union(shape)
                break
    return tuple(words)


def _occupied_area(layout: BoardLayout, side: BoardSide) -> BaseGeometry:
    """Return the area of pads, vias, holes, marks and bodies of one side."""
    parts = [part for part in layout.parts if part.side == side]
    marks = [
        tuple(map(part.to_board_frame, part.part.footprint.mark_mm)) for part in parts if part.part.footprint.mark_mm
    ]
    return union_all(
        [
            *(pad_polygon(pad) for pad in layout.pads if side in pad.sides),
            *map(via_polygon, layout.routes.vias),
            *map(hole_polygon, layout.holes),
            *(LineString(mark).buffer(PEN_MM / 2) for mark in marks),
            *map(component_outline, parts),
        ]
    )


def _candidate_positions(part: PlacedComponent) -> Iterator[PointMm]:
    """Yield positions for the middle of a designator: close to the component first, below, above, right, left."""
    low_x, low_y, high_x, high_y = component_outline(part).bounds
    x, y = (low_x + high_x) / 2, (low_y + high_y) / 2
    wide, tall = _text_size_mm(part.reference)
    for away in (0.4, 0.6, 0.9, 1.2, 1.6, 2.0):
        for along in (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5):
            yield x + along, low_y - away - tall / 2
            yield x + along, high_y + away + tall / 2
            yield high_x + away + wide / 2, y + along
            yield low_x - away - wide / 2, y + along

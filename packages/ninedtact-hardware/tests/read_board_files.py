"""The stored files of the LED board read by gerbonara: layers as shapes, holes, and the pads of the KiCad project."""

from dataclasses import dataclass
from math import atan2, cos, dist, hypot, pi, sin
from pathlib import Path
from typing import Any

from gerbonara import ExcellonFile, GerberFile
from gerbonara.cad.kicad.pcb import Board
from gerbonara.graphic_primitives import Circle, Line, Rectangle
from gerbonara.utils import MM
from shapely import LineString, Point, Polygon, affinity, box, make_valid
from shapely.geometry.base import BaseGeometry

Place = tuple[float, float]


def shape_of(file: Path) -> BaseGeometry:
    """What a Gerber layer covers."""
    covered: BaseGeometry = Polygon()
    for drawn in GerberFile.open(file).objects:
        for primitive in drawn.to_primitives(unit=MM):
            piece = piece_of(primitive)
            covered = covered | piece if primitive.polarity_dark else covered - piece
    return covered


def piece_of(primitive: Any) -> BaseGeometry:
    """One primitive as a shape."""
    match primitive:
        case Circle():
            return Point(primitive.x, primitive.y).buffer(primitive.r)
        case Line():
            line = LineString([(primitive.x1, primitive.y1), (primitive.x2, primitive.y2)])
            return line.buffer(primitive.width / 2)
        case Rectangle():
            x, y, w, h = primitive.x, primitive.y, primitive.w / 2, primitive.h / 2
            return affinity.rotate(box(x - w, y - h, x + w, y + h), primitive.rotation, (x, y), use_radians=True)
    points: list[Place] = []
    for start, end, (clockwise, centre) in primitive.segments:
        points += [start, end] if clockwise is None else arc(start, end, centre, clockwise)
    return make_valid(Polygon(points), method="structure")


def arc(start: Place, end: Place, centre: Place, clockwise: bool) -> list[Place]:
    """An arc as points, its ends among them."""
    (x, y), radius = centre, dist(start, centre)
    first = atan2(start[1] - y, start[0] - x)
    sweep = (atan2(end[1] - y, end[0] - x) - first) % (2 * pi) or 2 * pi
    sweep = sweep - 2 * pi if clockwise else sweep
    between = [first + sweep * step / 200 for step in range(1, 200)]
    return [start, *((x + radius * cos(angle), y + radius * sin(angle)) for angle in between), end]


def edge_of(file: Path) -> BaseGeometry:
    """The board that a profile layer cuts out: the largest of its rings less the others. Every ring must close."""
    rings: list[list[Place]] = []
    for drawn in GerberFile.open(file).objects:
        start, end = (drawn.x1, drawn.y1), (drawn.x2, drawn.y2)
        points = [start, end]
        if hasattr(drawn, "clockwise"):
            points = arc(start, end, (drawn.x1 + drawn.cx, drawn.y1 + drawn.cy), drawn.clockwise)
        if rings and dist(rings[-1][-1], start) < 1e-5 and dist(rings[-1][0], rings[-1][-1]) > 1e-5:
            rings[-1] += points[1:]
        else:
            rings.append(points)
    assert all(hypot(ring[0][0] - ring[-1][0], ring[0][1] - ring[-1][1]) < 1e-5 for ring in rings)
    largest, *others = sorted(map(Polygon, rings), key=lambda ring: -ring.area)
    for other in others:
        largest = largest.difference(other)
    return largest


def hits_of(file: Path) -> list[tuple[float, float, float]]:
    """x, y and diameter of the round holes."""
    return sorted((round(hit.x, 4), round(hit.y, 4), hit.aperture.diameter) for hit in ExcellonFile.open(file).drills())


def slots_of(file: Path) -> list[BaseGeometry]:
    """The slots as shapes."""
    slots = ExcellonFile.open(file).slots()
    return [LineString([(s.x1, s.y1), (s.x2, s.y2)]).buffer(s.aperture.diameter / 2) for s in slots]


@dataclass(frozen=True)
class Pad:
    """A pad of a component, as the KiCad project has it."""

    at_mm: Place
    net: str | None
    sides: str
    """F, B or FB."""


SHEET_CENTRE_MM = 148.5, 105.0


def pads_of(board: Board) -> dict[str, Pad]:
    """Pads by their pin, such as U1.3."""
    found = {}
    for part in board.footprints:
        for pad in part.pads:
            if pad.number:
                x, y = part.at.x + pad.at.x - SHEET_CENTRE_MM[0], SHEET_CENTRE_MM[1] - part.at.y - pad.at.y
                sides = "FB" if "*.Cu" in pad.layers else pad.layers[0][0]
                found[f"{part.texts[0].text}.{pad.number}"] = Pad((x, y), pad.net.name if pad.net else None, sides)
    return found

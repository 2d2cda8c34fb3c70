"""Nouns of the board as polygons. shapely lives here and in the rooms that compute with them."""

from shapely import LineString, MultiPoint, Point, Polygon, box, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.outline import BoardOutline, Place
from ninedtact.hardware.led_board.pads import Hole, Pad
from ninedtact.hardware.led_board.tracks import Track, Via

QUARTER = 16
"""Straight pieces that stand for a quarter of a circle."""


def pad_polygon(pad: Pad) -> BaseGeometry:
    """A pad with its rounded corners, less what it gave up."""
    bites = union_all([capsule(bite.start_mm, bite.end_mm, bite.radius_mm) for bite in pad.bites])
    return rounded(pad.at_mm, pad.size_mm, pad.land.corner_mm).difference(bites)


def rounded(at: Place, size: Place, corner: float) -> BaseGeometry:
    """A rectangle with rounded corners; with corners of half its width, a slot's shape."""
    (x, y), inner = at, (size[0] / 2 - corner, size[1] / 2 - corner)
    if not corner:
        return box(x - inner[0], y - inner[1], x + inner[0], y + inner[1])
    centres = MultiPoint([(x + a * inner[0], y + b * inner[1]) for a in (-1, 1) for b in (-1, 1)])
    return centres.convex_hull.buffer(corner, quad_segs=QUARTER)


def capsule(start: Place, end: Place, radius: float) -> BaseGeometry:
    """Everything nearer than the radius to a line between two places, which may be one."""
    line: BaseGeometry = Point(start) if start == end else LineString([start, end])
    return line.buffer(radius, quad_segs=QUARTER)


def track_polygon(track: Track) -> BaseGeometry:
    """A line with round ends and corners."""
    return LineString(track.points).buffer(track.width_mm / 2, quad_segs=QUARTER)


def via_polygon(via: Via) -> BaseGeometry:
    """Its ring with the hole filled, which is how copper layers are drawn."""
    return Point(via.at_mm).buffer(via.diameter_mm / 2, quad_segs=QUARTER)


def hole_polygon(hole: Hole) -> BaseGeometry:
    """What the drill takes."""
    return capsule(hole.start_mm, hole.end_mm, hole.width_mm / 2)


def bare_board(outline: BoardOutline) -> BaseGeometry:
    """The laminate after milling: without notches and lens hole, drilled holes still filled."""
    (x, y), fine = outline.half, 4 * QUARTER
    notches = [Point(place).buffer(outline.notch_radius_mm, quad_segs=fine) for place in outline.notches]
    lens = Point(0, 0).buffer(outline.lens_hole_mm / 2, quad_segs=fine)
    return box(-x, -y, x, y).difference(union_all([*notches, lens]))


def polygons(shape: BaseGeometry) -> tuple[Polygon, ...]:
    """The polygons that a shape is made of."""
    parts = getattr(shape, "geoms", (shape,))
    return tuple(part for part in parts if isinstance(part, Polygon) and not part.is_empty)

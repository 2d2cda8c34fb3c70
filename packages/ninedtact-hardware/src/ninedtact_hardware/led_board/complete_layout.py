"""The layout of the LED board: components placed, nets routed, ground poured.

Pads, tracks, vias and holes are shapely polygons; those with holes are merged into one contour where a file format needs it.
"""

from dataclasses import dataclass
from itertools import pairwise

from shapely import LinearRing, LineString, MultiPoint, Point, Polygon, box, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact_hardware.led_board.board_outline_and_holes import BoardOutline, PointMm
from ninedtact_hardware.led_board.board_parameters import LedBoardDesign
from ninedtact_hardware.led_board.components import (
    GROUND,
    BoardPad,
    BoardSide,
    DrilledHole,
    Net,
    PlacedComponent,
    build_netlist,
    connector_peg_holes,
    place_components,
    place_pads,
)
from ninedtact_hardware.led_board.routing import Routes, Track, Via, route_board

SEGMENTS_PER_QUARTER = 16
"""Straight pieces that approximate a quarter of a circle."""


def pad_polygon(pad: BoardPad) -> BaseGeometry:
    """Return a pad with its rounded corners, less its cutouts."""
    cutouts = union_all([_capsule(one.start_mm, one.end_mm, one.radius_mm) for one in pad.cutouts])
    return _rounded_rectangle(pad.at_mm, pad.size_mm, pad.land.corner_mm).difference(cutouts)


def _rounded_rectangle(at: PointMm, size: PointMm, corner: float) -> BaseGeometry:
    """Return a rectangle with rounded corners; with corners of half its width, the shape of a slot."""
    (x, y), inner = at, (size[0] / 2 - corner, size[1] / 2 - corner)
    if not corner:
        return box(x - inner[0], y - inner[1], x + inner[0], y + inner[1])
    centres = MultiPoint([(x + a * inner[0], y + b * inner[1]) for a in (-1, 1) for b in (-1, 1)])
    return centres.convex_hull.buffer(corner, quad_segs=SEGMENTS_PER_QUARTER)


def _capsule(start: PointMm, end: PointMm, radius: float) -> BaseGeometry:
    """Return everything nearer than the radius to a line between two points, which may coincide."""
    line: BaseGeometry = Point(start) if start == end else LineString([start, end])
    return line.buffer(radius, quad_segs=SEGMENTS_PER_QUARTER)


def track_polygon(track: Track) -> BaseGeometry:
    """Return a track as a line with round ends and corners."""
    return LineString(track.points).buffer(track.width_mm / 2, quad_segs=SEGMENTS_PER_QUARTER)


def via_polygon(via: Via) -> BaseGeometry:
    """Return the ring of a via with its hole filled, which is how copper layers are drawn."""
    return Point(via.at_mm).buffer(via.diameter_mm / 2, quad_segs=SEGMENTS_PER_QUARTER)


def hole_polygon(hole: DrilledHole) -> BaseGeometry:
    """Return the area that the drill removes."""
    return _capsule(hole.start_mm, hole.end_mm, hole.width_mm / 2)


def component_outline(part: PlacedComponent) -> Polygon:
    """Return the area on the board that a component's body covers."""
    footprint = part.part.footprint
    (x, y), (wide, deep) = part.to_board_frame(footprint.body_at_mm), part.size_on_board(footprint.body_mm[:2])
    return box(x - wide / 2, y - deep / 2, x + wide / 2, y + deep / 2)


def milled_board_polygon(outline: BoardOutline) -> BaseGeometry:
    """Return the laminate after milling: without notches and lens hole, drilled holes still filled."""
    (x, y), fine = outline.half, 4 * SEGMENTS_PER_QUARTER
    notches = [Point(place).buffer(outline.notch_radius_mm, quad_segs=fine) for place in outline.notches]
    lens = Point(0, 0).buffer(outline.lens_hole_mm / 2, quad_segs=fine)
    return box(-x, -y, x, y).difference(union_all([*notches, lens]))


def split_polygons(shape: BaseGeometry) -> tuple[Polygon, ...]:
    """Return the polygons of which a shape consists."""
    parts = getattr(shape, "geoms", (shape,))
    return tuple(part for part in parts if isinstance(part, Polygon) and not part.is_empty)


def merge_polygon_holes(polygon: Polygon) -> tuple[PointMm, ...]:
    """Return a polygon with holes as one open contour, each hole joined by a cut of no width to what lies left of it.

    Gerber regions and KiCad's fills have no holes.
    """
    contour = distinct_ring_vertices(polygon.exterior)
    for hole in sorted(
        (_start_at_leftmost(distinct_ring_vertices(interior)) for interior in polygon.interiors), key=lambda h: h[0][0]
    ):
        after, cut = _nearest_point_left(contour, hole[0])
        contour = [*contour[: after + 1], cut, *hole, hole[0], cut, *contour[after + 1 :]]
    return tuple(contour)


def distinct_ring_vertices(ring: LinearRing) -> list[PointMm]:
    """Return the points of a closed ring without the last, which repeats the first."""
    return [(x, y) for x, y in ring.coords[:-1]]


def _start_at_leftmost(hole: list[PointMm]) -> list[PointMm]:
    """Return the ring begun at its leftmost point."""
    start = hole.index(min(hole))
    return hole[start:] + hole[:start]


def _nearest_point_left(contour: list[PointMm], point: PointMm) -> tuple[int, PointMm]:
    """Return the nearest point of a contour straight left of a point, and the number of the edge that it is on."""
    x, y = point
    found = []
    for number, (a, b) in enumerate(pairwise([*contour, contour[0]])):
        if (a[1] > y) != (b[1] > y):
            cut = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
            if cut < x:
                found.append((cut, number))
    cut, number = max(found)
    return number, (cut, y)


MIN_POUR_WIDTH_MM = 0.25
"""Least width of the pour; narrower slivers are left out."""
SPARE_MM = 0.01
"""Margin added to the gap, because circles are approximated by polygons that lie a little inside."""


def _pour_ground(
    board: LedBoardDesign, side: BoardSide, pads: tuple[BoardPad, ...], routes: Routes, holes: tuple[DrilledHole, ...]
) -> tuple[Polygon, ...]:
    """Return the pieces of the ground pour on one side; each is connected to some ground copper."""
    gap, (avoided, ground) = board.rules.pour_gap_mm, _copper_beside_pour(side, pads, routes)
    kept = union_all([shape.buffer(gap + SPARE_MM) for shape in avoided])
    bored = union_all([hole_polygon(hole).buffer(gap + SPARE_MM) for hole in holes if not hole.plated])
    free = (
        milled_board_polygon(board.outline)
        .buffer(-max(gap, board.rules.copper_to_edge_mm) - 0.02)
        .difference(kept | bored)
    )
    thick = free.buffer(-MIN_POUR_WIDTH_MM / 2).buffer(MIN_POUR_WIDTH_MM / 2)
    opened = thick.intersection(free).simplify(0.004)
    joined = union_all(ground)
    return tuple(piece for piece in split_polygons(opened) if piece.intersection(joined).area > 0.01)


def _copper_beside_pour(
    side: BoardSide, pads: tuple[BoardPad, ...], routes: Routes
) -> tuple[list[BaseGeometry], list[BaseGeometry]]:
    """Return the copper of one side that the pour avoids, and the ground copper to which a piece of it may connect.

    It avoids other nets, and ground pads that a soldering iron must be able to heat.
    """
    copper = [(pad_polygon(pad), pad.net == GROUND and not pad.land.pour_gap) for pad in pads if side in pad.sides]
    copper += [(track_polygon(track), track.net == GROUND) for track in routes.tracks if track.side == side]
    copper += [(via_polygon(via), via.net == GROUND) for via in routes.vias]
    return [shape for shape, joins in copper if not joins], [shape for shape, joins in copper if joins]


SIDES: tuple[BoardSide, BoardSide] = ("top", "bottom")


@dataclass(frozen=True)
class BoardLayout:
    """A board with everything that the content of its files is derived from."""

    board: LedBoardDesign
    nets: tuple[Net, ...]
    parts: tuple[PlacedComponent, ...]
    pads: tuple[BoardPad, ...]
    routes: Routes
    holes: tuple[DrilledHole, ...]
    """Vias, slots, pegs and locating holes; the lens hole is milled with the outline."""
    pours: dict[BoardSide, tuple[Polygon, ...]]
    """Ground pours by side."""


def lay_out_board(board: LedBoardDesign) -> BoardLayout:
    """Place the components of a board, route its nets and pour its ground."""
    found = place_pads(board)
    routes = route_board(board, found)
    holes = _all_holes(board, found, routes)
    pours = {side: _pour_ground(board, side, found, routes, holes) if board.copper.pour else () for side in SIDES}
    return BoardLayout(board, build_netlist(board), place_components(board), found, routes, holes, pours)


def _all_holes(board: LedBoardDesign, found: tuple[BoardPad, ...], routes: Routes) -> tuple[DrilledHole, ...]:
    """Return everything that is drilled."""
    vias = (DrilledHole(via.at_mm, via.at_mm, via.drill_mm, plated=True) for via in routes.vias)
    slots = (pad.hole for pad in found if pad.hole)
    size = board.outline.locating_hole_mm
    locating = (DrilledHole(place, place, size, plated=False) for place in board.outline.locating_holes)
    return (*vias, *slots, *connector_peg_holes(board), *locating)

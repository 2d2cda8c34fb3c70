"""The layout of the LED board: components placed, nets routed, ground poured."""

from dataclasses import dataclass

from shapely import Polygon, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.board_parameters import LedBoard
from ninedtact.hardware.led_board.components import BoardSide, PlacedComponent, place_components
from ninedtact.hardware.led_board.copper_geometry import (
    bare_board_polygon,
    hole_polygon,
    pad_polygon,
    split_polygons,
    track_polygon,
    via_polygon,
)
from ninedtact.hardware.led_board.netlist_and_pads import (
    GROUND,
    BoardPad,
    DrilledHole,
    Net,
    build_netlist,
    connector_peg_holes,
    place_pads,
)
from ninedtact.hardware.led_board.routing import Routes, _route_connector, _route_driver, _route_led_ring

MIN_POUR_WIDTH_MM = 0.25
"""Least width of the pour; narrower slivers are left out."""
SPARE_MM = 0.01
"""Margin added to the gap, because circles are approximated by polygons that lie a little inside."""


def _pour_ground(
    board: LedBoard, side: BoardSide, pads: tuple[BoardPad, ...], routes: Routes, holes: tuple[DrilledHole, ...]
) -> tuple[Polygon, ...]:
    """Return the pieces of the ground pour on one side; each is connected to some ground copper."""
    gap, (avoided, ground) = board.rules.pour_gap_mm, _copper_beside_pour(side, pads, routes)
    kept = union_all([shape.buffer(gap + SPARE_MM) for shape in avoided])
    bored = union_all([hole_polygon(hole).buffer(gap + SPARE_MM) for hole in holes if not hole.plated])
    free = (
        bare_board_polygon(board.outline)
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

    board: LedBoard
    nets: tuple[Net, ...]
    parts: tuple[PlacedComponent, ...]
    pads: tuple[BoardPad, ...]
    routes: Routes
    holes: tuple[DrilledHole, ...]
    """Vias, slots, pegs and locating holes; the lens hole is milled with the outline."""
    pours: dict[BoardSide, tuple[Polygon, ...]]
    """Ground pours by side."""


def lay_out_board(board: LedBoard) -> BoardLayout:
    """Place the components of a board, route its nets and pour its ground."""
    found = place_pads(board)
    routes = _route_led_ring(board) + _route_driver(board, found) + _route_connector(board, found)
    holes = _all_holes(board, found, routes)
    pours = {side: _pour_ground(board, side, found, routes, holes) if board.copper.pour else () for side in SIDES}
    return BoardLayout(board, build_netlist(board), place_components(board), found, routes, holes, pours)


def _all_holes(board: LedBoard, found: tuple[BoardPad, ...], routes: Routes) -> tuple[DrilledHole, ...]:
    """Return everything that is drilled."""
    vias = (DrilledHole(via.at_mm, via.at_mm, via.drill_mm, plated=True) for via in routes.vias)
    slots = (pad.hole for pad in found if pad.hole)
    size = board.outline.locating_hole_mm
    locating = (DrilledHole(place, place, size, plated=False) for place in board.outline.locating_holes)
    return (*vias, *slots, *connector_peg_holes(board), *locating)

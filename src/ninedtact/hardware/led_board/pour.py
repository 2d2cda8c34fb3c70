"""Ground wherever nothing else is."""

from shapely import Polygon, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.copper import (
    bare_board,
    hole_polygon,
    pad_polygon,
    polygons,
    track_polygon,
    via_polygon,
)
from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.netlist import GROUND
from ninedtact.hardware.led_board.pads import Hole, Pad
from ninedtact.hardware.led_board.placement import Side
from ninedtact.hardware.led_board.tracks import Routes

NARROWEST_MM = 0.25
"""Slivers thinner than this are left out."""
SPARE_MM = 0.01
"""Added to the gap: circles are drawn as polygons, a little inside."""


def pour(
    board: LedBoard, side: Side, pads: tuple[Pad, ...], routes: Routes, holes: tuple[Hole, ...]
) -> tuple[Polygon, ...]:
    """The pieces of the pour on one side; each holds on to some ground."""
    gap = board.rules.pour_gap_mm
    kept = union_all([shape.buffer(gap + SPARE_MM) for shape in kept_clear(side, pads, routes)])
    bored = union_all([hole_polygon(hole).buffer(gap + SPARE_MM) for hole in holes if not hole.plated])
    free = bare_board(board.outline).buffer(-max(gap, board.rules.copper_to_edge_mm) - 0.02).difference(kept | bored)
    thick = free.buffer(-NARROWEST_MM / 2).buffer(NARROWEST_MM / 2)
    opened = thick.intersection(free).simplify(0.004)
    ground = union_all(grounded(side, pads, routes))
    return tuple(piece for piece in polygons(opened) if piece.intersection(ground).area > 0.01)


def kept_clear(side: Side, pads: tuple[Pad, ...], routes: Routes) -> list[BaseGeometry]:
    """Copper of other nets, and ground pads that an iron must be able to heat."""
    keep = [pad_polygon(pad) for pad in pads if side in pad.sides and (pad.net != GROUND or pad.land.pour_gap)]
    keep += [track_polygon(track) for track in routes.tracks if track.side == side and track.net != GROUND]
    return keep + [via_polygon(via) for via in routes.vias if via.net != GROUND]


def grounded(side: Side, pads: tuple[Pad, ...], routes: Routes) -> list[BaseGeometry]:
    """Ground copper that a piece of the pour may hold on to."""
    hold = [pad_polygon(pad) for pad in pads if side in pad.sides and pad.net == GROUND and not pad.land.pour_gap]
    hold += [track_polygon(track) for track in routes.tracks if track.side == side and track.net == GROUND]
    return hold + [via_polygon(via) for via in routes.vias if via.net == GROUND]

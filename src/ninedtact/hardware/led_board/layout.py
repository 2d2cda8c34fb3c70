"""The whole board: parts placed, nets routed, ground poured."""

from dataclasses import dataclass

from shapely import Polygon

from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.driver_routes import driver_routes
from ninedtact.hardware.led_board.netlist import Net, netlist
from ninedtact.hardware.led_board.pads import Hole, Pad, pads, pegs
from ninedtact.hardware.led_board.placement import Placed, Side, placement
from ninedtact.hardware.led_board.pour import pour
from ninedtact.hardware.led_board.ring_routes import ring_routes
from ninedtact.hardware.led_board.tracks import Routes, Via
from ninedtact.hardware.led_board.usb_routes import usb_routes

SIDES: tuple[Side, Side] = ("top", "bottom")


@dataclass(frozen=True)
class Layout:
    """What the files are written from."""

    board: LedBoard
    nets: tuple[Net, ...]
    parts: tuple[Placed, ...]
    pads: tuple[Pad, ...]
    routes: Routes
    holes: tuple[Hole, ...]
    """Vias, slots, pegs and locating holes; the lens hole is milled with the outline."""
    pours: dict[Side, tuple[Polygon, ...]]
    """Ground, by side."""


def lay_out(board: LedBoard) -> Layout:
    """Place, route and pour."""
    found = pads(board)
    routes = ring_routes(board) + driver_routes(board, found) + usb_routes(board, found)
    holes = all_holes(board, found, routes)
    pours = {side: pour(board, side, found, routes, holes) if board.copper.pour else () for side in SIDES}
    return Layout(board, netlist(board), placement(board), found, routes, holes, pours)


def all_holes(board: LedBoard, found: tuple[Pad, ...], routes: Routes) -> tuple[Hole, ...]:
    """Everything that is drilled."""
    slots = tuple(pad.hole for pad in found if pad.hole)
    size = board.outline.locating_hole_mm
    locating = tuple(Hole(place, place, size, plated=False) for place in board.outline.locating_holes)
    return (*map(via_hole, routes.vias), *slots, *pegs(board), *locating)


def via_hole(via: Via) -> Hole:
    """The hole of a via."""
    return Hole(via.at_mm, via.at_mm, via.drill_mm, plated=True)

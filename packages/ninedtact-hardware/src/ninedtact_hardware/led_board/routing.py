"""Routing of the LED board: its tracks and vias.

Upper side: one line joins all anodes inside the ring of LEDs, another all cathodes outside of it, and they never cross.
The anodes' ring is open at the lower left, where the cathodes of the left column leave. Lower side: U1's output,
setting resistor and ground, and the supply from the connector, 5 V right of the lens hole and ground left of it.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import dist, hypot

from ninedtact_hardware.led_board.board_outline_and_holes import PointMm
from ninedtact_hardware.led_board.board_parameters import LedBoardDesign
from ninedtact_hardware.led_board.components import GROUND, LED_LINE, SETTING, SUPPLY, BoardPad, BoardSide, pad_position


@dataclass(frozen=True)
class Track:
    """A line of constant width with round ends through these points."""

    net: str
    side: BoardSide
    width_mm: float
    points: tuple[PointMm, ...]


@dataclass(frozen=True)
class Via:
    """A plated hole, covered by the solder mask on both sides."""

    net: str
    at_mm: PointMm
    diameter_mm: float
    drill_mm: float


@dataclass(frozen=True)
class Routes:
    """Tracks and vias together."""

    tracks: tuple[Track, ...] = ()
    vias: tuple[Via, ...] = ()

    def __add__(self, other: "Routes") -> "Routes":
        return Routes(self.tracks + other.tracks, self.vias + other.vias)


ANODE_MM, CATHODE_MM = -1.462, 1.0
"""Offsets of the pads' centres from an LED's centre along x."""
TAP_MM = -1.05
"""Offset at which a line leaves an anode of the upper or lower row, beside the connector's peg."""
LINK_MM = 1.8
"""Distance of the anodes' lines between the columns from these rows: past the LEDs' pads and the pegs, not into the
lens hole."""
RIM_MM = 0.27
"""Distance of the ground line from the board's edge."""


def _rim_line_y(board: LedBoardDesign) -> float:
    """Return how far from the middle the ground lines run along the upper and lower edges."""
    return board.outline.half[1] - RIM_MM - board.copper.ground_mm / 2


def route_board(board: LedBoardDesign, pads: tuple[BoardPad, ...]) -> Routes:
    """Return all tracks and vias of a board with these pads."""
    ring = _route_anodes(board) + _route_cathodes(board)
    return ring + _route_driver(board, pads) + _route_connector(board, pads)


def _route_anodes(board: LedBoardDesign) -> Routes:
    """Return left column, upper link, right column, and a lower link from the right."""
    columns, (top, bottom) = board.leds.columns_mm, (board.leds.rows_mm[0], board.leds.rows_mm[-1])
    left, right = columns[0] + ANODE_MM, columns[-1] + ANODE_MM
    lines: list[tuple[PointMm, ...]] = [
        ((left, top), (left, bottom)),
        ((left, top - LINK_MM), (right, top - LINK_MM)),
        ((right, top), (right, bottom)),
    ]
    inner = [x + TAP_MM for x in columns[1:-1]]
    if inner:
        lines.append(((inner[0], bottom + LINK_MM), (right, bottom + LINK_MM)))
    lines += [((x, row), (x, link)) for x in inner for row, link in ((top, top - LINK_MM), (bottom, bottom + LINK_MM))]
    return Routes(tuple(Track(LED_LINE, "top", board.copper.led_mm, line) for line in lines))


def _route_cathodes(board: LedBoardDesign) -> Routes:
    """Return the line along the upper edge, down the right column, along the lower edge, and up the left column to its
    last but one."""
    cathodes, rows = [x + CATHODE_MM for x in board.leds.columns_mm], board.leds.rows_mm
    left, right, edge = cathodes[0], cathodes[-1], _rim_line_y(board)
    lines: list[tuple[PointMm, ...]] = [
        ((left, edge), (right, edge)),
        ((right, edge), (right, -edge)),
        ((left, -edge), (right, -edge)),
        ((left, -edge), (left, rows[1])),
    ]
    lines += [((x, rows[0]), (x, edge)) for x in cathodes[:-1]]
    lines += [((x, rows[-1]), (x, -edge)) for x in cathodes[1:-1]]
    return Routes(tuple(Track(GROUND, "top", board.copper.ground_mm, line) for line in lines))


THERMAL_VIAS = (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)
"""Offsets from the middle of the vias under the driver, which carry its heat to the upper side."""
SLOPE_MM = 1.3
"""Greatest length of an oblique line along x."""


def _route_driver(board: LedBoardDesign, pads: tuple[BoardPad, ...]) -> Routes:
    """Return all routes of U1 but its supply."""
    setting = Track(SETTING, "bottom", board.copper.signal_mm, (pad_position(pads, "R1.2"), pad_position(pads, "U1.1")))
    return (
        _route_driver_output(board, pads)
        + Routes((setting,))
        + _route_thermal_pad(board)
        + _route_driver_ground(board, pads)
    )


def _make_via(board: LedBoardDesign, net: str, place: PointMm) -> Via:
    """Return a via of the board's usual size."""
    return Via(net, place, board.copper.via_mm, board.copper.via_drill_mm)


def _route_driver_output(board: LedBoardDesign, pads: tuple[BoardPad, ...]) -> Routes:
    """Return the routes from both output pins through the vias to an anode of the upper row."""
    vias, width = [board.from_driver(place) for place in board.led_vias_from_driver_mm], board.copper.led_mm
    beside, first = board.driver[0] + 3.71, vias[0]
    tracks = [
        Track(LED_LINE, "bottom", width, (pin, (beside, pin[1]), first))
        for pin in (pad_position(pads, "U1.5"), pad_position(pads, "U1.6"))
    ]
    tracks += [Track(LED_LINE, side, width, pair) for pair in pairwise(vias) for side in ("top", "bottom")]
    tracks.append(Track(LED_LINE, "top", width, _path_to_anode(board, first)))
    return Routes(tuple(tracks), tuple(_make_via(board, LED_LINE, place) for place in vias))


def _path_to_anode(board: LedBoardDesign, start: PointMm) -> tuple[PointMm, ...]:
    """Return the path from a via to the next anode of the upper row: level, a slope, and down."""
    (x, y), row = start, board.leds.rows_mm[0]
    anodes = [column + ANODE_MM for column in board.leds.columns_mm]
    anode = next((anode for anode in anodes if anode > x - SLOPE_MM), anodes[-1])
    slope = min(abs(anode - x), SLOPE_MM)
    level = (anode - slope if anode > x else anode + slope, y)
    return (*((start,) if dist(start, level) > 0.01 else ()), level, (anode, y - slope), (anode, row))


def _route_thermal_pad(board: LedBoardDesign) -> Routes:
    """Return the vias under the driver, joined above and led to the ground line at the edge."""
    places = [board.from_driver(offset) for offset in THERMAL_VIAS]
    x, y = board.driver
    square = Track(GROUND, "top", board.copper.ground_mm, (*places, places[0]))
    to_edge = Track(GROUND, "top", board.copper.ground_mm, ((x, y + 0.5), (x, _rim_line_y(board))))
    return Routes((square, to_edge), tuple(_make_via(board, GROUND, place) for place in places))


def _route_driver_ground(board: LedBoardDesign, pads: tuple[BoardPad, ...]) -> Routes:
    """Return the line below the board, left of the driver, that joins resistor, capacitor and ground pin, and its via."""
    x, y = board.driver
    start, pin, width = _ground_column_x(board), pad_position(pads, "U1.2"), board.copper.ground_mm
    through = board.from_driver(board.ground_via_from_driver_mm)
    main = ((min(start, through[0]), y), (x - 4.44, y))
    lines: list[tuple[PointMm, ...]] = [main, (through, (through[0], y))]
    for name in ("R1.1", "C1.2") if board.input_capacitor else ("R1.1",):
        place = pad_position(pads, name)
        lines.append((place, (place[0], y)))
    tracks = [Track(GROUND, "bottom", width, line) for line in lines if line[0] != line[1]]
    tracks.append(
        Track(GROUND, "bottom", board.copper.signal_mm, ((x - 4.44, y), (x - 4.24, y), (x - 3.59, pin[1]), pin))
    )
    tracks.append(Track(GROUND, "top", width, (through, (through[0], _rim_line_y(board)))))
    return Routes(tuple(tracks), (_make_via(board, GROUND, through),))


def _ground_column_x(board: LedBoardDesign) -> float:
    """Return x of the ground line that goes up below the board, left of the lens."""
    return -board.outline.lens_hole_mm / 2 - 1.16


SIDE_PAD_MM = 1.50, 1.20
"""Size of the connector's pads between which and the lens hole the lines pass."""


def _route_connector(board: LedBoardDesign, pads: tuple[BoardPad, ...]) -> Routes:
    """Return supply, ground, and the shield if it is tied."""
    routes = _route_supply(board, pads) + _route_connector_ground(board, pads)
    return routes + _route_shield(board, pads) if board.shield_tied else routes


def _path_past_lens_hole(
    board: LedBoardDesign, pads: tuple[BoardPad, ...], contact: str, side_pad: str
) -> tuple[PointMm, ...]:
    """Return the path from a contact between the lens hole and a side pad's corner, and on along the hole's tangent."""
    (pin_x, _), (x, y), (_, usb_y) = pad_position(pads, contact), pad_position(pads, side_pad), board.usb
    outward = 1 if x > board.usb_x_mm else -1
    corner = x - outward * SIDE_PAD_MM[0] / 2, y + SIDE_PAD_MM[1] / 2
    far = hypot(*corner)
    reach = _radius_in_gap(board, far)
    ray = corner[0] / far, corner[1] / far
    between = ray[0] * reach, ray[1] * reach
    beyond = between[0] - outward * ray[1] * 2.8, between[1] + outward * ray[0] * 2.8
    return (pin_x, usb_y + 0.44 + board.usb_contact_mm), between, beyond


def _radius_in_gap(board: LedBoardDesign, corner_mm: float) -> float:
    """Return the radius at which a line passes a corner at that distance from the lens: mid-gap where the gap is
    narrow."""
    rules, half = board.rules, board.copper.neck_mm / 2
    most = corner_mm - rules.clearance_mm - half - 0.005
    room = most - board.outline.lens_hole_mm / 2 - rules.copper_to_edge_mm - half
    return most - min(max(room, 0.0) / 2, 0.5)


def _route_supply(board: LedBoardDesign, pads: tuple[BoardPad, ...]) -> Routes:
    """Return 5 V to the driver's enable pin, under the driver to its two supply pins, and to the capacitor."""
    (x, _), enable, pin = board.driver, pad_position(pads, "U1.8"), pad_position(pads, "U1.3")
    neck, last = _path_past_lens_hole(board, pads, "USB3.1", "USB3.7"), pad_position(pads, "U1.4")
    under = x - 1.375
    narrow = [neck, ((x - 0.79, enable[1]), (under, enable[1] + 0.585), (under, pin[1]), pin)]
    wide: list[tuple[PointMm, ...]] = [
        (neck[-1], (enable[0], neck[-1][1]), enable),
        (enable, (x - 0.79, enable[1])),
        (pin, last),
    ]
    if board.input_capacitor:
        wide.append((last, pad_position(pads, "C1.1")))
    lines = [(board.copper.neck_mm, line) for line in narrow] + [(board.copper.supply_mm, line) for line in wide]
    return Routes(tuple(Track(SUPPLY, "bottom", width, line) for width, line in lines))


def _route_connector_ground(board: LedBoardDesign, pads: tuple[BoardPad, ...]) -> Routes:
    """Return the ground contact's route up to the row left of the driver, and vias that hold the pours of both sides
    together."""
    neck, column, y = _path_past_lens_hole(board, pads, "USB3.5", "USB3.6"), _ground_column_x(board), board.driver[1]
    up = (neck[-1], (column, neck[-1][1]), (column, y))
    tracks = (
        Track(GROUND, "bottom", board.copper.neck_mm, neck),
        Track(GROUND, "bottom", board.copper.ground_mm, up),
    )
    places = ((column, 2.6), (column, -2.6), (1.5 - board.outline.half[0], 0.0)) if board.copper.pour else ()
    return Routes(tracks, tuple(_make_via(board, GROUND, place) for place in places))


def _route_shield(board: LedBoardDesign, pads: tuple[BoardPad, ...]) -> Routes:
    """Return the shield's routes: ground contact to left pad, side pads to their legs, and legs to the edge's ground on top."""
    contact, left = pad_position(pads, "USB3.5"), pad_position(pads, "USB3.6")
    y, width = left[1] + 0.17, min(board.copper.ground_mm, 0.5)
    tracks = [Track(GROUND, "bottom", width, ((contact[0], y), (left[0], y)))]
    for pad, leg in (("USB3.6", "USB3.8"), ("USB3.7", "USB3.9")):
        foot = pad_position(pads, leg)
        tracks.append(Track(GROUND, "bottom", width, (pad_position(pads, pad), foot)))
        tracks.append(Track(GROUND, "top", width, (foot, (foot[0], -_rim_line_y(board)))))
    return Routes(tuple(tracks))

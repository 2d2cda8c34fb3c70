"""Round the driver: its output to the upper side, its setting resistor, its ground."""

from itertools import pairwise
from math import dist

from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.netlist import GROUND, LED_LINE, SETTING
from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.pads import Pad, place_of
from ninedtact.hardware.led_board.ring_routes import ANODE_MM, rim
from ninedtact.hardware.led_board.tracks import Routes, Track, Via

THERMAL_VIAS = (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)
"""Under the driver, from its middle: they carry its heat to the upper side."""
SLOPE_MM = 1.3
"""How far a line goes aslant at most."""


def driver_routes(board: LedBoard, pads: tuple[Pad, ...]) -> Routes:
    """All of U1 but its supply."""
    setting = Track(SETTING, "bottom", board.copper.signal_mm, (place_of(pads, "R1.2"), place_of(pads, "U1.1")))
    return output_routes(board, pads) + Routes((setting,)) + thermal_routes(board) + ground_row(board, pads)


def via(board: LedBoard, net: str, place: Place) -> Via:
    """A via of the board's usual size."""
    return Via(net, place, board.copper.via_mm, board.copper.via_drill_mm)


def output_routes(board: LedBoard, pads: tuple[Pad, ...]) -> Routes:
    """From both output pins through the vias to an anode of the upper row."""
    vias, width = [board.from_driver(place) for place in board.led_vias_from_driver_mm], board.copper.led_mm
    beside, first = board.driver[0] + 3.71, vias[0]
    tracks = [
        Track(LED_LINE, "bottom", width, (pin, (beside, pin[1]), first))
        for pin in (place_of(pads, "U1.5"), place_of(pads, "U1.6"))
    ]
    tracks += [Track(LED_LINE, side, width, pair) for pair in pairwise(vias) for side in ("top", "bottom")]
    tracks.append(Track(LED_LINE, "top", width, to_anode(board, first)))
    return Routes(tuple(tracks), tuple(via(board, LED_LINE, place) for place in vias))


def to_anode(board: LedBoard, start: Place) -> tuple[Place, ...]:
    """From a via to the next anode of the upper row: level, a slope, and down."""
    (x, y), row = start, board.leds.rows_mm[0]
    anodes = [column + ANODE_MM for column in board.leds.columns_mm]
    anode = next((anode for anode in anodes if anode > x - SLOPE_MM), anodes[-1])
    slope = min(abs(anode - x), SLOPE_MM)
    level = (anode - slope if anode > x else anode + slope, y)
    return (*((start,) if dist(start, level) > 0.01 else ()), level, (anode, y - slope), (anode, row))


def thermal_routes(board: LedBoard) -> Routes:
    """Vias under the driver, joined above and led to the ground line at the edge."""
    places = [board.from_driver(offset) for offset in THERMAL_VIAS]
    x, y = board.driver
    square = Track(GROUND, "top", board.copper.ground_mm, (*places, places[0]))
    to_edge = Track(GROUND, "top", board.copper.ground_mm, ((x, y + 0.5), (x, rim(board))))
    return Routes((square, to_edge), tuple(via(board, GROUND, place) for place in places))


def ground_row(board: LedBoard, pads: tuple[Pad, ...]) -> Routes:
    """Below, left of the driver: resistor, capacitor and the driver's ground pin on one line, and its via."""
    x, y = board.driver
    start, pin, width = ground_column(board), place_of(pads, "U1.2"), board.copper.ground_mm
    through = board.from_driver(board.ground_via_from_driver_mm)
    main = ((min(start, through[0]), y), (x - 4.44, y))
    lines: list[tuple[Place, ...]] = [main, (through, (through[0], y))]
    for name in ("R1.1", "C1.2") if board.input_capacitor else ("R1.1",):
        place = place_of(pads, name)
        lines.append((place, (place[0], y)))
    tracks = [Track(GROUND, "bottom", width, line) for line in lines if line[0] != line[1]]
    tracks.append(
        Track(GROUND, "bottom", board.copper.signal_mm, ((x - 4.44, y), (x - 4.24, y), (x - 3.59, pin[1]), pin))
    )
    tracks.append(Track(GROUND, "top", width, (through, (through[0], rim(board)))))
    return Routes(tuple(tracks), (via(board, GROUND, through),))


def ground_column(board: LedBoard) -> float:
    """x of the ground line that goes up below the board, left of the lens."""
    return -board.outline.lens_hole_mm / 2 - 1.16

"""The upper side: every anode on one line inside the ring of LEDs, every cathode on one outside. They never cross.

The anodes' ring is open at the lower left, where the cathodes of the left column come out.
"""

from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.netlist import GROUND, LED_LINE
from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.tracks import Routes, Track

ANODE_MM, CATHODE_MM = -1.462, 1.0
"""From an LED's middle to the middles of its pads."""
TAP_MM = -1.05
"""Where a line leaves an anode of the upper or lower row: beside the connector's peg."""
LINK_MM = 1.8
"""From these rows to the anodes' lines between the columns: past the LEDs' pads and the pegs, not into the lens hole."""
RIM_MM = 0.27
"""From the board's edge to the ground line along it."""


def rim(board: LedBoard) -> float:
    """How far from the middle the ground lines run along the upper and lower edges."""
    return board.outline.half[1] - RIM_MM - board.copper.ground_mm / 2


def ring_routes(board: LedBoard) -> Routes:
    """All tracks of the upper side but those to the driver and the connector."""
    return anode_routes(board) + cathode_routes(board)


def anode_routes(board: LedBoard) -> Routes:
    """Left column, upper link, right column, and a lower link from the right."""
    columns, (top, bottom) = board.leds.columns_mm, (board.leds.rows_mm[0], board.leds.rows_mm[-1])
    left, right = columns[0] + ANODE_MM, columns[-1] + ANODE_MM
    lines: list[tuple[Place, ...]] = [
        ((left, top), (left, bottom)),
        ((left, top - LINK_MM), (right, top - LINK_MM)),
        ((right, top), (right, bottom)),
    ]
    inner = [x + TAP_MM for x in columns[1:-1]]
    if inner:
        lines.append(((inner[0], bottom + LINK_MM), (right, bottom + LINK_MM)))
    lines += [((x, row), (x, link)) for x in inner for row, link in ((top, top - LINK_MM), (bottom, bottom + LINK_MM))]
    return Routes(tuple(Track(LED_LINE, "top", board.copper.led_mm, line) for line in lines))


def cathode_routes(board: LedBoard) -> Routes:
    """Along the upper edge, down the right column, along the lower edge, and up the left column to its last but one."""
    cathodes, rows = [x + CATHODE_MM for x in board.leds.columns_mm], board.leds.rows_mm
    left, right, edge = cathodes[0], cathodes[-1], rim(board)
    lines: list[tuple[Place, ...]] = [
        ((left, edge), (right, edge)),
        ((right, edge), (right, -edge)),
        ((left, -edge), (right, -edge)),
        ((left, -edge), (left, rows[1])),
    ]
    lines += [((x, rows[0]), (x, edge)) for x in cathodes[:-1]]
    lines += [((x, rows[-1]), (x, -edge)) for x in cathodes[1:-1]]
    return Routes(tuple(Track(GROUND, "top", board.copper.ground_mm, line) for line in lines))

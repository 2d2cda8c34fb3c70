"""Where each part sits."""

from dataclasses import dataclass
from math import cos, radians, sin
from typing import Literal

from ninedtact.hardware.led_board import parts
from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.outline import Place

Side = Literal["top", "bottom"]
CAPACITOR_FROM_DRIVER_MM = -5.65, 1.55
"""Beside the driver's two supply pins."""


@dataclass(frozen=True)
class Placed:
    """A part on the board. It is turned counter-clockwise as seen from its own side, then, below, mirrored in x."""

    reference: str
    part: parts.Part
    side: Side
    at_mm: Place
    turned_deg: float = 0.0

    def onto_board(self, place: Place) -> Place:
        """A place of the footprint's frame, in the board's."""
        dx, dy = self.turned(place)
        return self.at_mm[0] + dx, self.at_mm[1] + dy

    def turned(self, offset: Place) -> Place:
        """An offset in the footprint's frame, in the board's."""
        c, s = cos(radians(self.turned_deg)), sin(radians(self.turned_deg))
        x, y = c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]
        return round(x if self.side == "top" else -x, 6), round(y, 6)

    def size(self, size: Place) -> Place:
        """A size in the footprint's frame, along the board's x and y; parts are turned by right angles only."""
        x, y = self.turned(size)
        return abs(x), abs(y)


def placement(board: LedBoard) -> tuple[Placed, ...]:
    """All parts: LEDs above, the rest below."""
    leds = [Placed(f"LED{n + 1}", parts.led(board), "top", place) for n, place in enumerate(board.leds.places)]
    dx, dy, turned_deg = board.resistor_from_driver_mm
    rest = [
        Placed("U1", parts.driver(), "bottom", board.driver, 90.0),
        Placed("R1", parts.resistor(board), "bottom", board.from_driver((dx, dy)), turned_deg),
        Placed("USB3", parts.connector(board), "bottom", board.usb, 180.0),
    ]
    if board.input_capacitor:
        rest.append(Placed("C1", parts.capacitor(), "bottom", board.from_driver(CAPACITOR_FROM_DRIVER_MM)))
    return (*leds, *rest)

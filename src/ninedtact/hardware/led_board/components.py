"""The components of the board: what is bought and soldered, and where each is placed."""

from dataclasses import dataclass
from math import cos, radians, sin
from typing import Literal

from ninedtact.hardware.led_board.board_outline import PointMm
from ninedtact.hardware.led_board.board_parameters import LedBoard
from ninedtact.hardware.led_board.footprints import (
    Footprint,
    chip_0805_footprint,
    led_2835_footprint,
    micro_usb_footprint,
    soic_8_ep_footprint,
)


@dataclass(frozen=True)
class BoardComponent:
    """One kind of component, a line of the parts list."""

    value: str
    maker_number: str
    supplier_number: str
    """Number at LCSC; empty where any component of that value will do."""
    footprint: Footprint


BoardSide = Literal["top", "bottom"]
CAPACITOR_FROM_DRIVER_MM = -5.65, 1.55
"""Offset of C1 from U1, beside the driver's two supply pins."""


@dataclass(frozen=True)
class PlacedComponent:
    """A component on the board: rotated counter-clockwise as seen from its own side, then, below the board, mirrored in
    x."""

    reference: str
    part: BoardComponent
    side: BoardSide
    at_mm: PointMm
    rotation_deg: float = 0.0

    def to_board_frame(self, place: PointMm) -> PointMm:
        """Return a point of the footprint's frame in the board's frame."""
        dx, dy = self.rotate_to_board(place)
        return self.at_mm[0] + dx, self.at_mm[1] + dy

    def rotate_to_board(self, offset: PointMm) -> PointMm:
        """Return an offset in the footprint's frame as an offset in the board's frame."""
        c, s = cos(radians(self.rotation_deg)), sin(radians(self.rotation_deg))
        x, y = c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]
        return round(x if self.side == "top" else -x, 6), round(y, 6)

    def size_on_board(self, size: PointMm) -> PointMm:
        """Return a size in the footprint's frame along the board's x and y; components are rotated by right angles
        only."""
        x, y = self.rotate_to_board(size)
        return abs(x), abs(y)


def place_components(board: LedBoard) -> tuple[PlacedComponent, ...]:
    """Place all components: LEDs above the board, the rest below."""
    led = BoardComponent("white", "BZ-S2835BW9C1-02-3V-UV", "C2833052", led_2835_footprint(board.led_pad_corner_mm))
    driver = BoardComponent("CN5711", "CN5711", "C35634", soic_8_ep_footprint())
    # Only the usual value of the setting resistor has an order number here.
    numbers = ("RT0805CRE0720KL", "C706298") if board.resistor_ohm == 20_000 else ("", "")
    resistor = BoardComponent(f"{board.resistor_ohm / 1000:g}k", *numbers, chip_0805_footprint(0.5))
    # The input capacitor has less than the 10 µF that USB allows a device to connect to its 5 V.
    capacitor = BoardComponent("4.7uF X5R 16V", "", "", chip_0805_footprint(1.25))
    receptacle = BoardComponent(
        "MICRO-USB", "MICRO-02-G4P1-A1T2", "C2682525", micro_usb_footprint(board.usb_contact_mm)
    )
    dx, dy, rotation_deg = board.resistor_from_driver_mm
    placed = [PlacedComponent(f"LED{n}", led, "top", at) for n, at in enumerate(board.leds.positions, start=1)]
    placed += [
        PlacedComponent("U1", driver, "bottom", board.driver, 90.0),
        PlacedComponent("R1", resistor, "bottom", board.from_driver((dx, dy)), rotation_deg),
        PlacedComponent("USB3", receptacle, "bottom", board.usb, 180.0),
    ]
    if board.input_capacitor:
        placed.append(PlacedComponent("C1", capacitor, "bottom", board.from_driver(CAPACITOR_FROM_DRIVER_MM)))
    return tuple(placed)

"""The components of the board: what is bought and soldered and where each is placed, with the netlist, pads and holes that follow.

All LEDs are in parallel between U1's output and ground.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import cos, radians, sin
from typing import Literal

from ninedtact_hardware.led_board.board_outline_and_holes import PointMm
from ninedtact_hardware.led_board.board_parameters import LedBoardDesign
from ninedtact_hardware.led_board.footprints import (
    Footprint,
    Land,
    chip_0805_footprint,
    led_2835_footprint,
    micro_usb_footprint,
    soic_8_ep_footprint,
)


@dataclass(frozen=True)
class ComponentSpecification:
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
    part: ComponentSpecification
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


def place_components(board: LedBoardDesign) -> tuple[PlacedComponent, ...]:
    """Place all components: LEDs above the board, the rest below."""
    led = ComponentSpecification(
        "white", "BZ-S2835BW9C1-02-3V-UV", "C2833052", led_2835_footprint(board.led_pad_corner_mm)
    )
    driver = ComponentSpecification("CN5711", "CN5711", "C35634", soic_8_ep_footprint())
    # Only the usual value of the setting resistor has an order number here.
    numbers = ("RT0805CRE0720KL", "C706298") if board.resistor_ohm == 20_000 else ("", "")
    resistor = ComponentSpecification(f"{board.resistor_ohm / 1000:g}k", *numbers, chip_0805_footprint(0.5))
    # The input capacitor has less than the 10 µF that USB allows a device to connect to its 5 V.
    capacitor = ComponentSpecification("4.7uF X5R 16V", "", "", chip_0805_footprint(1.25))
    receptacle = ComponentSpecification(
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


GROUND, SUPPLY, LED_LINE, SETTING = "GND", "VCC", "LED+", "ISET"


@dataclass(frozen=True)
class Net:
    """Pins that are one conductor, such as `U1.3`."""

    name: str
    pins: tuple[str, ...]


def build_netlist(board: LedBoardDesign) -> tuple[Net, ...]:
    """Return every net; pins in none of them stay open (U1.7, the USB data and identity pins)."""
    leds = [f"LED{number + 1}" for number in range(len(board.leds.positions))]
    capacitor = board.input_capacitor
    shield = [f"USB3.{number}" for number in (6, 7, 8, 9)] if board.shield_tied else []
    ground = ["USB3.5", *shield, "U1.2", "U1.9", "R1.1", *(["C1.2"] if capacitor else []), *(f"{x}.1" for x in leds)]
    supply = ["USB3.1", "U1.3", "U1.4", "U1.8", *(["C1.1"] if capacitor else [])]
    return (
        Net(SUPPLY, tuple(supply)),
        Net(GROUND, tuple(ground)),
        Net(LED_LINE, ("U1.5", "U1.6", *(f"{led}.2" for led in leds))),
        Net(SETTING, ("U1.1", "R1.2")),
    )


@dataclass(frozen=True)
class DrilledHole:
    """A round hole, or a slot of that width between two ends."""

    start_mm: PointMm
    end_mm: PointMm
    width_mm: float
    plated: bool


@dataclass(frozen=True)
class PadCutout:
    """The part of a pad that is removed: everything nearer than `radius_mm` to a line."""

    start_mm: PointMm
    end_mm: PointMm
    radius_mm: float


@dataclass(frozen=True)
class BoardPad:
    """A pad in its position on the board."""

    pin: str
    net: str | None
    sides: tuple[BoardSide, ...]
    at_mm: PointMm
    size_mm: PointMm
    land: Land
    hole: DrilledHole | None = None
    cutouts: tuple[PadCutout, ...] = ()


def place_pads(board: LedBoardDesign) -> tuple[BoardPad, ...]:
    """Return all pads, cut back where the connector's holes come through."""
    nets = {pin: net.name for net in build_netlist(board) for pin in net.pins}
    components = place_components(board)
    found = tuple(_place_pad(placed, land, nets) for placed in components for land in placed.part.footprint.lands)
    if not board.pads_give_way:
        return found
    pegs = connector_peg_holes(board)
    cutouts = [_cutout_around(hole, hole.width_mm, board.rules.copper_to_hole_mm) for hole in pegs]
    cutouts += [_cutout_around(pad.hole, min(pad.size_mm), board.rules.clearance_mm) for pad in found if pad.hole]
    return tuple(
        replace(pad, cutouts=tuple(cutout for cutout in cutouts if _is_near(pad, cutout)))
        if pad.pin.startswith("LED")
        else pad
        for pad in found
    )


def _place_pad(placed: PlacedComponent, land: Land, nets: Mapping[str, str]) -> BoardPad:
    """Return one pad of a component in its position on the board; `nets` are the names of the nets by pin."""
    pin, at = f"{placed.reference}.{land.number}", placed.to_board_frame(land.at_mm)
    hole = _slot_of_land(placed, land) if land.slot_mm else None
    sides: tuple[BoardSide, ...] = ("top", "bottom") if hole else (placed.side,)
    return BoardPad(pin, nets.get(pin), sides, at, placed.size_on_board(land.size_mm), land, hole)


def _slot_of_land(placed: PlacedComponent, land: Land) -> DrilledHole:
    """Return the plated slot through a pad."""
    assert land.slot_mm is not None
    (x, y), (width, length) = land.at_mm, land.slot_mm
    reach = (length - width) / 2
    return DrilledHole(placed.to_board_frame((x, y - reach)), placed.to_board_frame((x, y + reach)), width, plated=True)


def connector_peg_holes(board: LedBoardDesign) -> tuple[DrilledHole, ...]:
    """Return the holes for the connector's pegs."""
    holes = []
    for placed in place_components(board):
        for x, y, diameter in placed.part.footprint.pegs_mm:
            at = placed.to_board_frame((x, y))
            holes.append(DrilledHole(at, at, diameter, plated=False))
    return tuple(holes)


def _cutout_around(hole: DrilledHole, wide_mm: float, gap_mm: float) -> PadCutout:
    """Return the area that the copper or the drill around a hole, this wide, and its clearance need."""
    return PadCutout(hole.start_mm, hole.end_mm, wide_mm / 2 + gap_mm + 0.02)


def _is_near(pad: BoardPad, bite: PadCutout) -> bool:
    """Return whether a cutout may reach a pad, judged by their boxes."""
    ends = bite.start_mm, bite.end_mm
    return all(
        min(end[axis] for end in ends) - bite.radius_mm < pad.at_mm[axis] + pad.size_mm[axis] / 2
        and max(end[axis] for end in ends) + bite.radius_mm > pad.at_mm[axis] - pad.size_mm[axis] / 2
        for axis in (0, 1)
    )


def pad_position(found: tuple[BoardPad, ...], pin: str) -> PointMm:
    """Return the centre of the pad of a pin."""
    return next(pad.at_mm for pad in found if pad.pin == pin)

"""Netlist, pads and holes of the LED board. All LEDs are in parallel between U1's output and ground."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from ninedtact.hardware.led_board.board_outline import PointMm
from ninedtact.hardware.led_board.board_parameters import LedBoard
from ninedtact.hardware.led_board.components import BoardSide, PlacedComponent, place_components
from ninedtact.hardware.led_board.footprints import Land

GROUND, SUPPLY, LED_LINE, SETTING = "GND", "VCC", "LED+", "ISET"


@dataclass(frozen=True)
class Net:
    """Pins that are one conductor, such as `U1.3`."""

    name: str
    pins: tuple[str, ...]


def build_netlist(board: LedBoard) -> tuple[Net, ...]:
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
    bites: tuple[PadCutout, ...] = ()


def place_pads(board: LedBoard) -> tuple[BoardPad, ...]:
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
        replace(pad, bites=tuple(cutout for cutout in cutouts if _is_near(pad, cutout)))
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


def connector_peg_holes(board: LedBoard) -> tuple[DrilledHole, ...]:
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

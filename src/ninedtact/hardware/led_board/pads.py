"""Pads and holes where they lie on the board."""

from dataclasses import dataclass, replace

from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.footprints import Land
from ninedtact.hardware.led_board.netlist import Net, net_of, netlist
from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.placement import Placed, Side, placement


@dataclass(frozen=True)
class Hole:
    """A round hole, or a slot of that width between two ends."""

    start_mm: Place
    end_mm: Place
    width_mm: float
    plated: bool


@dataclass(frozen=True)
class Bite:
    """What a pad gives up: everything nearer than `radius_mm` to a line."""

    start_mm: Place
    end_mm: Place
    radius_mm: float


@dataclass(frozen=True)
class Pad:
    """A pad on the board."""

    pin: str
    net: str | None
    sides: tuple[Side, ...]
    at_mm: Place
    size_mm: Place
    land: Land
    hole: Hole | None = None
    bites: tuple[Bite, ...] = ()


def pads(board: LedBoard) -> tuple[Pad, ...]:
    """All pads, cut back where the connector's holes come through."""
    nets, parts = netlist(board), placement(board)
    found = tuple(pad_of(placed, land, nets) for placed in parts for land in placed.part.footprint.lands)
    if not board.pads_give_way:
        return found
    through = [bite_round(hole, board.rules.copper_to_hole_mm) for hole in pegs(board)]
    legs = [bite_round_leg(pad, board.rules.clearance_mm) for pad in found if pad.hole]
    return tuple(bitten(pad, (*through, *legs)) if pad.pin.startswith("LED") else pad for pad in found)


def pad_of(placed: Placed, land: Land, nets: tuple[Net, ...]) -> Pad:
    """One pad of one part."""
    pin, at = f"{placed.reference}.{land.number}", placed.onto_board(land.at_mm)
    hole = slot(placed, land) if land.slot_mm else None
    sides: tuple[Side, ...] = ("top", "bottom") if hole else (placed.side,)
    return Pad(pin, net_of(nets, pin), sides, at, placed.size(land.size_mm), land, hole)


def slot(placed: Placed, land: Land) -> Hole:
    """The plated slot through a pad."""
    assert land.slot_mm is not None
    (x, y), (width, length) = land.at_mm, land.slot_mm
    reach = (length - width) / 2
    return Hole(placed.onto_board((x, y - reach)), placed.onto_board((x, y + reach)), width, plated=True)


def pegs(board: LedBoard) -> tuple[Hole, ...]:
    """The holes for the connector's pegs."""
    holes = []
    for placed in placement(board):
        for x, y, diameter in placed.part.footprint.pegs_mm:
            at = placed.onto_board((x, y))
            holes.append(Hole(at, at, diameter, plated=False))
    return tuple(holes)


def bite_round(hole: Hole, gap_mm: float) -> Bite:
    """What a hole wants for itself."""
    return Bite(hole.start_mm, hole.end_mm, hole.width_mm / 2 + gap_mm + 0.02)


def bite_round_leg(pad: Pad, gap_mm: float) -> Bite:
    """What the pad of a plated slot wants for itself."""
    assert pad.hole is not None
    return Bite(pad.hole.start_mm, pad.hole.end_mm, min(pad.size_mm) / 2 + gap_mm + 0.02)


def bitten(pad: Pad, bites: tuple[Bite, ...]) -> Pad:
    """The pad without what these take from it."""
    return replace(pad, bites=tuple(bite for bite in bites if near(pad, bite)))


def near(pad: Pad, bite: Bite) -> bool:
    """Whether a bite may reach a pad, by their boxes."""
    ends = bite.start_mm, bite.end_mm
    return all(
        min(end[axis] for end in ends) - bite.radius_mm < pad.at_mm[axis] + pad.size_mm[axis] / 2
        and max(end[axis] for end in ends) + bite.radius_mm > pad.at_mm[axis] - pad.size_mm[axis] / 2
        for axis in (0, 1)
    )


def place_of(found: tuple[Pad, ...], pin: str) -> Place:
    """Middle of a pin's pad."""
    return next(pad.at_mm for pad in found if pad.pin == pin)

"""Footprints of the components, each in its own frame: seen from its own side, not rotated, y up. Sizes:
docs/led_board.md."""

from dataclasses import dataclass

from ninedtact_hardware.led_board.board_outline_and_holes import PointMm


@dataclass(frozen=True)
class Land:
    """One pad of a footprint."""

    number: str
    at_mm: PointMm
    size_mm: PointMm
    corner_mm: float = 0.0
    """Radius of the pad's corners."""
    slot_mm: PointMm | None = None
    """Width and length (along y) of a plated slot through the pad."""
    pour_gap: bool = True
    """Whether the pour keeps off it, so that an iron can heat it and tracks are the bridges. Not where heat is to
    leave."""
    paste: bool = True
    """Whether the whole pad is covered with solder paste."""


@dataclass(frozen=True)
class Footprint:
    """The pads, body and holes of a component."""

    name: str
    lands: tuple[Land, ...]
    body_mm: tuple[float, float, float]
    """Size of the body along x, along y, and its height over the board."""
    body_at_mm: PointMm = (0.0, 0.0)
    pegs_mm: tuple[tuple[float, float, float], ...] = ()
    """x, y and diameter of holes without copper."""
    mark_mm: tuple[PointMm, PointMm] | None = None
    """A line on the silkscreen at the cathode or at pin 1."""


def led_2835_footprint(corner_mm: float) -> Footprint:
    """Return the footprint of a 2835 LED, whose origin is the middle of its body. Pad 1 is the cathode, 2 the anode."""
    return Footprint(
        "LED_2835",
        (
            Land("1", (1.0, 0.0), (2.30, 2.10), corner_mm, pour_gap=False),
            Land("2", (-1.462, 0.0), (1.55, 2.10), corner_mm),
        ),
        body_mm=(3.50, 2.80, 0.72),
        mark_mm=((0.3, 1.35), (1.3, 1.35)),
    )


def soic_8_ep_footprint() -> Footprint:
    """Return the footprint of a SOIC-8 with a thermal pad, number 9; pins 1 to 4 lie along the lower row."""
    lower = [Land(str(1 + n), (-1.905 + 1.27 * n, -2.77), (0.57, 2.04)) for n in range(4)]
    upper = [Land(str(5 + n), (1.905 - 1.27 * n, 2.77), (0.57, 2.04)) for n in range(4)]
    thermal = Land("9", (0.0, 0.0), (2.0, 2.0), pour_gap=False, paste=False)
    return Footprint(
        "SOIC-8-EP", (*lower, *upper, thermal), body_mm=(4.9, 3.9, 1.75), mark_mm=((-2.4, -3.6), (-2.4, -2.0))
    )


def chip_0805_footprint(height_mm: float) -> Footprint:
    """Return the footprint of a resistor or capacitor of size 0805; pin 1 is left."""
    return Footprint(
        "0805",
        (Land("1", (-1.0, 0.0), (1.13, 1.38)), Land("2", (1.0, 0.0), (1.13, 1.38))),
        body_mm=(2.0, 1.25, height_mm),
    )


def micro_usb_footprint(contact_mm: float) -> Footprint:
    """Return the footprint of a micro-USB receptacle, mouth up: contacts 1 (5 V) to 5 (ground) from the right, shield 6
    to 9, two pegs."""
    contacts = [Land(str(1 + n), (1.3 - 0.65 * n, -0.64 - contact_mm / 2), (0.40, contact_mm)) for n in range(5)]
    sides = [Land(number, (x, -1.36), (1.50, 1.20)) for number, x in (("6", -3.30), ("7", 3.30))]
    legs = [
        Land(number, (x, 1.388), (1.0, 2.0), 0.5, (0.61, 1.60), paste=False)
        for number, x in (("8", -2.825), ("9", 2.825))
    ]
    return Footprint(
        "USB_Micro-B",
        (*contacts, *sides, *legs),
        body_mm=(7.5, 5.0, 2.65),
        body_at_mm=(0.0, 1.04),
        pegs_mm=((-2.0, -0.76, 0.6), (2.0, -0.76, 0.6)),
    )

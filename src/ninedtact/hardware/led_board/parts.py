"""What is bought and soldered."""

from dataclasses import dataclass

from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.footprints import Footprint, chip_0805, led_2835, micro_usb, soic_8_ep


@dataclass(frozen=True)
class Part:
    """A line of the parts list."""

    value: str
    maker_number: str
    supplier_number: str
    """At LCSC; empty where any part of that value will do."""
    footprint: Footprint


def led(board: LedBoard) -> Part:
    """The white LED."""
    return Part("white", "BZ-S2835BW9C1-02-3V-UV", "C2833052", led_2835(board.led_pad_corner_mm))


def driver() -> Part:
    """The constant-current source."""
    return Part("CN5711", "CN5711", "C35634", soic_8_ep())


def resistor(board: LedBoard) -> Part:
    """R1; only the usual value has a number here."""
    usual = board.resistor_ohm == 20_000
    numbers = ("RT0805CRE0720KL", "C706298") if usual else ("", "")
    return Part(f"{board.resistor_ohm / 1000:g}k", *numbers, chip_0805(0.5))


def capacitor() -> Part:
    """C1: less than the 10 µF that USB allows a device to hang on its 5 V."""
    return Part("4.7uF X5R 16V", "", "", chip_0805(1.25))


def connector(board: LedBoard) -> Part:
    """Micro-USB, below the board."""
    return Part("MICRO-USB", "MICRO-02-G4P1-A1T2", "C2682525", micro_usb(board.usb_contact_mm))

"""Which pins belong together: all LEDs in parallel between U1's output and ground."""

from dataclasses import dataclass

from ninedtact.hardware.led_board.design import LedBoard

GROUND, SUPPLY, LED_LINE, SETTING = "GND", "VCC", "LED+", "ISET"


@dataclass(frozen=True)
class Net:
    """Pins that are one conductor, as `U1.3`."""

    name: str
    pins: tuple[str, ...]


def netlist(board: LedBoard) -> tuple[Net, ...]:
    """Every net; pins in none of them stay open (U1.7, the USB data and identity pins)."""
    leds = [f"LED{number + 1}" for number in range(len(board.leds.places))]
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


def net_of(nets: tuple[Net, ...], pin: str) -> str | None:
    """The net that a pin is in; None if it stays open."""
    return next((net.name for net in nets if pin in net.pins), None)

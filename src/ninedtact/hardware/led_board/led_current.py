"""Current, brightness and heat of the LEDs, from the setting resistor.

I = 1800 V / R for all LEDs together: CN5711, as stated by done.land/components/light/ledcontroller/cn5711 (accuracy 5
%; the maker's data sheet was not read). The LEDs are in parallel without resistors of their own, so that their shares
differ with their forward voltages.
"""

from dataclasses import dataclass

from ninedtact.hardware.led_board.board_outline import LedBoardImpossible
from ninedtact.hardware.led_board.board_parameters import LedBoard

SETTING_V = 1800.0
"""Product of the driver's current and its resistor in volts: 1800 A·Ω."""
REFERENCE_RESISTOR_OHM = 20_000.0
"""The resistor of brightness 1 with eight LEDs, which is that of the original's fabrication files."""
REFERENCE_LED_COUNT = 8
SUPPLY_V = 5.0
LED_V = 3.0
"""Forward voltage by the LED's type name. It rises with the current, which makes the driver's loss less than stated."""
USB_MA = 500.0
"""Current that a USB 2 port supplies."""
USB_DEFAULT_MA = 100.0
"""Current that a USB 2 device may draw before it has requested more, which this one never does."""
LED_MA = 60.0
"""Current limit of a usual 2835 LED of 0.2 W; the data sheet of this one was not read."""


@dataclass(frozen=True)
class LedOperatingPoint:
    """Current, brightness and heat of a board with a given resistor."""

    total_ma: float
    led_ma: float
    """Current of each LED if all share equally."""
    relative_brightness: float
    """Of the light as a whole, beside the usual board's, taken as proportional to the current. White LEDs lose efficiency as
    the current grows, so bright settings turn out a little darker than stated; how much was not measured."""
    driver_w: float
    """Heat in U1, which reduces the current on its own above 135 °C."""
    needs_asking: bool
    """Whether the current is above 100 mA, which a USB 2 host may refuse without a request; chargers and hubs in practice do
    not."""


def compute_operating_point(resistor_ohm: float, leds: int = REFERENCE_LED_COUNT) -> LedOperatingPoint:
    """Return current, brightness and heat; raises `LedBoardImpossible` beyond the limits of driver, LEDs and USB."""
    if not 1_200 <= resistor_ohm <= 30_000:
        raise _refusal("a resistor from 1200 to 30000 ohm, which the driver can follow", f"{resistor_ohm:g}")
    total_ma = SETTING_V / resistor_ohm * 1000
    light = LedOperatingPoint(
        total_ma,
        total_ma / leds,
        REFERENCE_RESISTOR_OHM / resistor_ohm,
        (SUPPLY_V - LED_V) * total_ma / 1000,
        total_ma > USB_DEFAULT_MA,
    )
    _require_within_limits(light)
    return light


def _require_within_limits(light: LedOperatingPoint) -> None:
    """Refuse currents beyond the limits of the LEDs or of USB."""
    if light.total_ma > USB_MA:
        raise _refusal(f"at most {USB_MA:g} mA from USB", f"{light.total_ma:.0f} mA", "take a larger resistor")
    if light.led_ma > LED_MA:
        raise _refusal(
            f"at most {LED_MA:g} mA in each LED", f"{light.led_ma:.1f} mA", "take a larger resistor or more LEDs"
        )


def _refusal(expected: str, got: str, remedy: str = "take one in that range") -> LedBoardImpossible:
    """Return the error with expected, got and remedy."""
    return LedBoardImpossible(f"expected {expected}, got {got}; {remedy}")


def operating_point_of_board(board: LedBoard) -> LedOperatingPoint:
    """Return current, brightness and heat of a board."""
    return compute_operating_point(board.resistor_ohm, len(board.leds.positions))

"""The LED board as a handful of choices; everything else follows from them."""

from dataclasses import dataclass

from ninedtact.hardware.dimensions.bought import Board
from ninedtact.hardware.led_board.lattice import LedLattice, evenly
from ninedtact.hardware.led_board.manufacture import Copper, Rules
from ninedtact.hardware.led_board.outline import BoardOutline, Place
from ninedtact.hardware.led_board.refusal import BoardImpossible

LED_INSET_MM = Board.led_inset_mm
"""From the edges to the outer LEDs' centres."""


@dataclass(frozen=True)
class LedBoard:
    """The defaults are the improved board; `original` is the published one; `for_size` is one for another sensor."""

    outline: BoardOutline = BoardOutline()
    leds: LedLattice = LedLattice()
    rules: Rules = Rules()
    copper: Copper = Copper()
    resistor_ohm: float = 20_000.0
    """R1, which sets the current of all LEDs together: `current.led_light`."""
    input_capacitor: bool = True
    """C1 of 4.7 µF from 5 V to ground beside U1, which the original lacks."""
    shield_tied: bool = True
    """The USB shell on ground, directly: no data, no second ground on this board, so there is nothing that an RC would part."""
    usb_x_mm: float = 0.0
    """Middle of the connector."""
    usb_inset_mm: float = 3.2
    """From the lower edge to the connector's origin; its mouth stands 0.34 out, as far as the shell lets a board slide in."""
    usb_contact_mm: float = 1.3
    """Length of the contacts' pads: 1.50 would end 0.06 from the lens hole."""
    led_pad_corner_mm: float = 0.53
    """Rounding of the LED pads, which keeps the corner LEDs' copper away from the notches."""
    pads_give_way: bool = True
    """LED pads are cut back where the connector's holes come through the board."""
    driver_x_mm: float = 3.49
    """Middle of U1: between the upper middle LED's pads above and the base's boss below."""
    driver_inset_mm: float = 2.6
    """From the upper edge to the middle of U1."""
    resistor_from_driver_mm: tuple[float, float, float] = (-5.62, -1.5, 180.0)
    """From U1 to R1, and R1's turn in degrees."""
    led_vias_from_driver_mm: tuple[Place, ...] = ((4.36, 1.2), (5.16, 1.2))
    """Where the LEDs' current goes from U1 to the upper side."""
    ground_via_from_driver_mm: Place = (-8.0, 1.2)
    """Where the ground below meets the ground above."""
    faults_known: bool = False
    """Written in spite of the rules that it breaks; its notes name them. So the original can be looked at."""

    def __post_init__(self) -> None:
        if not 1_200 <= self.resistor_ohm <= 30_000:
            raise BoardImpossible(
                f"expected resistor_ohm from 1200 to 30000, which the driver can follow, got {self.resistor_ohm:g}; "
                "take one in that range"
            )
        if not 1.1 <= self.usb_contact_mm <= 1.5:
            raise BoardImpossible(
                f"expected usb_contact_mm from 1.1 to 1.5, got {self.usb_contact_mm:g}; shorter pads do not hold the contacts"
            )

    @property
    def driver(self) -> Place:
        """Centre of U1."""
        return self.driver_x_mm, self.outline.half[1] - self.driver_inset_mm

    def from_driver(self, offset_mm: Place) -> Place:
        """A place told from U1."""
        return self.driver[0] + offset_mm[0], self.driver[1] + offset_mm[1]

    @property
    def usb(self) -> Place:
        """Origin of the connector."""
        return self.usb_x_mm, self.usb_inset_mm - self.outline.half[1]

    @classmethod
    def for_size(cls, width_mm: float, height_mm: float, columns: int = 3, rows: int = 3) -> "LedBoard":
        """The improved board on another outline: holes and outer LEDs keep their distances from the edges."""
        outline = BoardOutline(width_mm, height_mm)
        x, y = outline.half[0] - LED_INSET_MM[0], outline.half[1] - LED_INSET_MM[1]
        return cls(outline, LedLattice(evenly(x, columns), evenly(-y, rows)))

    @classmethod
    def original(cls) -> "LedBoard":
        """Dimensions, parts and netlist of the published board; the tracks are this room's, at the original's width."""
        return cls(
            outline=BoardOutline(lens_hole_mm=10.0),
            leds=LedLattice(columns_mm=(-8.769, 0.131, 8.831)),
            rules=Rules(clearance_mm=0.152, mask_margin_mm=0.051),
            copper=Copper(*(0.254,) * 5, via_mm=0.6, via_drill_mm=0.305, pour=False),
            input_capacitor=False,
            shield_tied=False,
            usb_x_mm=0.07,
            usb_contact_mm=1.5,
            led_pad_corner_mm=0.0,
            pads_give_way=False,
            resistor_from_driver_mm=(-5.62, -0.89, 270.0),
            led_vias_from_driver_mm=((5.06, 1.24),),
            ground_via_from_driver_mm=(-8.95, 0.19),
            faults_known=True,
        )

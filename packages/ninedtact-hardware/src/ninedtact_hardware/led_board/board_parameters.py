"""The choices of the LED board: outline, LED positions, copper widths, setting resistor, design rules of the board house; the board
that fits a hardware design; and the current, brightness and heat of the LEDs, which follow from the setting resistor.

I = 1800 V / R for all LEDs together: CN5711, as stated by done.land/components/light/ledcontroller/cn5711 (accuracy 5
%; the maker's data sheet was not read). The LEDs are in parallel without resistors of their own, so that their shares
differ with their forward voltages.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np

from ninedtact.design import Bounds, DesignImpossible
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.led_board.board_outline_and_holes import BoardOutline, LedBoardImpossible, PointMm
from ninedtact_hardware.led_board.footprints import led_2835_footprint, micro_usb_footprint, soic_8_ep_footprint
from ninedtact_hardware.part_dimensions import BoundedDimensions, LedBoardDimensions


@dataclass(frozen=True)
class BoardDesignRules(BoundedDimensions, table="rules"):
    """Least distances: those of ordinary two-layer production without extra charge, with a small margin."""

    clearance_mm: Annotated[float, Bounds(0.1, 0.5)] = 0.2
    """Least distance between copper of different nets."""
    copper_to_edge_mm: Annotated[float, Bounds(0.05, 1.0)] = 0.25
    """Least distance from copper to the milled edge, including lens hole and notches; board houses require 0.2."""
    copper_to_hole_mm: Annotated[float, Bounds(0.1, 1.0)] = 0.2
    """Least distance from copper to a hole without copper in it."""
    hole_to_hole_mm: Annotated[float, Bounds(0.1, 1.0)] = 0.25
    """Least distance between the rims of two drilled holes."""
    mask_margin_mm: Annotated[float, Bounds(0.0, 0.1)] = 0.05
    """Margin by which the solder mask's openings exceed the pads."""
    pour_gap_mm: Annotated[float, Bounds(0.1, 1.0)] = 0.25
    """Least distance from the ground pour to all other copper."""
    least_pad_share: Annotated[float, Bounds(0.5, 1.0)] = 0.8
    """Least share of a pad's area that must be left where it gives way to the connector's holes; with less the part
    solders badly."""


@dataclass(frozen=True)
class TrackAndViaDimensions(BoundedDimensions, table="copper"):
    """Widths of the tracks, and the dimensions of the vias."""

    led_mm: Annotated[float, Bounds(0.15, 1.5)] = 0.6
    """Width of the line to the anodes: along 66 mm of 0.254 the LEDs would not get the same voltage."""
    ground_mm: Annotated[float, Bounds(0.15, 1.5)] = 0.6
    """Width of the line from the cathodes."""
    supply_mm: Annotated[float, Bounds(0.15, 1.5)] = 0.8
    """Width of the 5 V line."""
    neck_mm: Annotated[float, Bounds(0.15, 0.6)] = 0.34
    """Width of 5 V and ground where they pass the connector and the driver: a few mm, 1 A at 10 K by IPC-2221."""
    signal_mm: Annotated[float, Bounds(0.15, 0.6)] = 0.25
    """Width of all other tracks."""
    via_mm: Annotated[float, Bounds(0.4, 1.0)] = 0.6
    """Diameter of the copper around a via."""
    via_drill_mm: Annotated[float, Bounds(0.2, 0.6)] = 0.3
    """Diameter of the hole of a via."""
    pour: bool = True
    """Whether ground fills both sides wherever nothing else is: it carries the driver's heat away. Nets are connected without
    it."""


LED_PADS_MM = 4.39, 2.10
"""Size of the two pads of a 2835 LED together, along x and y."""


@dataclass(frozen=True)
class LedPositions:
    """Centres of the LEDs: every crossing of these columns and rows on the rim, none inside, so that light comes from
    all around."""

    columns_mm: tuple[float, ...] = (-8.8, 0.0, 8.8)
    """Columns from left to right. A pitch of 8.8 lights the skin of 24 x 18 mm as the original does."""
    rows_mm: tuple[float, ...] = (7.5, 0.0, -7.5)
    """Rows from the upper edge downwards."""

    def __post_init__(self) -> None:
        self._require_order("columns_mm", self.columns_mm, LED_PADS_MM[0])
        self._require_order("rows_mm", tuple(-row for row in self.rows_mm), LED_PADS_MM[1])

    def _require_order(self, name: str, places: tuple[float, ...], pad_mm: float) -> None:
        nearest = min((b - a for a, b in pairwise(places)), default=0.0)
        if not nearest >= pad_mm + 0.3:
            raise LedBoardImpossible(
                f"expected leds.{name} of two or more, in order and at least {pad_mm + 0.3:.2f} mm apart, got {nearest:.2f}; "
                "take fewer LEDs or a larger board"
            )

    @property
    def positions(self) -> tuple[PointMm, ...]:
        """Centres of the LEDs in the order of their numbers: row by row from the upper left."""
        rim = {self.rows_mm[0], self.rows_mm[-1]}
        ends = {self.columns_mm[0], self.columns_mm[-1]}
        return tuple((x, y) for y in self.rows_mm for x in self.columns_mm if y in rim or x in ends)


LED_INSET_MM = LedBoardDimensions.led_inset_mm
"""Distance of the outer LEDs' centres from the edges."""


@dataclass(frozen=True)
class LedBoardDesign(BoundedDimensions, table="led_board"):
    """One LED board. The defaults are the improved board; `original` is the published one, `for_size` one for another
    sensor."""

    outline: BoardOutline = BoardOutline()
    leds: LedPositions = LedPositions()
    rules: BoardDesignRules = BoardDesignRules()
    copper: TrackAndViaDimensions = TrackAndViaDimensions()
    resistor_ohm: Annotated[float, Bounds(1200.0, 30_000.0)] = 20_000.0
    """R1, which sets the current of all LEDs together; the driver follows resistors in this range."""
    input_capacitor: bool = True
    """Whether C1 of 4.7 µF connects 5 V to ground beside U1; the original lacks it."""
    shield_tied: bool = True
    """Whether the USB shell is tied to ground directly. The board has no data lines and no second ground that an RC would
    separate."""
    usb_x_mm: float = 0.0
    """Middle of the connector along x."""
    usb_inset_mm: float = 3.2
    """Distance from the lower edge to the connector's origin; the mouth protrudes by 0.34, as far as the shell allows."""
    usb_contact_mm: Annotated[float, Bounds(1.1, 1.5)] = 1.3
    """Length of the contacts' pads: 1.50 would end 0.06 from the lens hole; shorter pads do not hold the contacts."""
    led_pad_corner_mm: float = 0.53
    """Rounding of the LED pads, which keeps the corner LEDs' copper away from the notches."""
    pads_give_way: bool = True
    """Whether LED pads are cut back where the connector's holes come through the board."""
    driver_x_mm: float = 3.49
    """Middle of U1 along x: between the upper middle LED's pads above and the base's boss below."""
    driver_inset_mm: float = 2.6
    """Distance from the upper edge to the middle of U1."""
    resistor_from_driver_mm: tuple[float, float, float] = (-5.62, -1.5, 180.0)
    """Offset from U1 to R1, and R1's rotation in degrees."""
    led_vias_from_driver_mm: tuple[PointMm, ...] = ((4.36, 1.2), (5.16, 1.2))
    """Offsets from U1 of the vias through which the LEDs' current reaches the upper side."""
    ground_via_from_driver_mm: PointMm = (-8.0, 1.2)
    """Offset from U1 of the via that joins the ground of both sides."""
    faults_known: bool = False
    """Whether the board is written despite the rules that it breaks, which its notes name; so the original can be examined."""

    @property
    def driver(self) -> PointMm:
        """Centre of the LED driver U1."""
        return self.driver_x_mm, self.outline.half[1] - self.driver_inset_mm

    def from_driver(self, offset_mm: PointMm) -> PointMm:
        """Return the point at an offset from the centre of U1."""
        return self.driver[0] + offset_mm[0], self.driver[1] + offset_mm[1]

    @property
    def usb(self) -> PointMm:
        """Origin of the USB connector's footprint."""
        return self.usb_x_mm, self.usb_inset_mm - self.outline.half[1]

    @classmethod
    def for_size(cls, width_mm: float, height_mm: float, columns: int = 3, rows: int = 3) -> "LedBoardDesign":
        """Return the improved board on another outline: holes and outer LEDs keep their distances from the edges."""
        outline = BoardOutline(width_mm, height_mm)
        x, y = outline.half[0] - LED_INSET_MM[0], outline.half[1] - LED_INSET_MM[1]
        columns_mm, rows_mm = np.linspace(-x, x, columns).tolist(), np.linspace(y, -y, rows).tolist()
        return cls(outline, LedPositions(tuple(columns_mm), tuple(rows_mm)))

    @classmethod
    def original(cls) -> "LedBoardDesign":
        """Return the board with dimensions, components and netlist of the published one. The tracks are our own, at the
        original's width."""
        return cls(
            outline=BoardOutline(lens_hole_mm=10.0),
            leds=LedPositions(columns_mm=(-8.769, 0.131, 8.831)),
            rules=BoardDesignRules(clearance_mm=0.152, mask_margin_mm=0.051),
            copper=TrackAndViaDimensions(*(0.254,) * 5, via_mm=0.6, via_drill_mm=0.305, pour=False),
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


def led_board_for_design(design: HardwareDesign) -> LedBoardDesign:
    """Return the LED board that fits a hardware design. The original's components and faults are used only in the
    original's size.

    Raises `LedBoardImpossible`.
    """
    try:
        return _fit_board_to_design(design)
    except LedBoardImpossible:
        raise
    except DesignImpossible as refused:
        raise LedBoardImpossible(
            f"{refused} (outline: the LED board, which follows from sensing_area, hardware.shell, hardware.base and hardware.board)"
        ) from refused


def _fit_board_to_design(design: HardwareDesign) -> LedBoardDesign:
    """Return the LED board that fits a hardware design; raises `DesignImpossible`, of which `LedBoardImpossible` is a kind."""
    width, height = design.horizontal_dimensions.led_board
    original = LedBoardDesign.original()
    as_published = (width, height) == (original.outline.width_mm, original.outline.height_mm)
    made = original if design.variant == "original" and as_published else LedBoardDesign.for_size(width, height)
    _require_component_sizes(design, made)
    receptacle, (driver_x, from_edge) = micro_usb_footprint(made.usb_contact_mm), design.board.driver_at_mm
    return replace(
        made,
        outline=_board_outline_for_design(design, made.outline),
        leds=LedPositions(design.horizontal_dimensions.led_columns, design.horizontal_dimensions.led_rows),
        usb_inset_mm=receptacle.body_at_mm[1] + receptacle.body_mm[1] / 2 - design.board.usb_beyond_mm,
        driver_x_mm=driver_x,
        driver_inset_mm=-from_edge,
        resistor_ohm=design.board.resistor_ohm,
    )


def _board_outline_for_design(design: HardwareDesign, outline: BoardOutline) -> BoardOutline:
    """Return an outline with holes and notches where shell and base have their bosses and pins."""
    plan, board, levels = design.horizontal_dimensions, design.board, design.heights
    mount, screw = max(plan.mount_inserts), max(plan.shell_screws)
    return replace(
        outline,
        thickness_mm=board.thick_mm,
        thickness_limit_mm=levels.ceiling - levels.board_bottom - board.led_mm[2],
        lens_hole_mm=board.lens_hole_mm,
        notch_radius_mm=board.notch_mm,
        notch_inset_mm=(plan.led_board[0] / 2 - screw[0], plan.led_board[1] / 2 - screw[1]),
        locating_hole_mm=board.locating_mm,
        locating_inset_mm=board.locating_inset_mm,
        boss_inset_mm=(plan.led_board[0] / 2 - mount[0], plan.led_board[1] / 2 - mount[1]),
        boss_mm=design.base.boss_mm,
        boss_gap_mm=levels.board_bottom - levels.boss_top,
    )


def _require_component_sizes(design: HardwareDesign, made: LedBoardDesign) -> None:
    """Refuse components of another width or depth than those for which the board has pads; their height is free.

    Raises `LedBoardImpossible`.
    """
    board, driver = design.board, soic_8_ep_footprint().body_mm
    for name, body_mm, drawn_mm in (
        ("led_mm", board.led_mm, led_2835_footprint(made.led_pad_corner_mm).body_mm),
        ("usb_mm", board.usb_mm, micro_usb_footprint(made.usb_contact_mm).body_mm),
        # The driver lies on the board rotated by a right angle.
        ("driver_mm", board.driver_mm, (driver[1], driver[0])),
    ):
        if body_mm[:2] != drawn_mm[:2]:
            raise LedBoardImpossible(
                f"expected board.{name} of {drawn_mm[0]:g} x {drawn_mm[1]:g} mm, the part that the circuit board has pads for, "
                f"got {body_mm[0]:g} x {body_mm[1]:g} mm; leave it, or draw that part's footprint"
            )


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
        raise LedBoardImpossible(
            f"expected a resistor from 1200 to 30000 ohm, which the driver can follow, got {resistor_ohm:g}; take one in that range"
        )
    total_ma = SETTING_V / resistor_ohm * 1000
    if total_ma > USB_MA:
        raise LedBoardImpossible(
            f"expected at most {USB_MA:g} mA from USB, got {total_ma:.0f} mA; take a larger resistor"
        )
    if total_ma / leds > LED_MA:
        raise LedBoardImpossible(
            f"expected at most {LED_MA:g} mA in each LED, got {total_ma / leds:.1f} mA; take a larger resistor or more LEDs"
        )
    return LedOperatingPoint(
        total_ma,
        total_ma / leds,
        REFERENCE_RESISTOR_OHM / resistor_ohm,
        (SUPPLY_V - LED_V) * total_ma / 1000,
        total_ma > USB_DEFAULT_MA,
    )


def operating_point_of_board(board: LedBoardDesign) -> LedOperatingPoint:
    """Return current, brightness and heat of a board."""
    return compute_operating_point(board.resistor_ohm, len(board.leds.positions))

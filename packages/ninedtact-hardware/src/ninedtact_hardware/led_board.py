"""The LED board: one KiCad project of the published size, stored in the folder `led_board_project` with its manufacturing files.

The outline, the holes and the positions of LEDs, driver and connector follow from the sensor design, since other parts leave space
for them. `list_board_differences` compares them with the stored board. The current of the LEDs follows from one resistor:
I = 1800 V / R for all LEDs together (CN5711, done.land/components/light/ledcontroller/cn5711, accuracy 5 %; the maker's data sheet
was not read).

Frame: origin on the optical axis, x along the long side, y along the short one, seen from the gel; the connector's mouth is at -y.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from ninedtact_hardware.design import HardwareDesign

DRAWN_DESIGN = HardwareDesign()
"""The design for which the stored board is drawn."""
ROUNDING_MM = 0.01
"""Difference of two lengths that is none."""
LED_TOLERANCE_MM = 0.15
"""Distance of an LED from its designed position that the light does not show: those of the original stand up to 0.13 off."""
WIDER_LENS_HOLE_MM = 0.25
"""How much wider the drawn lens hole may be: the original's is as wide as its lens."""


@dataclass(frozen=True)
class _DrawnFeature:
    """A feature of the board that its drawing fixes, and by how much a design may want it larger or smaller."""

    name: str
    lengths_mm: tuple[float, ...]
    larger_mm: float = ROUNDING_MM
    smaller_mm: float = ROUNDING_MM

    def is_fulfilled_by(self, drawn: "_DrawnFeature") -> bool:
        """Return whether the drawn feature will do."""
        more_mm = [wanted - found for wanted, found in zip(self.lengths_mm, drawn.lengths_mm, strict=True)]
        return all(-self.smaller_mm <= more <= self.larger_mm for more in more_mm)


def list_board_differences(design: HardwareDesign) -> list[str]:
    """Return in what the board of a design differs from the stored one; nothing if the stored board fits."""
    return [
        f"{wanted.name} {_format_lengths(wanted.lengths_mm)} mm instead of {_format_lengths(drawn.lengths_mm)} mm"
        for wanted, drawn in zip(_drawn_features(design), _drawn_features(DRAWN_DESIGN), strict=True)
        if not wanted.is_fulfilled_by(drawn)
    ]


def _drawn_features(design: HardwareDesign) -> Iterator[_DrawnFeature]:
    plan, board = design.horizontal_dimensions, design.board
    yield _DrawnFeature("outline", plan.led_board)
    yield _DrawnFeature("centres of the corner notches", max(plan.shell_screws))
    yield _DrawnFeature("radius of the corner notches", (board.notch_mm,))
    yield _DrawnFeature("centres of the locating holes", max(plan.posts))
    yield _DrawnFeature("diameter of the locating holes", (board.locating_mm,))
    yield _DrawnFeature("diameter of the lens hole", (board.lens_hole_mm,), smaller_mm=WIDER_LENS_HOLE_MM)
    yield _DrawnFeature("columns of LEDs", plan.led_columns, LED_TOLERANCE_MM, LED_TOLERANCE_MM)
    yield _DrawnFeature("rows of LEDs", plan.led_rows, LED_TOLERANCE_MM, LED_TOLERANCE_MM)
    yield _DrawnFeature("body of the LEDs", board.led_mm[:2])
    yield _DrawnFeature("body of the micro-USB receptacle", board.usb_mm[:2])
    yield _DrawnFeature("receptacle beyond the edge", (board.usb_beyond_mm,))
    yield _DrawnFeature("body of the LED driver", board.driver_mm[:2])
    yield _DrawnFeature("LED driver from the middle and the upper edge", board.driver_at_mm)


def _format_lengths(lengths_mm: tuple[float, ...]) -> str:
    return " / ".join(f"{length_mm:.2f}" for length_mm in lengths_mm)


def describe_redrawing(differences: list[str]) -> str:
    """Return in one sentence what to redraw for a design that the stored board does not fit."""
    return (
        f"expected a design that the stored LED board fits, got one with {', '.join(differences)}; redraw led_board.kicad_pcb in "
        "KiCad, with led_board_outline.dxf as its edge"
    )


DRIVER_VOLTS = 1800.0
"""Product of the driver's current and its resistor: 1800 A·Ω."""
USUAL_RESISTOR_OHM = 20_000.0
"""The resistor of brightness 1, which is that of the original's fabrication files."""
LED_COUNT = 8
SUPPLY_V = 5.0
LED_V = 3.0
"""Forward voltage by the LED's type name. It rises with the current, which makes the driver's loss less than stated."""
LED_LIMIT_MA = 60.0
"""Current limit of a usual 2835 LED of 0.2 W; the data sheet of this one was not read. All eight together stay below the 500 mA of
a USB 2 port."""


class LedOperatingPoint:
    """Current, brightness and heat of the board with a given resistor."""

    def __init__(self, resistor_ohm: float) -> None:
        self.total_ma = DRIVER_VOLTS / resistor_ohm * 1000
        self.led_ma = self.total_ma / LED_COUNT
        """Current of each LED if all share equally: they are in parallel, without resistors of their own."""
        self.relative_brightness = USUAL_RESISTOR_OHM / resistor_ohm
        """Of the light as a whole, beside the usual board's, taken as proportional to the current. White LEDs lose efficiency as
        the current grows, so bright settings turn out a little darker than stated; how much was not measured."""
        self.driver_w = (SUPPLY_V - LED_V) * self.total_ma / 1000
        """Heat in U1, which reduces the current on its own above 135 °C."""


PROJECT = files("ninedtact_hardware") / "led_board_project"
BOARD = "led_board"
USUAL_THICKNESS_MM = 1.6
"""Thickness that board houses take unless another is specified."""
ZIP_TIMESTAMP = 1980, 1, 1, 0, 0, 0
"""Date of all files in the archive, so that the same board gives the same archive."""


def read_board_files(design: HardwareDesign) -> Iterator[tuple[str, bytes]]:
    """Yield path and content of the files of the board: those for the board house only if the stored board fits the design, and
    otherwise the KiCad project to start from."""
    notes = format_fabrication_notes(design).encode()
    yield f"{BOARD}_notes.txt", notes
    yield f"{BOARD}.kicad_pro", (PROJECT / f"{BOARD}.kicad_pro").read_bytes()
    yield f"{BOARD}.kicad_pcb", _read_with_resistor(design, f"{BOARD}.kicad_pcb")
    if list_board_differences(design):
        return
    gerbers = sorted((PROJECT / "gerbers").iterdir(), key=lambda file: file.name)
    fabrication = {file.name: file.read_bytes() for file in gerbers}
    yield from ((f"gerbers/{name}", content) for name, content in fabrication.items())
    yield f"{BOARD}_gerbers.zip", _pack_files(fabrication | {f"{BOARD}_notes.txt": notes})
    yield from ((name, _read_with_resistor(design, name)) for name in (f"{BOARD}_bom.csv", f"{BOARD}_placement.csv"))
    yield f"{BOARD}.png", (PROJECT / f"{BOARD}.png").read_bytes()


def _read_with_resistor(design: HardwareDesign, name: str) -> bytes:
    """Return a stored text with the design's R1. Only the usual one has an order number here."""
    content = (PROJECT / name).read_bytes()
    ohm = design.board.resistor_ohm
    if ohm == USUAL_RESISTOR_OHM:
        return content
    return content.replace(b"RT0805CRE0720KL,C706298", b",").replace(b"20k", f"{ohm / 1000:g}k".encode())


def _pack_files(contents: dict[str, bytes]) -> bytes:
    packed = BytesIO()
    with ZipFile(packed, "w", ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(ZipInfo(name, ZIP_TIMESTAMP), content, ZIP_DEFLATED)
    return packed.getvalue()


def format_fabrication_notes(design: HardwareDesign) -> str:
    """Return instructions for the board house, or what to redraw before one can make the board."""
    (width, height), light = design.horizontal_dimensions.led_board, LedOperatingPoint(design.board.resistor_ohm)
    lines = [f"LED board of a 9DTact sensor, {width:g} x {height:g} mm", ""]
    if differences := list_board_differences(design):
        lines += ["DO NOT ORDER the board of this KiCad project: " + describe_redrawing(differences) + ".", ""]
    return "\n".join(
        [
            *lines,
            f"Thickness: {design.board.thick_mm:g} mm.{_warn_of_usual_thickness(design)}",
            "2 layers, FR4, copper 35 um, any finish, vias covered by solder mask.",
            "The hole in the middle and the four corner notches are part of the outline: milled, no copper.",
            "Components on both sides: LEDs above, U1, R1, USB3, C1 below.",
            "Origin of placement, Gerbers and drill files alike: the middle of the board. "
            "x to the right, y up, seen from the LEDs.",
            "Compare the preview of the placement with led_board.png: board houses count rotations differently.",
            f"R1 = {design.board.resistor_ohm:g} ohm: {light.total_ma:.0f} mA in total, {light.led_ma:.1f} mA in each LED, "
            f"{light.driver_w:.2f} W in U1.",
            "",
        ]
    )


def _warn_of_usual_thickness(design: HardwareDesign) -> str:
    """Return why the board must not have the usual thickness; nothing if it has."""
    if design.board.thick_mm == USUAL_THICKNESS_MM:
        return ""
    levels = design.heights
    touches = levels.board_bottom + USUAL_THICKNESS_MM + design.board.led_mm[2] > levels.ceiling
    why = "with which the LEDs would press against the shell" if touches else "for which this sensor is not made"
    return f" NOT the usual {USUAL_THICKNESS_MM:g} mm, {why}."

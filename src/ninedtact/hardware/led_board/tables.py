"""Lists for the board house: what to buy, where to put it, what to make."""

import csv
from collections.abc import Sequence
from io import StringIO

from ninedtact.hardware.led_board.check import problems
from ninedtact.hardware.led_board.current import board_light
from ninedtact.hardware.led_board.designators import designators
from ninedtact.hardware.led_board.layout import SIDES, Layout
from ninedtact.hardware.led_board.parts import Part
from ninedtact.hardware.led_board.placement import Placed


def parts_list(layout: Layout) -> str:
    """One line for each kind of part, as assemblers read it."""
    rows = []
    for part in kinds(layout.parts):
        where = [placed.reference for placed in layout.parts if placed.part == part]
        rows.append(
            (len(where), ",".join(where), part.value, part.footprint.name, part.maker_number, part.supplier_number)
        )
    head = ("Quantity", "Designator", "Comment", "Footprint", "Manufacturer Part", "LCSC Part #")
    return table(head, rows)


def placements(layout: Layout) -> str:
    """Middle and turn of every part, in millimetres from the optical axis: the origin of Gerbers and drill files."""
    rows = [
        (
            *(placed.reference, placed.part.value, placed.part.footprint.name),
            *(f"{placed.at_mm[0]:.3f}mm", f"{placed.at_mm[1]:.3f}mm"),
            *(f"{placed.turned_deg:g}", placed.side.capitalize()),
        )
        for placed in layout.parts
    ]
    return table(("Designator", "Val", "Package", "Mid X", "Mid Y", "Rotation", "Layer"), rows)


def table(head: tuple[str, ...], rows: Sequence[tuple[object, ...]]) -> str:
    """Comma-separated text."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()


def notes(layout: Layout) -> str:
    """What to tell the board house, and what the board breaks if it is known to be faulty."""
    board, light = layout.board, board_light(layout.board)
    size = f"{board.outline.width_mm:g} x {board.outline.height_mm:g} mm"
    lines = [
        f"LED board of a 9DTact sensor, {size}",
        "",
        f"Thickness: {board.outline.thickness_mm:g} mm. NOT the usual 1.6: the LEDs would press against the shell.",
        "2 layers, FR4, copper 35 um, any finish, vias covered by solder mask.",
        "The hole in the middle and the four corner notches are part of the outline: milled, no copper.",
        f"Parts on both sides: LEDs above, {', '.join(p.reference for p in layout.parts if p.side == 'bottom')} below.",
        "Origin of placement, Gerbers and drill files alike: the middle of the board. x to the right, y up, seen from the LEDs.",
        "Compare the preview of the placement with led_board.png: houses count turns of parts differently.",
        f"R1 = {board.resistor_ohm:g} ohm: {light.total_ma:.0f} mA in all, {light.led_ma:.1f} mA in each LED, "
        f"{light.driver_w:.2f} W in U1.",
    ]
    if unnamed := [part.reference for part in layout.parts if part.reference not in named(layout)]:
        lines.append(f"No room on the silkscreen for the names {', '.join(unnamed)}: led_board.png shows them.")
    faults = problems(layout)
    if faults:
        lines += ["", "DO NOT ORDER. Written for comparison; rules broken (found for wanted, mm):"]
        lines += [f"- {fault}" for fault in faults]
    return "\n".join([*lines, ""])


def named(layout: Layout) -> set[str]:
    """Parts whose names stand on the board."""
    return {word.reference for side in SIDES for word in designators(layout, side)}


def kinds(parts: tuple[Placed, ...]) -> tuple[Part, ...]:
    """Each kind of part once."""
    return tuple(dict.fromkeys(placed.part for placed in parts))

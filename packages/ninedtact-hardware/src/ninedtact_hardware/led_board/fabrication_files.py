"""All files of the board: Gerbers, drill files, KiCad project, parts list, placement, notes for the board house, and an image of it
from the gel and from below. matplotlib is imported when an image is drawn.
"""

import csv
from collections.abc import Sequence
from io import BytesIO, StringIO
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from shapely import union_all
from shapely.geometry.base import BaseGeometry

from ninedtact.atomic_write import write_file_atomically
from ninedtact_hardware.led_board.board_outline_and_holes import BoardOutline, PointMm
from ninedtact_hardware.led_board.board_parameters import LedBoardDesign, operating_point_of_board
from ninedtact_hardware.led_board.complete_layout import (
    SIDES,
    BoardLayout,
    component_outline,
    hole_polygon,
    milled_board_polygon,
    pad_polygon,
    track_polygon,
    via_polygon,
)
from ninedtact_hardware.led_board.components import BoardSide, PlacedComponent
from ninedtact_hardware.led_board.design_rule_check import find_violations, lay_out_checked_board
from ninedtact_hardware.led_board.gerber_and_drill import format_gerber_and_drill_files
from ninedtact_hardware.led_board.kicad import format_kicad_board, format_kicad_project
from ninedtact_hardware.led_board.silkscreen import place_designators

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MASK, METAL, SOLDERED, BODY, INK = "#1f6b45", "#2f9a63", "#d9b65d", "#f4f1e6", "#22262b"
DARK_BODY = "#3b3f46"
USUAL_INCHES = 13.0, 5.6
"""Width and height of the figure for a board of 28 x 21 mm."""
INCHES_PER_MM = USUAL_INCHES[0] / 14.0, USUAL_INCHES[1] / 10.5
NAME_MM = 0.7
"""Height of a component's name."""
HEADINGS: dict[BoardSide, str] = {"top": "from the gel", "bottom": "from below, mirrored as one sees it"}


def _render_board_image(layout: BoardLayout, kind: str = "png") -> bytes:
    """Return both sides beside one another, as `png` or `svg`."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    (x, y), (wide, tall) = layout.board.outline.half, _figure_inches(layout)
    figure = Figure(figsize=(wide, tall), facecolor="white", layout="constrained")
    for side, axes in zip(SIDES, figure.subplots(1, 2), strict=True):
        _draw_side(axes, layout, side)
        axes.set_xlim(*((-x - 1.2, x + 1.2) if side == "top" else (x + 1.2, -x - 1.2)))
        axes.set_ylim(-y - 1.2, y + 1.2)
        axes.set_aspect("equal")
        axes.set_title(HEADINGS[side], color=INK, size=12)
        axes.set_xlabel("x (mm)")
    file = BytesIO()
    # This replaces a random identifier, so that the same board gives the same file.
    with rc_context({"svg.hashsalt": "ninedtact"}):
        figure.savefig(file, format=kind, dpi=110, metadata={"Date": None} if kind == "svg" else {"Software": None})
    return file.getvalue()


def _figure_inches(layout: BoardLayout) -> tuple[float, float]:
    """Return the size of the figure: the same inches per mm for every board, so that texts keep their size beside the
    pads."""
    x, y = layout.board.outline.half
    return max(x * INCHES_PER_MM[0], USUAL_INCHES[0]), max(y * INCHES_PER_MM[1], USUAL_INCHES[1])


def _draw_side(axes: "Axes", layout: BoardLayout, side: BoardSide) -> None:
    """Draw laminate, copper under the mask, bare pads, holes and bodies of one side."""
    tracks = [track_polygon(track) for track in layout.routes.tracks if track.side == side]
    vias = [via_polygon(via) for via in layout.routes.vias]
    _fill_shape(axes, milled_board_polygon(layout.board.outline), MASK)
    _fill_shape(axes, union_all([*tracks, *vias, *layout.pours[side]]), METAL)
    _fill_shape(axes, union_all([pad_polygon(pad) for pad in layout.pads if side in pad.sides]), SOLDERED)
    _fill_shape(axes, union_all([hole_polygon(hole) for hole in layout.holes]), "white")
    for part in layout.parts:
        if part.side == side:
            _draw_component(axes, part)
    for word in place_designators(layout, side):
        for line in word.lines:
            axes.plot(*zip(*line, strict=True), color="white", linewidth=1.2)
    for pad in layout.pads:
        if side in pad.sides and not pad.pin.startswith("LED"):
            axes.text(
                *_pad_number_position(pad.at_mm, layout), pad.land.number, ha="center", va="center", size=6, color=INK
            )


def _pad_number_position(place: PointMm, layout: BoardLayout) -> PointMm:
    """Return the position of a pad's number: a little lower where it would lie on a component's name."""
    under = any(hypot(place[0] - part.at_mm[0], place[1] - part.at_mm[1]) < NAME_MM for part in layout.parts)
    return place[0], place[1] - (NAME_MM if under else 0.0)


def _draw_component(axes: "Axes", part: PlacedComponent) -> None:
    """Draw a component's outline and name, and the poles of LEDs."""
    (x, y), body = part.to_board_frame(part.part.footprint.body_at_mm), component_outline(part)
    _fill_shape(axes, body, BODY if part.side == "top" else DARK_BODY, alpha=0.35)
    axes.plot(*body.exterior.xy, color=INK, linewidth=0.8)
    axes.text(x, y, part.reference, ha="center", va="center", size=8, color=INK, weight="bold")
    if part.reference.startswith("LED"):
        axes.text(x - 1.4, y, "+", ha="center", va="center", size=9, color=INK)
        axes.text(x + 1.4, y, "−", ha="center", va="center", size=9, color=INK)


def _fill_shape(axes: "Axes", shape: BaseGeometry, colour: str, alpha: float = 1.0) -> None:
    """Fill a shape with one colour, its holes left open."""
    from shapely.plotting import patch_from_polygon

    axes.add_patch(patch_from_polygon(shape, facecolor=colour, edgecolor="none", alpha=alpha))


def _format_parts_list(layout: BoardLayout) -> str:
    """Return the parts list as CSV, one line for each kind of component, as assemblers read it."""
    rows = []
    for part in dict.fromkeys(placed.part for placed in layout.parts):
        where = [placed.reference for placed in layout.parts if placed.part == part]
        rows.append(
            (len(where), ",".join(where), part.value, part.footprint.name, part.maker_number, part.supplier_number)
        )
    head = ("Quantity", "Designator", "Comment", "Footprint", "Manufacturer Part", "LCSC Part #")
    return _to_csv(head, rows)


def _format_placement_list(layout: BoardLayout) -> str:
    """Return centre and rotation of every component as CSV, in mm from the optical axis, the origin of Gerbers and
    drill files."""
    rows = [
        (
            *(placed.reference, placed.part.value, placed.part.footprint.name),
            *(f"{placed.at_mm[0]:.3f}mm", f"{placed.at_mm[1]:.3f}mm"),
            *(f"{placed.rotation_deg:g}", placed.side.capitalize()),
        )
        for placed in layout.parts
    ]
    return _to_csv(("Designator", "Val", "Package", "Mid X", "Mid Y", "Rotation", "Layer"), rows)


def _to_csv(head: tuple[str, ...], rows: Sequence[tuple[object, ...]]) -> str:
    """Return rows as comma-separated text."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()


USUAL_THICKNESS_MM = 1.6
"""Thickness that board houses take unless another is specified."""


def _format_thickness_warning(outline: BoardOutline) -> str:
    """Return why the board must not have the usual thickness; nothing if it has."""
    if outline.thickness_mm == USUAL_THICKNESS_MM:
        return ""
    touches = outline.thickness_limit_mm < USUAL_THICKNESS_MM
    why = "with which the LEDs would press against the shell" if touches else "for which this sensor is not made"
    return f" NOT the usual {USUAL_THICKNESS_MM:g} mm, {why}."


def format_fabrication_notes(layout: BoardLayout) -> str:
    """Return instructions for the board house, and the rules that the board breaks if it is known to be faulty."""
    board, light = layout.board, operating_point_of_board(layout.board)
    size = f"{board.outline.width_mm:g} x {board.outline.height_mm:g} mm"
    lines = [
        f"LED board of a 9DTact sensor, {size}",
        "",
        f"Thickness: {board.outline.thickness_mm:g} mm.{_format_thickness_warning(board.outline)}",
        "2 layers, FR4, copper 35 um, any finish, vias covered by solder mask.",
        "The hole in the middle and the four corner notches are part of the outline: milled, no copper.",
        f"Components on both sides: LEDs above, {', '.join(p.reference for p in layout.parts if p.side == 'bottom')} below.",
        "Origin of placement, Gerbers and drill files alike: the middle of the board. x to the right, y up, seen from the LEDs.",
        "Compare the preview of the placement with led_board.png: board houses count rotations differently.",
        f"R1 = {board.resistor_ohm:g} ohm: {light.total_ma:.0f} mA in total, {light.led_ma:.1f} mA in each LED, "
        f"{light.driver_w:.2f} W in U1.",
    ]
    named = {word.reference for side in SIDES for word in place_designators(layout, side)}
    if unnamed := [part.reference for part in layout.parts if part.reference not in named]:
        lines.append(f"No space on the silkscreen for the designators {', '.join(unnamed)}; led_board.png shows them.")
    faults = find_violations(layout)
    if faults:
        lines += ["", "DO NOT ORDER. Written for comparison only. Broken rules (found, required, mm):"]
        lines += [f"- {fault}" for fault in faults]
    return "\n".join([*lines, ""])


BOARD_FILE_NAME = "led_board"
ZIP_TIMESTAMP = 1980, 1, 1, 0, 0, 0
"""Date of all files in the archive, so that the same board gives the same archive."""


def write_checked_board_files(board: LedBoardDesign, out: Path) -> list[Path]:
    """Check and lay out a board and write its files; raises `LedBoardImpossible`, `FileNotWritten`."""
    return write_board_files(lay_out_checked_board(board), out)


def write_board_files(layout: BoardLayout, out: Path) -> list[Path]:
    """Write the files of a board that is laid out and return their paths; raises `FileNotWritten`."""
    files = build_board_files(layout)
    (out / "gerbers").mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        write_file_atomically(out / name, content)
    return [out / name for name in files]


def build_board_files(layout: BoardLayout) -> dict[str, bytes]:
    """Return the content of every file by its name."""
    fabrication = {
        f"{BOARD_FILE_NAME}-{name}": text.encode() for name, text in format_gerber_and_drill_files(layout).items()
    }
    texts = {
        f"{BOARD_FILE_NAME}.kicad_pcb": format_kicad_board(layout),
        f"{BOARD_FILE_NAME}.kicad_pro": format_kicad_project(layout.board, BOARD_FILE_NAME),
        f"{BOARD_FILE_NAME}_bom.csv": _format_parts_list(layout),
        f"{BOARD_FILE_NAME}_placement.csv": _format_placement_list(layout),
        f"{BOARD_FILE_NAME}_notes.txt": format_fabrication_notes(layout),
    }
    return {
        **{f"gerbers/{name}": content for name, content in fabrication.items()},
        **{name: text.encode() for name, text in texts.items()},
        f"{BOARD_FILE_NAME}.png": _render_board_image(layout),
        f"{BOARD_FILE_NAME}.svg": _render_board_image(layout, "svg"),
        f"{BOARD_FILE_NAME}_gerbers.zip": _zip_files(
            {**fabrication, f"{BOARD_FILE_NAME}_notes.txt": texts[f"{BOARD_FILE_NAME}_notes.txt"].encode()}
        ),
    }


def _zip_files(files: dict[str, bytes]) -> bytes:
    """Return an archive that is the same for the same files."""
    packed = BytesIO()
    with ZipFile(packed, "w", ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(ZipInfo(name, ZIP_TIMESTAMP), content, ZIP_DEFLATED)
    return packed.getvalue()

"""The LED board as KiCad 6 files, written without KiCad: the board, and a project with its design rules, so that KiCad's
own check applies the same rules. Source: dev-docs.kicad.org, "Board File Format".

The template led_board.kicad_pcb.jinja has the file as KiCad reads it; the functions here are its filters. KiCad's y points down;
the optical axis lies in the middle of the sheet. Footprints are written as they lie on the board, not rotated: pads carry their
positions.
"""

import json
from collections.abc import Iterable, Sequence
from itertools import pairwise
from uuid import NAMESPACE_URL, uuid5

from ninedtact_hardware.led_board.board_outline_and_holes import PointMm, outline_segments
from ninedtact_hardware.led_board.board_parameters import LedBoardDesign
from ninedtact_hardware.led_board.complete_layout import SIDES, BoardLayout, merge_polygon_holes
from ninedtact_hardware.led_board.gerber_and_drill import THERMAL_PASTE_MM, pad_contour, thermal_pad_paste_windows
from ninedtact_hardware.led_board.silkscreen import PEN_MM, place_designators

SHEET_CENTRE_MM = 148.5, 105.0
"""Middle of an A4 sheet."""


def format_kicad_board(layout: BoardLayout) -> str:
    """Return the board file; the same board gives the same text."""
    # jinja2 is slow to import, and only this function needs it.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    files = Environment(
        loader=PackageLoader("ninedtact_hardware.led_board", "."),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    files.filters |= {
        "mm": _format_length,
        "point": _format_point,
        "on_sheet": _format_sheet_point,
        "relative_to": _format_relative_point,
        "vertices": _format_vertices,
        "segments": _split_into_segments,
        "identity": _stable_identity,
        "merged": merge_polygon_holes,
        "contour": pad_contour,
        "paste_windows": thermal_pad_paste_windows,
    }
    references = [part.reference for part in layout.parts]
    return files.get_template("led_board.kicad_pcb.jinja").render(
        layout=layout,
        board=layout.board,
        sides=SIDES,
        copper_layer={"top": "F.Cu", "bottom": "B.Cu"},
        net_numbers={net.name: number for number, net in enumerate(layout.nets, start=1)},
        pads={name: [pad for pad in layout.pads if pad.pin.split(".")[0] == name] for name in references},
        designators={side: place_designators(layout, side) for side in SIDES},
        edges=outline_segments(layout.board.outline),
        pen_mm=PEN_MM,
        paste_mm=THERMAL_PASTE_MM,
    )


def _format_length(length_mm: float) -> str:
    """Return a number with as many decimals as it needs, six at most."""
    return f"{round(length_mm, 6) + 0.0:.6f}".rstrip("0").rstrip(".")


def _format_point(place: PointMm) -> str:
    """Return the two numbers of a point or a size."""
    return f"{_format_length(place[0])} {_format_length(place[1])}"


def _format_sheet_point(place: PointMm) -> str:
    """Return a point of the board as a point on the sheet."""
    return _format_point((SHEET_CENTRE_MM[0] + place[0], SHEET_CENTRE_MM[1] - place[1]))


def _format_relative_point(place: PointMm, origin: PointMm) -> str:
    """Return a point relative to an origin, in KiCad's axes."""
    return _format_point((place[0] - origin[0], origin[1] - place[1]))


def _format_vertices(contour: Iterable[PointMm]) -> str:
    """Return the vertices of a contour on the sheet."""
    return " ".join(f"(xy {_format_sheet_point(place)})" for place in contour)


def _split_into_segments(lines: Iterable[Sequence[PointMm]]) -> list[tuple[PointMm, PointMm]]:
    """Return the straight pieces of several lines, each with its two ends."""
    return [ends for line in lines for ends in pairwise(line)]


def _stable_identity(words: str) -> str:
    """Return an identifier that does not change from one file to the next."""
    return str(uuid5(NAMESPACE_URL, f"ninedtact/led_board/{words}"))


def format_kicad_project(board: LedBoardDesign, name: str) -> str:
    """Return the project file with the board's design rules."""
    rules, copper = board.rules, board.copper
    least = {
        "min_clearance": rules.clearance_mm,
        "min_copper_edge_clearance": rules.copper_to_edge_mm,
        "min_hole_clearance": rules.copper_to_hole_mm,
        "min_hole_to_hole": rules.hole_to_hole_mm,
        "min_track_width": min(copper.led_mm, copper.ground_mm, copper.supply_mm, copper.neck_mm, copper.signal_mm),
        "min_via_diameter": copper.via_mm,
        "min_through_hole_diameter": copper.via_drill_mm,
        "min_via_annular_width": (copper.via_mm - copper.via_drill_mm) / 2 - 0.001,
    }
    usual = {
        "name": "Default",
        "clearance": rules.clearance_mm,
        "track_width": copper.signal_mm,
        "via_diameter": copper.via_mm,
        "via_drill": copper.via_drill_mm,
    }
    content = {
        "board": {"design_settings": {"rules": least}},
        "meta": {"filename": f"{name}.kicad_pro", "version": 1},
        "net_settings": {"classes": [usual], "meta": {"version": 2}},
    }
    return json.dumps(content, indent=2) + "\n"

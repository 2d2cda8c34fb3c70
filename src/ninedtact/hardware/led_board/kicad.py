"""The LED board as KiCad 6 files, written without KiCad: the board, and a project with its design rules, so that KiCad's
own check applies the same rules. Source: dev-docs.kicad.org, "Board File Format".

KiCad's y points down; the optical axis lies in the middle of the sheet. Footprints are written as they lie on the
board, not rotated: pads carry their positions.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NewType
from uuid import NAMESPACE_URL, uuid5

from ninedtact.hardware.led_board.board_outline_and_holes import BoardOutline, PointMm, outline_segments
from ninedtact.hardware.led_board.board_parameters import LedBoardDesign
from ninedtact.hardware.led_board.complete_layout import SIDES, BoardLayout, merge_polygon_holes
from ninedtact.hardware.led_board.components import GROUND, BoardPad, BoardSide, PlacedComponent
from ninedtact.hardware.led_board.gerber_and_drill import (
    THERMAL_PASTE_MM,
    pad_contour,
    thermal_pad_paste_windows,
)
from ninedtact.hardware.led_board.routing import Routes
from ninedtact.hardware.led_board.silkscreen import PEN_MM, place_designators

QuotedText = NewType("QuotedText", str)
"""Text that is written in quotation marks."""
Expression = str | float | bool | tuple[Any, ...]
"""An S-expression: words, numbers, booleans, and lists of these."""


def _quote(words: str) -> QuotedText:
    """Return a text in quotation marks."""
    return QuotedText('"' + words.replace("\\", "\\\\").replace('"', '\\"') + '"')


def _format_expression(expression: Expression, depth: int = 0) -> str:
    """Return an expression as text; lists that hold lists take a line each."""
    match expression:
        case bool():
            return "yes" if expression else "no"
        case float() | int():
            return _format_number(expression)
        case str():
            return expression
    inner = [_format_expression(part, depth + 1) for part in expression]
    if not any(isinstance(part, tuple) for part in expression) or sum(map(len, inner)) < 90:
        return f"({' '.join(inner)})"
    gap = "\n" + "  " * (depth + 1)
    return f"({inner[0]}{gap}{gap.join(inner[1:])})"


def _format_number(value: float) -> str:
    """Return a number with as many decimals as it needs, six at most."""
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".")


SHEET_CENTRE_MM = 148.5, 105.0
"""Middle of an A4 sheet."""
COPPER_LAYER: dict[BoardSide, str] = {"top": "F.Cu", "bottom": "B.Cu"}


@dataclass(frozen=True)
class _NetNumbers:
    """Numbers of the nets, from one; zero is no net."""

    nets: list[str]

    def number(self, net: str) -> int:
        """Return the number of a net."""
        return self.nets.index(net) + 1

    @property
    def declarations(self) -> tuple[Expression, ...]:
        """The expressions that declare all nets."""
        return (("net", 0, _quote("")), *(("net", n + 1, _quote(net)) for n, net in enumerate(self.nets)))


def _sheet_point(word: str, place: PointMm) -> Expression:
    """Return a point of the board as a point on the sheet."""
    return (word, SHEET_CENTRE_MM[0] + place[0], SHEET_CENTRE_MM[1] - place[1])


def _position(place: PointMm) -> Expression:
    """Return the position of an item on the sheet."""
    return _sheet_point("at", place)


def _relative_point(word: str, place: PointMm, origin: PointMm) -> Expression:
    """Return a point relative to an origin, in KiCad's axes."""
    return (word, place[0] - origin[0], origin[1] - place[1])


def _identity(words: str) -> Expression:
    """Return an identifier that does not change from one file to the next."""
    return ("tstamp", str(uuid5(NAMESPACE_URL, f"ninedtact/led_board/{words}")))


FONT: Expression = ("font", ("size", 0.8, 0.8), ("thickness", 0.12))


def _component_footprint(layout: BoardLayout, part: PlacedComponent, names: _NetNumbers) -> Expression:
    """Return a component with its pads, mark and pegs."""
    letter = "F" if part.side == "top" else "B"
    mine = [pad for pad in layout.pads if pad.pin.split(".")[0] == part.reference]
    pads = [_footprint_pad(pad, part.at_mm, letter, names) for pad in mine]
    paste = [window for pad in mine if not pad.land.paste and not pad.hole for window in _paste_pads(pad, part, letter)]
    return (
        *("footprint", _quote(f"ninedtact:{part.part.footprint.name}"), ("layer", _quote(f"{letter}.Cu"))),
        *(_identity(part.reference), _position(part.at_mm), ("attr", "smd")),
        *(_footprint_text("reference", part.reference, letter), _footprint_text("value", part.part.value, letter)),
        *(*_footprint_mark(part, letter), *pads, *paste, *_peg_holes(part)),
    )


def _footprint_text(kind: str, text: str, letter: str) -> Expression:
    """Return reference or value on the fabrication layer."""
    effects: Expression = ("effects", FONT) if letter == "F" else ("effects", FONT, ("justify", "mirror"))
    line = 0 if kind == "reference" else 1
    return ("fp_text", kind, _quote(text), ("at", 0, line), ("layer", _quote(f"{letter}.Fab")), effects)


def _footprint_mark(part: PlacedComponent, letter: str) -> list[Expression]:
    """Return the bar at the cathode or at pin 1."""
    if part.part.footprint.mark_mm is None:
        return []
    start, end = (part.to_board_frame(place) for place in part.part.footprint.mark_mm)
    ends = _relative_point("start", start, part.at_mm), _relative_point("end", end, part.at_mm)
    return [("fp_line", *ends, ("layer", _quote(f"{letter}.SilkS")), ("width", PEN_MM))]


def _footprint_pad(pad: BoardPad, origin: PointMm, letter: str, names: _NetNumbers) -> Expression:
    """Return one pad."""
    number, identity = _quote(pad.land.number), _identity(f"pad {pad.pin}")
    net = (("net", names.number(pad.net), _quote(pad.net)),) if pad.net else ()
    where, solid = _relative_point("at", pad.at_mm, origin), () if pad.land.pour_gap else (("zone_connect", 2),)
    size: Expression = ("size", *pad.size_mm)
    if pad.hole and pad.land.slot_mm:
        drill = ("drill", "oval", *pad.land.slot_mm)
        return ("pad", number, "thru_hole", "oval", where, size, drill, ALL_LAYERS, *net, *solid, identity)
    used = ("Cu", "Paste", "Mask") if pad.land.paste else ("Cu", "Mask")
    layers: Expression = ("layers", *(_quote(f"{letter}.{name}") for name in used))
    kind = "rect"
    rounding: tuple[Expression, ...] = ()
    outline: tuple[Expression, ...] = ()
    if pad.cutouts:
        kind, size, outline = "custom", ("size", 0.5, 0.5), _custom_pad_shape(pad)
    elif pad.land.corner_mm:
        kind, rounding = "roundrect", (("roundrect_rratio", pad.land.corner_mm / min(pad.size_mm)),)
    return ("pad", number, "smd", kind, where, size, layers, *rounding, *net, *solid, *outline, identity)


def _custom_pad_shape(pad: BoardPad) -> tuple[Expression, ...]:
    """Return the shape of a pad with cutouts."""
    points: Expression = ("pts", *(("xy", x, -y) for x, y in pad_contour(pad)))
    polygon: Expression = ("gr_poly", points, ("width", 0), ("fill", True))
    return ("options", ("clearance", "outline"), ("anchor", "circle")), ("primitives", polygon)


def _paste_pads(pad: BoardPad, part: PlacedComponent, letter: str) -> list[Expression]:
    """Return the windows of paste on the thermal pad."""
    layers, size = ("layers", _quote(f"{letter}.Paste")), ("size", THERMAL_PASTE_MM, THERMAL_PASTE_MM)
    places = [_relative_point("at", window, part.at_mm) for window in thermal_pad_paste_windows(pad)]
    return [("pad", _quote(""), "smd", "rect", place, size, layers) for place in places]


ALL_LAYERS: Expression = ("layers", _quote("*.Cu"), _quote("*.Mask"))


def _unplated_hole(where: Expression, diameter_mm: float, *more: Expression) -> Expression:
    """Return a hole without copper."""
    size = ("size", diameter_mm, diameter_mm), ("drill", diameter_mm)
    return ("pad", _quote(""), "np_thru_hole", "circle", where, *size, ALL_LAYERS, *more)


def _peg_holes(part: PlacedComponent) -> Iterator[Expression]:
    """Yield the holes for the pegs of a component."""
    for x, y, diameter in part.part.footprint.pegs_mm:
        yield _unplated_hole(_relative_point("at", part.to_board_frame((x, y)), part.at_mm), diameter)


KICAD_LAYERS = (
    (0, "F.Cu", "signal"),
    (31, "B.Cu", "signal"),
    *((number, name, "user") for number, name in ((34, "B.Paste"), (35, "F.Paste"), (36, "B.SilkS"), (37, "F.SilkS"))),
    *((number, name, "user") for number, name in ((38, "B.Mask"), (39, "F.Mask"), (44, "Edge.Cuts"))),
    *((number, name, "user") for number, name in ((46, "B.CrtYd"), (47, "F.CrtYd"), (48, "B.Fab"), (49, "F.Fab"))),
)


def format_kicad_board(layout: BoardLayout) -> str:
    """Return the board file; the same board gives the same text."""
    names = _NetNumbers([net.name for net in layout.nets])
    return (
        _format_expression(("kicad_pcb", *_board_header(layout), *names.declarations, *_board_content(layout, names)))
        + "\n"
    )


def _board_header(layout: BoardLayout) -> tuple[Expression, ...]:
    """Return the part of the file before the nets."""
    board = layout.board
    layers: Expression = ("layers", *((number, _quote(name), kind) for number, name, kind in KICAD_LAYERS))
    return (
        ("version", "20211014"),
        ("generator", "ninedtact"),
        ("general", ("thickness", board.outline.thickness_mm)),
        ("paper", _quote("A4")),
        layers,
        (
            "setup",
            ("pad_to_mask_clearance", board.rules.mask_margin_mm),
            _sheet_point("aux_axis_origin", (0, 0)),
            _sheet_point("grid_origin", (0, 0)),
        ),
    )


def _board_content(layout: BoardLayout, names: _NetNumbers) -> tuple[Expression, ...]:
    """Return components, holes, silkscreen, edge, tracks and pour."""
    parts = [_component_footprint(layout, part, names) for part in layout.parts]
    holes = [
        _locating_hole(number, place, layout.board.outline)
        for number, place in enumerate(layout.board.outline.locating_holes)
    ]
    zones = [_ground_zone(layout, side, names) for side in SIDES if layout.pours[side]]
    words = [line for side in SIDES for line in _silkscreen_lines(layout, side)]
    return (*parts, *holes, *words, *_outline_items(layout.board.outline), *_track_items(layout.routes, names), *zones)


def _silkscreen_lines(layout: BoardLayout, side: BoardSide) -> Iterator[Expression]:
    """Yield the strokes of the designators on the silkscreen."""
    layer = _quote("F.SilkS" if side == "top" else "B.SilkS")
    for word in place_designators(layout, side):
        for number, (start, end) in enumerate(pair for line in word.lines for pair in pairwise(line)):
            tail = ("layer", layer), ("width", PEN_MM), _identity(f"name {word.reference} {number}")
            yield ("gr_line", _sheet_point("start", start), _sheet_point("end", end), *tail)


def _locating_hole(number: int, place: tuple[float, float], outline: BoardOutline) -> Expression:
    """Return a locating hole as a footprint of its own, as KiCad requires."""
    hole = _unplated_hole(("at", 0, 0), outline.locating_hole_mm, _identity(f"hole {number} pad"))
    attributes = ("attr", "exclude_from_pos_files", "exclude_from_bom")
    return (
        *("footprint", _quote("ninedtact:locating_hole"), ("layer", _quote("F.Cu"))),
        *(_identity(f"hole {number}"), _position(place), attributes, hole),
    )


def _outline_items(outline: BoardOutline) -> list[Expression]:
    """Return the milled edge."""
    found: list[Expression] = []
    for number, edge in enumerate(outline_segments(outline)):
        tail = (("layer", _quote("Edge.Cuts")), ("width", 0.1), _identity(f"edge {number}"))
        ends = _sheet_point("start", edge.start_mm), _sheet_point("end", edge.end_mm)
        if edge.centre_mm is None:
            found.append(("gr_line", *ends, *tail))
        else:
            found.append(("gr_arc", ends[0], _sheet_point("mid", edge.middle), ends[1], *tail))
    return found


def _track_items(routes: Routes, names: _NetNumbers) -> list[Expression]:
    """Return tracks, one item for each straight piece, and vias."""
    found: list[Expression] = []
    for number, track in enumerate(routes.tracks):
        tail = (
            ("width", track.width_mm),
            ("layer", _quote(COPPER_LAYER[track.side])),
            ("net", names.number(track.net)),
        )
        for piece, (a, b) in enumerate(pairwise(track.points)):
            found.append(
                (
                    "segment",
                    _sheet_point("start", a),
                    _sheet_point("end", b),
                    *tail,
                    _identity(f"track {number} {piece}"),
                )
            )
    for number, via in enumerate(routes.vias):
        size = ("size", via.diameter_mm), ("drill", via.drill_mm), ("layers", _quote("F.Cu"), _quote("B.Cu"))
        found.append(("via", _position(via.at_mm), *size, ("net", names.number(via.net)), _identity(f"via {number}")))
    return found


def _ground_zone(layout: BoardLayout, side: BoardSide, names: _NetNumbers) -> Expression:
    """Return the pour of one side, filled as it is in the Gerbers."""
    x, y = layout.board.outline.half
    gap, layer = layout.board.rules.pour_gap_mm, _quote(COPPER_LAYER[side])
    rim = ("pts", *(_sheet_point("xy", corner) for corner in ((-x, -y), (x, -y), (x, y), (-x, y))))
    fills = [
        (
            "filled_polygon",
            ("layer", layer),
            ("pts", *(_sheet_point("xy", point) for point in merge_polygon_holes(piece))),
        )
        for piece in layout.pours[side]
    ]
    return (
        *(
            "zone",
            ("net", names.number(GROUND)),
            ("net_name", _quote(GROUND)),
            ("layer", layer),
            _identity(f"zone {side}"),
        ),
        *(("hatch", "edge", 0.5), ("connect_pads", ("clearance", gap)), ("min_thickness", 0.25)),
        ("filled_areas_thickness", False),
        ("fill", True, ("thermal_gap", gap), ("thermal_bridge_width", 0.4)),
        *(("polygon", rim), *fills),
    )


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

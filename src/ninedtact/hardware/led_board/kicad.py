"""The board as a KiCad 6 file, written without KiCad. Source: dev-docs.kicad.org, "Board File Format".

KiCad's y points down; the optical axis lies in the middle of the sheet. Footprints are written as they lie on the board, not
turned: pads carry their places.
"""

from collections.abc import Iterator
from itertools import pairwise

from ninedtact.hardware.led_board.designators import PEN_MM, designators
from ninedtact.hardware.led_board.edge import edges
from ninedtact.hardware.led_board.keyhole import without_holes
from ninedtact.hardware.led_board.kicad_footprint import footprint
from ninedtact.hardware.led_board.kicad_frame import COPPER, Names, at, stamp, xy
from ninedtact.hardware.led_board.layout import SIDES, Layout
from ninedtact.hardware.led_board.netlist import GROUND
from ninedtact.hardware.led_board.outline import BoardOutline
from ninedtact.hardware.led_board.placement import Side
from ninedtact.hardware.led_board.sexpr import Expression, quoted, written
from ninedtact.hardware.led_board.tracks import Routes

LAYERS = (
    (0, "F.Cu", "signal"),
    (31, "B.Cu", "signal"),
    *((number, name, "user") for number, name in ((34, "B.Paste"), (35, "F.Paste"), (36, "B.SilkS"), (37, "F.SilkS"))),
    *((number, name, "user") for number, name in ((38, "B.Mask"), (39, "F.Mask"), (44, "Edge.Cuts"))),
    *((number, name, "user") for number, name in ((46, "B.CrtYd"), (47, "F.CrtYd"), (48, "B.Fab"), (49, "F.Fab"))),
)


def kicad_board(layout: Layout) -> str:
    """The file's text; the same board gives the same text."""
    names = Names([net.name for net in layout.nets])
    return written(("kicad_pcb", *head(layout), *names.declared, *content(layout, names))) + "\n"


def head(layout: Layout) -> tuple[Expression, ...]:
    """What stands before the nets."""
    board = layout.board
    layers: Expression = ("layers", *((number, quoted(name), kind) for number, name, kind in LAYERS))
    return (
        ("version", "20211014"),
        ("generator", "ninedtact"),
        ("general", ("thickness", board.outline.thickness_mm)),
        ("paper", quoted("A4")),
        layers,
        (
            "setup",
            ("pad_to_mask_clearance", board.rules.mask_margin_mm),
            xy("aux_axis_origin", (0, 0)),
            xy("grid_origin", (0, 0)),
        ),
    )


def content(layout: Layout, names: Names) -> tuple[Expression, ...]:
    """Parts, edge, tracks, pour."""
    parts = [footprint(layout, part, names) for part in layout.parts]
    holes = [
        peg(number, place, layout.board.outline) for number, place in enumerate(layout.board.outline.locating_holes)
    ]
    zones = [zone(layout, side, names) for side in SIDES if layout.pours[side]]
    words = [line for side in SIDES for line in word_lines(layout, side)]
    return (*parts, *holes, *words, *edge_lines(layout.board.outline), *track_lines(layout.routes, names), *zones)


def word_lines(layout: Layout, side: Side) -> Iterator[Expression]:
    """The parts' names on the silkscreen."""
    layer = quoted("F.SilkS" if side == "top" else "B.SilkS")
    for word in designators(layout, side):
        for number, (start, end) in enumerate(pair for line in word.lines for pair in pairwise(line)):
            tail = ("layer", layer), ("width", PEN_MM), stamp(f"name {word.reference} {number}")
            yield ("gr_line", xy("start", start), xy("end", end), *tail)


def peg(number: int, place: tuple[float, float], outline: BoardOutline) -> Expression:
    """A locating hole: a footprint of its own, as KiCad wants holes."""
    size = ("size", outline.locating_hole_mm, outline.locating_hole_mm)
    hole = ("pad", quoted(""), "np_thru_hole", "circle", ("at", 0, 0), size, ("drill", outline.locating_hole_mm))
    layers = ("layers", quoted("*.Cu"), quoted("*.Mask"))
    attributes = ("attr", "exclude_from_pos_files", "exclude_from_bom")
    return (
        *("footprint", quoted("ninedtact:locating_hole"), ("layer", quoted("F.Cu"))),
        *(stamp(f"hole {number}"), at(place), attributes, (*hole, layers, stamp(f"hole {number} pad"))),
    )


def edge_lines(outline: BoardOutline) -> list[Expression]:
    """The milled edge."""
    found: list[Expression] = []
    for number, edge in enumerate(edges(outline)):
        tail = (("layer", quoted("Edge.Cuts")), ("width", 0.1), stamp(f"edge {number}"))
        ends = xy("start", edge.start_mm), xy("end", edge.end_mm)
        if edge.centre_mm is None:
            found.append(("gr_line", *ends, *tail))
        else:
            found.append(("gr_arc", ends[0], xy("mid", edge.middle), ends[1], *tail))
    return found


def track_lines(routes: Routes, names: Names) -> list[Expression]:
    """Tracks, one straight piece each, and vias."""
    found: list[Expression] = []
    for number, track in enumerate(routes.tracks):
        tail = (("width", track.width_mm), ("layer", quoted(COPPER[track.side])), ("net", names.number(track.net)))
        for piece, (a, b) in enumerate(zip(track.points, track.points[1:], strict=False)):
            found.append(("segment", xy("start", a), xy("end", b), *tail, stamp(f"track {number} {piece}")))
    for number, via in enumerate(routes.vias):
        size = ("size", via.diameter_mm), ("drill", via.drill_mm), ("layers", quoted("F.Cu"), quoted("B.Cu"))
        found.append(("via", at(via.at_mm), *size, ("net", names.number(via.net)), stamp(f"via {number}")))
    return found


def zone(layout: Layout, side: Side, names: Names) -> Expression:
    """The pour of one side, filled as it is in the Gerbers."""
    x, y = layout.board.outline.half
    gap, layer = layout.board.rules.pour_gap_mm, quoted(COPPER[side])
    rim = ("pts", *(xy("xy", corner) for corner in ((-x, -y), (x, -y), (x, y), (-x, y))))
    fills = [
        ("filled_polygon", ("layer", layer), ("pts", *(xy("xy", point) for point in without_holes(piece))))
        for piece in layout.pours[side]
    ]
    return (
        *("zone", ("net", names.number(GROUND)), ("net_name", quoted(GROUND)), ("layer", layer), stamp(f"zone {side}")),
        *(("hatch", "edge", 0.5), ("connect_pads", ("clearance", gap)), ("min_thickness", 0.25)),
        ("filled_areas_thickness", False),
        ("fill", True, ("thermal_gap", gap), ("thermal_bridge_width", 0.4)),
        *(("polygon", rim), *fills),
    )

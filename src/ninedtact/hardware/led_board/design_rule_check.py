"""The design-rule check: each net is one piece, none touches another, and all copper is far enough from edges and
holes."""

from dataclasses import dataclass
from itertools import combinations

from shapely import Point, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.board_outline import LedBoardImpossible, PointMm
from ninedtact.hardware.led_board.board_parameters import LedBoard
from ninedtact.hardware.led_board.complete_layout import SIDES, BoardLayout, lay_out_board
from ninedtact.hardware.led_board.components import BoardSide
from ninedtact.hardware.led_board.copper_geometry import (
    bare_board_polygon,
    component_outline,
    hole_polygon,
    pad_polygon,
    split_polygons,
    track_polygon,
    via_polygon,
)
from ninedtact.hardware.led_board.led_current import operating_point_of_board
from ninedtact.hardware.led_board.netlist_and_pads import GROUND

MIN_CONTACT_MM2 = 0.01
"""Least common area by which two pieces of copper are one conductor."""
ROUNDING_MM = 0.002
"""Tolerance for circles that are approximated by polygons."""


@dataclass(frozen=True)
class CopperPiece:
    """One pad, track, via or piece of a pour."""

    name: str
    net: str | None
    sides: tuple[BoardSide, ...]
    shape: BaseGeometry


@dataclass(frozen=True)
class RuleViolation:
    """A rule that a board breaks, where, and by how much."""

    rule: str
    where: str
    required_mm: float
    found_mm: float

    def __str__(self) -> str:
        return f"{self.rule} {self.where}: {self.found_mm:.3f} for {self.required_mm:.3f}"


def lay_out_checked_board(board: LedBoard) -> BoardLayout:
    """Lay out a board; raises `LedBoardImpossible` where it breaks a rule or its LEDs cannot be lit."""
    operating_point_of_board(board)
    layout = lay_out_board(board)
    require_no_violations(layout)
    return layout


def require_no_violations(layout: BoardLayout) -> None:
    """Refuse a board that breaks a rule, unless its faults are known; raises `LedBoardImpossible`."""
    found = find_violations(layout)
    if found and not layout.board.faults_known:
        raise LedBoardImpossible(
            f"expected a circuit board without faults, got {len(found)}, the first {found[0]}; "
            "make the board larger, take fewer LEDs, or loosen its rules"
        )


def find_violations(layout: BoardLayout) -> tuple[RuleViolation, ...]:
    """Return all rules that a board breaks; none for a valid one."""
    copper = list_copper_pieces(layout)
    return (
        *find_open_nets(layout, copper),
        *_find_close_copper(layout, copper),
        *_find_copper_near_edges(layout, copper),
        *_find_copper_near_holes(layout, copper),
        *_find_close_holes(layout),
        *_find_cut_pads(layout),
        *_find_components_over_bosses(layout),
    )


def list_copper_pieces(layout: BoardLayout) -> tuple[CopperPiece, ...]:
    """Return all copper of the board."""
    found = [CopperPiece(pad.pin, pad.net, pad.sides, pad_polygon(pad)) for pad in layout.pads]
    for n, track in enumerate(layout.routes.tracks):
        found.append(CopperPiece(f"track {n} of {track.net}", track.net, (track.side,), track_polygon(track)))
    for n, via in enumerate(layout.routes.vias):
        found.append(CopperPiece(f"via {n} of {via.net}", via.net, SIDES, via_polygon(via)))
    for side in SIDES:
        found += [CopperPiece(f"pour {side} {n}", GROUND, (side,), shape) for n, shape in enumerate(layout.pours[side])]
    return tuple(found)


def find_open_nets(layout: BoardLayout, copper: tuple[CopperPiece, ...]) -> list[RuleViolation]:
    """Return the nets that are not one piece, with the number of their pieces."""
    found = []
    for net in layout.nets:
        groups = _group_touching([piece for piece in copper if piece.net == net.name])
        if len(groups) != 1:
            found.append(RuleViolation("pieces of net", net.name, 1, len(groups)))
    return found


def _group_touching(copper: list[CopperPiece]) -> list[list[CopperPiece]]:
    """Return groups of pieces that are connected."""
    groups: list[list[CopperPiece]] = []
    for piece in copper:
        touched = [group for group in groups if any(_do_touch(piece, other) for other in group)]
        groups = [group for group in groups if group not in touched] + [[piece, *(p for g in touched for p in g)]]
    return groups


def _do_touch(a: CopperPiece, b: CopperPiece) -> bool:
    """Return whether two pieces are one conductor."""
    return bool(set(a.sides) & set(b.sides)) and a.shape.intersection(b.shape).area >= MIN_CONTACT_MM2


def _find_close_copper(layout: BoardLayout, copper: tuple[CopperPiece, ...]) -> list[RuleViolation]:
    """Return copper of different nets that is too close; an open pin is a net of its own."""
    least, found = layout.board.rules.clearance_mm, []
    for a, b in combinations(copper, 2):
        if (a.net == b.net and (a.net or a.name == b.name)) or not set(a.sides) & set(b.sides):
            continue
        gap = a.shape.distance(b.shape)
        if gap < least - ROUNDING_MM:
            found.append(RuleViolation("clearance", f"{a.name} to {b.name}", least, gap))
    return found


def _find_copper_near_edges(layout: BoardLayout, copper: tuple[CopperPiece, ...]) -> list[RuleViolation]:
    """Return copper too close to the milled edge, or over it."""
    least, board = layout.board.rules.copper_to_edge_mm, bare_board_polygon(layout.board.outline)
    gaps = [(piece, piece.shape.distance(board.boundary) if board.contains(piece.shape) else 0.0) for piece in copper]
    return [RuleViolation("copper to edge", p.name, least, gap) for p, gap in gaps if gap < least - ROUNDING_MM]


def _find_copper_near_holes(layout: BoardLayout, copper: tuple[CopperPiece, ...]) -> list[RuleViolation]:
    """Return copper too close to unplated holes."""
    least, found = layout.board.rules.copper_to_hole_mm, []
    for hole in (hole for hole in layout.holes if not hole.plated):
        bore = hole_polygon(hole)
        gaps = [(piece, piece.shape.distance(bore)) for piece in copper]
        found += [
            RuleViolation("copper to hole", f"{p.name} at {_format_point(hole.start_mm)}", least, gap)
            for p, gap in gaps
            if gap < least - ROUNDING_MM
        ]
    return found


def _find_close_holes(layout: BoardLayout) -> list[RuleViolation]:
    """Return holes so close that the wall between them would break."""
    least = layout.board.rules.hole_to_hole_mm
    pairs = [(a, b, hole_polygon(a).distance(hole_polygon(b))) for a, b in combinations(layout.holes, 2)]
    return [
        RuleViolation("hole to hole", f"{_format_point(a.start_mm)} to {_format_point(b.start_mm)}", least, gap)
        for a, b, gap in pairs
        if gap < least - ROUNDING_MM
    ]


def _find_cut_pads(layout: BoardLayout) -> list[RuleViolation]:
    """Return pads of which too small a share is left in one piece."""
    least, found = layout.board.rules.least_pad_share, []
    for pad in (pad for pad in layout.pads if pad.bites):
        left = max((piece.area for piece in split_polygons(pad_polygon(pad))), default=0.0)
        share = left / (pad.size_mm[0] * pad.size_mm[1])
        if share < least:
            found.append(RuleViolation("share left of pad", pad.pin, least, share))
    return found


def _find_components_over_bosses(layout: BoardLayout) -> list[RuleViolation]:
    """Return components below the board that would press against the base's bosses, with their heights."""
    outline, found = layout.board.outline, []
    bosses = union_all([Point(at).buffer(outline.boss_mm / 2) for at in outline.bosses])
    for part in (part for part in layout.parts if part.side == "bottom"):
        height_mm = part.part.footprint.body_mm[2]
        if height_mm > outline.boss_gap_mm and component_outline(part).intersects(bosses):
            found.append(RuleViolation("height over a boss", part.reference, outline.boss_gap_mm, height_mm))
    return found


def _format_point(at: PointMm) -> str:
    """Return a point as text."""
    return f"({at[0]:.2f}, {at[1]:.2f})"

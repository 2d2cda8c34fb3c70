"""Rules that every board keeps: each net one piece, none touching another, all far enough from edges and holes."""

from dataclasses import dataclass
from itertools import combinations

from shapely import Point, box, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.copper import (
    bare_board,
    hole_polygon,
    pad_polygon,
    polygons,
    track_polygon,
    via_polygon,
)
from ninedtact.hardware.led_board.current import board_light
from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.layout import SIDES, Layout, lay_out
from ninedtact.hardware.led_board.netlist import GROUND
from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.placement import Side
from ninedtact.hardware.led_board.refusal import BoardImpossible

JOINED_MM2 = 0.01
"""Two pieces of copper are one when they share at least this much."""
ROUNDING_MM = 0.002
"""Circles are drawn as polygons."""


@dataclass(frozen=True)
class Piece:
    """Copper that is drawn in one go."""

    name: str
    net: str | None
    sides: tuple[Side, ...]
    shape: BaseGeometry


@dataclass(frozen=True)
class Problem:
    """A rule that a board breaks."""

    rule: str
    where: str
    least_mm: float
    found_mm: float

    def __str__(self) -> str:
        return f"{self.rule} {self.where}: {self.found_mm:.3f} for {self.least_mm:.3f}"


def sound_layout(board: LedBoard) -> Layout:
    """The board laid out; raises `BoardImpossible` where it breaks a rule or its LEDs cannot be lit."""
    board_light(board)
    layout = lay_out(board)
    require_sound(layout)
    return layout


def require_sound(layout: Layout) -> None:
    """Refuse a board that breaks a rule; raises `BoardImpossible`."""
    found = problems(layout)
    if found and not layout.board.faults_known:
        raise BoardImpossible(
            f"expected a circuit board without faults, got {len(found)}, the first {found[0]}; "
            "make the board larger, take fewer LEDs, or loosen its rules"
        )


def problems(layout: Layout) -> tuple[Problem, ...]:
    """All rules that a board breaks; empty for a sound one."""
    copper = pieces(layout)
    return (
        *open_nets(layout, copper),
        *too_near(layout, copper),
        *at_edges(layout, copper),
        *at_holes(layout, copper),
        *between_holes(layout),
        *spoilt_pads(layout),
        *over_bosses(layout),
    )


def pieces(layout: Layout) -> tuple[Piece, ...]:
    """All copper of the board."""
    found = [Piece(pad.pin, pad.net, pad.sides, pad_polygon(pad)) for pad in layout.pads]
    for n, track in enumerate(layout.routes.tracks):
        found.append(Piece(f"track {n} of {track.net}", track.net, (track.side,), track_polygon(track)))
    for n, via in enumerate(layout.routes.vias):
        found.append(Piece(f"via {n} of {via.net}", via.net, SIDES, via_polygon(via)))
    for side in SIDES:
        found += [Piece(f"pour {side} {n}", GROUND, (side,), shape) for n, shape in enumerate(layout.pours[side])]
    return tuple(found)


def open_nets(layout: Layout, copper: tuple[Piece, ...]) -> list[Problem]:
    """Nets that are not one piece; told by how many pieces they are."""
    found = []
    for net in layout.nets:
        groups = joined([piece for piece in copper if piece.net == net.name])
        if len(groups) != 1:
            found.append(Problem("pieces of net", net.name, 1, len(groups)))
    return found


def joined(copper: list[Piece]) -> list[list[Piece]]:
    """Pieces in groups that hang together."""
    groups: list[list[Piece]] = []
    for piece in copper:
        touched = [group for group in groups if any(touch(piece, other) for other in group)]
        groups = [group for group in groups if group not in touched] + [[piece, *(p for g in touched for p in g)]]
    return groups


def touch(a: Piece, b: Piece) -> bool:
    """Whether two pieces are one conductor."""
    return bool(set(a.sides) & set(b.sides)) and a.shape.intersection(b.shape).area >= JOINED_MM2


def too_near(layout: Layout, copper: tuple[Piece, ...]) -> list[Problem]:
    """Copper of different nets that touches or nearly does. An open pin is a net of its own."""
    least, found = layout.board.rules.clearance_mm, []
    for a, b in combinations(copper, 2):
        if (a.net == b.net and (a.net or a.name == b.name)) or not set(a.sides) & set(b.sides):
            continue
        gap = a.shape.distance(b.shape)
        if gap < least - ROUNDING_MM:
            found.append(Problem("clearance", f"{a.name} to {b.name}", least, gap))
    return found


def at_edges(layout: Layout, copper: tuple[Piece, ...]) -> list[Problem]:
    """Copper near or over the milled edge."""
    least, board = layout.board.rules.copper_to_edge_mm, bare_board(layout.board.outline)
    gaps = [(piece, piece.shape.distance(board.boundary) if board.contains(piece.shape) else 0.0) for piece in copper]
    return [Problem("copper to edge", p.name, least, gap) for p, gap in gaps if gap < least - ROUNDING_MM]


def at_holes(layout: Layout, copper: tuple[Piece, ...]) -> list[Problem]:
    """Copper near holes that have none."""
    least, found = layout.board.rules.copper_to_hole_mm, []
    for hole in (hole for hole in layout.holes if not hole.plated):
        bore = hole_polygon(hole)
        gaps = [(piece, piece.shape.distance(bore)) for piece in copper]
        found += [
            Problem("copper to hole", f"{p.name} at {place(hole.start_mm)}", least, gap)
            for p, gap in gaps
            if gap < least - ROUNDING_MM
        ]
    return found


def between_holes(layout: Layout) -> list[Problem]:
    """Holes whose walls would break."""
    least = layout.board.rules.hole_to_hole_mm
    pairs = [(a, b, hole_polygon(a).distance(hole_polygon(b))) for a, b in combinations(layout.holes, 2)]
    return [
        Problem("hole to hole", f"{place(a.start_mm)} to {place(b.start_mm)}", least, gap)
        for a, b, gap in pairs
        if gap < least - ROUNDING_MM
    ]


def spoilt_pads(layout: Layout) -> list[Problem]:
    """Pads that gave up too much, told by the share that is left in one piece."""
    least, found = layout.board.rules.least_pad_share, []
    for pad in (pad for pad in layout.pads if pad.bites):
        left = max((piece.area for piece in polygons(pad_polygon(pad))), default=0.0)
        share = left / (pad.size_mm[0] * pad.size_mm[1])
        if share < least:
            found.append(Problem("share left of pad", pad.pin, least, share))
    return found


def over_bosses(layout: Layout) -> list[Problem]:
    """Parts below the board that the base's bosses would press against; told by their heights."""
    outline, found = layout.board.outline, []
    bosses = union_all([Point(at).buffer(outline.boss_mm / 2) for at in outline.bosses])
    for part in (part for part in layout.parts if part.side == "bottom"):
        footprint = part.part.footprint
        (x, y), (width, depth) = part.onto_board(footprint.body_at_mm), part.size(footprint.body_mm[:2])
        body = box(x - width / 2, y - depth / 2, x + width / 2, y + depth / 2)
        if footprint.body_mm[2] > outline.boss_gap_mm and body.intersects(bosses):
            found.append(Problem("height over a boss", part.reference, outline.boss_gap_mm, footprint.body_mm[2]))
    return found


def place(at: Place) -> str:
    """A place for a sentence."""
    return f"({at[0]:.2f}, {at[1]:.2f})"

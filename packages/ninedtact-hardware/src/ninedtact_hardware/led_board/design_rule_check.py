"""The design-rule check: each net is one piece, none touches another, and all copper is far enough from edges and
holes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from shapely import Point, STRtree, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact_hardware.led_board.board_outline_and_holes import LedBoardImpossible, PointMm
from ninedtact_hardware.led_board.board_parameters import LedBoardDesign, operating_point_of_board
from ninedtact_hardware.led_board.complete_layout import (
    SIDES,
    BoardLayout,
    component_outline,
    hole_polygon,
    lay_out_board,
    milled_board_polygon,
    pad_polygon,
    split_polygons,
    track_polygon,
    via_polygon,
)
from ninedtact_hardware.led_board.components import GROUND, BoardSide

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


def lay_out_checked_board(board: LedBoardDesign) -> BoardLayout:
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
    copper, rules = list_copper_pieces(layout), layout.board.rules
    distances = (
        ("clearance", rules.clearance_mm, _distances_of_nets(copper, rules.clearance_mm)),
        ("copper to edge", rules.copper_to_edge_mm, _distances_to_edge(layout, copper)),
        ("copper to hole", rules.copper_to_hole_mm, _distances_to_holes(layout, copper, rules.copper_to_hole_mm)),
        ("hole to hole", rules.hole_to_hole_mm, _distances_of_holes(layout, rules.hole_to_hole_mm)),
    )
    return (
        *find_open_nets(layout, copper),
        *(
            RuleViolation(rule, where, least_mm, distance_mm)
            for rule, least_mm, found in distances
            for where, distance_mm in found
            if distance_mm < least_mm - ROUNDING_MM
        ),
        *_find_cut_pads(layout),
        *_find_components_over_bosses(layout),
        *_find_components_in_the_way(layout),
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
    if not set(a.sides) & set(b.sides) or not a.shape.intersects(b.shape):
        return False
    return a.shape.intersection(b.shape).area >= MIN_CONTACT_MM2


def _near_pairs(
    first: Sequence[BaseGeometry], second: Sequence[BaseGeometry], within_mm: float
) -> list[tuple[int, int]]:
    """Return the numbers of those shapes that are no farther from each other than this, in ascending order."""
    numbers, others = STRtree(second).query(first, predicate="dwithin", distance=within_mm)
    return sorted(zip(numbers.tolist(), others.tolist(), strict=True))


def _distances_of_nets(copper: tuple[CopperPiece, ...], within_mm: float) -> Iterator[tuple[str, float]]:
    """Yield the distances of near copper of different nets on one side; an open pin is a net of its own."""
    shapes = [piece.shape for piece in copper]
    for number, other in _near_pairs(shapes, shapes, within_mm):
        a, b = copper[number], copper[other]
        is_one_net = a.net == b.net and (a.net or a.name == b.name)
        if number < other and not is_one_net and set(a.sides) & set(b.sides):
            yield f"{a.name} to {b.name}", a.shape.distance(b.shape)


def _distances_to_edge(layout: BoardLayout, copper: tuple[CopperPiece, ...]) -> Iterator[tuple[str, float]]:
    """Yield the distance of all copper from the milled edge; zero over it."""
    board = milled_board_polygon(layout.board.outline)
    edge = board.boundary
    for piece in copper:
        yield piece.name, piece.shape.distance(edge) if board.contains(piece.shape) else 0.0


def _distances_to_holes(
    layout: BoardLayout, copper: tuple[CopperPiece, ...], within_mm: float
) -> Iterator[tuple[str, float]]:
    """Yield the distances of near copper from each unplated hole."""
    holes = [hole for hole in layout.holes if not hole.plated]
    bores, shapes = [hole_polygon(hole) for hole in holes], [piece.shape for piece in copper]
    for number, other in _near_pairs(bores, shapes, within_mm):
        where = f"{copper[other].name} at {_format_point(holes[number].start_mm)}"
        yield where, shapes[other].distance(bores[number])


def _distances_of_holes(layout: BoardLayout, within_mm: float) -> Iterator[tuple[str, float]]:
    """Yield the distances of near holes: where they are too close, the wall between them would break."""
    bores = [hole_polygon(hole) for hole in layout.holes]
    for number, other in _near_pairs(bores, bores, within_mm):
        if number < other:
            a, b = layout.holes[number], layout.holes[other]
            where = f"{_format_point(a.start_mm)} to {_format_point(b.start_mm)}"
            yield where, bores[number].distance(bores[other])


def _find_cut_pads(layout: BoardLayout) -> list[RuleViolation]:
    """Return pads of which too small a share is left in one piece."""
    least, found = layout.board.rules.least_pad_share, []
    for pad in (pad for pad in layout.pads if pad.cutouts):
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


def _find_components_in_the_way(layout: BoardLayout) -> list[RuleViolation]:
    """Return components that overlap another one of their side, or a locating hole, through which a pin of the base stands."""
    outlines = [(part.reference, part.side, component_outline(part)) for part in layout.parts]
    bore = layout.board.outline.locating_hole_mm / 2
    pins = [Point(at).buffer(bore) for at in layout.board.outline.locating_holes]
    found = [(f"{a} and {b}", one, other) for (a, side, one), (b, at, other) in combinations(outlines, 2) if side == at]
    found += [(f"{a} and a locating hole", one, pin) for a, _, one in outlines for pin in pins]
    return [
        RuleViolation("overlap of", where, 0.0, -_overlap_depth_mm(one, other))
        for where, one, other in found
        if one.intersects(other) and one.intersection(other).area > 1e-6
    ]


def _overlap_depth_mm(one: BaseGeometry, other: BaseGeometry) -> float:
    """Return the smaller side of the box in which two shapes overlap."""
    low_x, low_y, high_x, high_y = one.intersection(other).bounds
    return float(min(high_x - low_x, high_y - low_y))


def _format_point(at: PointMm) -> str:
    """Return a point as text."""
    return f"({at[0]:.2f}, {at[1]:.2f})"

"""A flat part as closed outlines: what a laser follows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot

from build123d import Axis, Edge, GeomType, Part, Wire

from ninedtact.errors import NinedtactError
from ninedtact.hardware.plan import Pair

SAME_MM = 1e-4
"""Ends nearer than this are one point."""


class OutlineBroken(NinedtactError):
    """A part that cannot be cut from a sheet."""


@dataclass(frozen=True)
class Circle:
    """A round hole."""

    centre: Pair
    radius_mm: float

    @property
    def first(self) -> Pair:
        """By which outlines are ordered."""
        return rounded(self.centre)


@dataclass(frozen=True)
class Loop:
    """A closed run of lines and arcs."""

    corners: tuple[Pair, ...]
    bulges: tuple[float, ...]
    """Of the side that begins at each corner: tangent of a quarter of its arc, left turns positive; zero for a line."""

    @property
    def first(self) -> Pair:
        """The corner with the lowest x, then y; by which outlines are ordered."""
        return min(map(rounded, self.corners))

    def from_first(self) -> "Loop":
        """The same from its first corner on to the lower neighbour: the modelling library may begin anywhere."""
        at = [*map(rounded, self.corners)].index(self.first)
        corners, bulges = (*self.corners[at:], *self.corners[:at]), (*self.bulges[at:], *self.bulges[:at])
        if rounded(corners[-1]) < rounded(corners[1]):
            corners, bulges = (corners[0], *corners[:0:-1]), tuple(0.0 - bulge for bulge in reversed(bulges))
        return Loop(corners, bulges)


def outlines(part: Part) -> list[Circle | Loop]:
    """Outside first, then every hole, each once; raises `OutlineBroken`."""
    top = part.faces().filter_by(Axis.Z).sort_by(Axis.Z)[-1]
    inside = sorted((outline(wire) for wire in top.inner_wires()), key=lambda found: found.first)
    return [outline(top.outer_wire()), *inside]


def outline(wire: Wire) -> Circle | Loop:
    """One closed wire."""
    edges = list(wire.edges())
    if len(edges) == 1 and edges[0].geom_type == GeomType.CIRCLE:
        centre = edges[0].arc_center
        return Circle((float(centre.X), float(centre.Y)), float(edges[0].radius))
    sides = [*chained([side(edge) for edge in edges])]
    return Loop(tuple(start for start, _, _ in sides), tuple(bulge for _, _, bulge in sides)).from_first()


def rounded(place: Pair) -> Pair:
    """To what is one point."""
    return round(place[0], 4) + 0.0, round(place[1], 4) + 0.0


Side = tuple[Pair, Pair, float]
"""Start, end, bulge."""


def side(edge: Edge) -> Side:
    """A line or an arc; raises `OutlineBroken` for other curves."""
    if edge.geom_type not in (GeomType.LINE, GeomType.CIRCLE):
        raise OutlineBroken(f"expected lines and arcs to cut along, got {edge.geom_type}; cut this part another way")
    start, middle, end = ((float(place.X), float(place.Y)) for place in (edge @ 0, edge @ 0.5, edge @ 1))
    along, across = (end[0] - start[0], end[1] - start[1]), (middle[0] - start[0], middle[1] - start[1])
    left = along[0] * across[1] - along[1] * across[0]
    return start, end, 0.0 - 2 * left / hypot(*along) ** 2


def chained(sides: Sequence[Side]) -> Iterator[Side]:
    """The same in the order in which a pen draws them; raises `OutlineBroken` where it would have to be lifted."""
    left = list(sides[1:])
    last = sides[0]
    yield last
    while left:
        last = next_side(left, last[1])
        yield last
    if not same(last[1], sides[0][0]):
        raise OutlineBroken("expected a closed outline, got one that ends elsewhere; report this part")


def next_side(left: list[Side], at: Pair) -> Side:
    """Take out the side that begins or ends here; turned round if it ends."""
    for number, (start, end, bulge) in enumerate(left):
        if same(start, at) or same(end, at):
            del left[number]
            return (start, end, bulge) if same(start, at) else (end, start, -bulge)
    raise OutlineBroken(f"expected an outline that goes on at {at}, got a gap; report this part")


def same(first: Pair, second: Pair) -> bool:
    """Whether two points are one."""
    return hypot(first[0] - second[0], first[1] - second[1]) < SAME_MM

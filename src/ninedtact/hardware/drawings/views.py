"""A part as polylines: from a side, hidden edges apart, or cut open."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from build123d import Edge, GeomType, Keep, Part, Plane, Wire, section, split
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.hardware.plan import Pair

Line = Float[Array, "_ 2"]
FAR_MM = 500.0
SIDES = {
    "top": ((0.0, 0.0, FAR_MM), (0.0, 1.0, 0.0)),
    "front": ((0.0, -FAR_MM, 0.0), (0.0, 0.0, 1.0)),
    "right": ((FAR_MM, 0.0, 0.0), (0.0, 0.0, 1.0)),
}
"""Where the eye stands, and what is up."""
DECIMALS = 6
"""Of the points' mm."""
POINTS_PER_MM, FEWEST, MOST = 8, 9, 97
"""Of a curve."""


@dataclass(frozen=True)
class View:
    """One view, mm."""

    visible: tuple[Line, ...]
    hidden: tuple[Line, ...]
    cut: tuple[tuple[Line, ...], ...] = ()
    """Faces that a cut lays bare, each as its outline and its holes."""

    @cached_property
    def box(self) -> tuple[Pair, Pair]:
        """Lowest and highest x and y."""
        points = np.concatenate(self.visible)
        low, high = points.min(axis=0), points.max(axis=0)
        return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def view(part: Part, side: str) -> View:
    """From the top, the front or the right."""
    eye, up = SIDES[side]
    visible, hidden = part.project_to_viewport(eye, up, (0.0, 0.0, 0.0))
    return View(lines(visible), lines(hidden))


def lines(edges: Iterable[Edge]) -> tuple[Line, ...]:
    """Projected edges as points, sorted: they come in another order in another process."""
    return tuple(sorted(map(line, edges), key=order))


def cut_open(part: Part) -> View:
    """The half at −x, seen from the right: what the plane x = 0 lays bare, and the edges behind it."""
    behind = split(part, bisect_by=Plane.YZ, keep=Keep.BOTTOM)
    # They come in another order in every process.
    faces = sorted(section(part, section_by=Plane.YZ).faces(), key=lambda face: (face.center().Y, face.center().Z))
    bare = tuple(tuple(outline(wire) for wire in (face.outer_wire(), *face.inner_wires())) for face in faces)
    return View(view(Part() + behind, "right").visible, (), bare)


def outline(wire: Wire) -> Line:
    """A closed run of edges in the plane x = 0, as points (y, z)."""
    return np.array([(y, z) for edge in wire.order_edges() for _, y, z in places(edge)])


def line(edge: Edge) -> Line:
    """A projected edge as points, from its lower end: the modelling library may draw it from either."""
    points = np.array([(x, y) for x, y, _ in places(edge)]).round(DECIMALS) + 0.0
    return points if order(points) <= order(points[::-1]) else points[::-1]


def order(points: Line) -> list[list[float]]:
    """By which lines are sorted, and turned round."""
    return points.tolist()


def places(edge: Edge) -> Iterator[tuple[float, float, float]]:
    """Points along it: its ends, or many of a curve."""
    many = 2 if edge.geom_type == GeomType.LINE else min(max(round(POINTS_PER_MM * edge.length), FEWEST), MOST)
    # Asked of the curve itself: `edge @ part` measures the edge's length anew for every point.
    curve = edge.geom_adaptor()
    start, end = curve.FirstParameter(), curve.LastParameter()
    for parameter in np.linspace(*((start, end) if edge.is_forward else (end, start)), many):
        place = curve.Value(float(parameter))
        yield place.X(), place.Y(), place.Z()

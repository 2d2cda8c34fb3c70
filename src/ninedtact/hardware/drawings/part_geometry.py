"""What a drawing tells of a part in numbers: round holes and pins, rounded corners, heights of faces.

A part as polylines: from a side, hidden edges apart, or cut open.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from build123d import Axis, Edge, Face, GeomType, Keep, Part, Plane, Wire, section, split
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.hardware.assembly_dimensions import XY


@dataclass(frozen=True)
class RoundFeatures:
    """Holes or pins of one diameter."""

    diameter_mm: float
    positions: tuple[XY, ...]

    @property
    def grid(self) -> tuple[int, int, float] | None:
        """Columns, rows and pitch, where the places are a whole square lattice of more than eight."""
        xs, ys = (sorted({place[axis] for place in self.positions}) for axis in (0, 1))
        if len(self.positions) <= 8 or len(xs) * len(ys) != len(self.positions):
            return None
        return len(xs), len(ys), round((xs[-1] - xs[0]) / (len(xs) - 1), 3)


def find_round_features(part: Part) -> Iterator[RoundFeatures]:
    """Whole cylinders along z by diameter, largest first; each axis once."""
    found: dict[float, set[XY]] = {}
    for face in part.faces().filter_by(GeomType.CYLINDER):
        axis, radius = face.axis_of_rotation, face.radius
        if axis is not None and radius is not None and _is_full_cylinder(face, axis):
            place = round(float(axis.position.X), 3) + 0.0, round(float(axis.position.Y), 3) + 0.0
            found.setdefault(round(2 * float(radius), 3), set()).add(place)
    for diameter in sorted(found, reverse=True):
        yield RoundFeatures(diameter, tuple(sorted(found[diameter])))


@dataclass(frozen=True)
class CornerRadius:
    """Vertical corners of one radius, and the place on one of them that lies farthest to +x and +y."""

    radius_mm: float
    place: XY


def find_corner_radii(part: Part) -> Iterator[CornerRadius]:
    """Of a part whose vertical corners are parts of cylinders, largest first."""
    found: dict[float, set[XY]] = {}
    for face in part.faces().filter_by(GeomType.CYLINDER):
        axis, radius = face.axis_of_rotation, face.radius
        if axis is not None and radius is not None and _is_vertical(axis) and not _is_full_cylinder(face, axis):
            middle = face.position_at(0.5, 0.5)
            found.setdefault(round(float(radius), 3), set()).add((round(float(middle.X), 3), round(float(middle.Y), 3)))
    for radius in sorted(found, reverse=True):
        yield CornerRadius(radius, max(found[radius], key=lambda place: (round(sum(place), 2), place)))


def _is_vertical(axis: Axis) -> bool:
    """Whether it is parallel to z."""
    return abs(abs(axis.direction.Z) - 1) < 1e-6


def _is_full_cylinder(face: Face, axis: Axis) -> bool:
    """Whether a cylinder goes all the way round a vertical axis."""
    return _is_vertical(axis) and any(edge.is_closed for edge in face.edges())


def find_face_positions(part: Part, axis: Axis) -> list[float]:
    """Where the flat faces across this axis lie, ascending."""
    flat = part.faces().filter_by(GeomType.PLANE).filter_by(axis)
    along = axis.direction
    return sorted({round(float(face.center().dot(along)), 2) + 0.0 for face in flat})


def find_feature_heights(part: Part) -> list[float]:
    """Levels along z, and the tops of round tips."""
    tips = {round(float(face.bounding_box().max.Z), 2) for face in part.faces().filter_by(GeomType.SPHERE)}
    return sorted({*find_face_positions(part, Axis.Z), *tips})


Polyline = Float[Array, "_ 2"]
FAR_MM = 500.0
VIEW_DIRECTIONS = {
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
class ProjectedView:
    """One view, mm."""

    visible: tuple[Polyline, ...]
    hidden: tuple[Polyline, ...]
    cut: tuple[tuple[Polyline, ...], ...] = ()
    """Faces that a cut lays bare, each as its outline and its holes."""

    @cached_property
    def box(self) -> tuple[XY, XY]:
        """Lowest and highest x and y."""
        points = np.concatenate(self.visible)
        low, high = points.min(axis=0), points.max(axis=0)
        return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def project_view(part: Part, side: str) -> ProjectedView:
    """From the top, the front or the right."""
    eye, up = VIEW_DIRECTIONS[side]
    visible, hidden = part.project_to_viewport(eye, up, (0.0, 0.0, 0.0))
    return ProjectedView(_edges_to_polylines(visible), _edges_to_polylines(hidden))


def _edges_to_polylines(edges: Iterable[Edge]) -> tuple[Polyline, ...]:
    """Projected edges as points, sorted: they come in another order in another process."""
    return tuple(sorted(map(_edge_to_polyline, edges), key=_sort_key))


def project_section(part: Part) -> ProjectedView:
    """The half at −x, seen from the right: what the plane x = 0 lays bare, and the edges behind it."""
    behind = split(part, bisect_by=Plane.YZ, keep=Keep.BOTTOM)
    # They come in another order in every process.
    faces = sorted(section(part, section_by=Plane.YZ).faces(), key=lambda face: (face.center().Y, face.center().Z))
    bare = tuple(tuple(_wire_to_polyline(wire) for wire in (face.outer_wire(), *face.inner_wires())) for face in faces)
    return ProjectedView(project_view(Part() + behind, "right").visible, (), bare)


def _wire_to_polyline(wire: Wire) -> Polyline:
    """A closed run of edges in the plane x = 0, as points (y, z)."""
    return np.array([(y, z) for edge in wire.order_edges() for _, y, z in _sample_edge(edge)])


def _edge_to_polyline(edge: Edge) -> Polyline:
    """A projected edge as points, from its lower end: the modelling library may draw it from either."""
    points = np.array([(x, y) for x, y, _ in _sample_edge(edge)]).round(DECIMALS) + 0.0
    return points if _sort_key(points) <= _sort_key(points[::-1]) else points[::-1]


def _sort_key(points: Polyline) -> list[list[float]]:
    """By which lines are sorted, and turned round."""
    return points.tolist()


def _sample_edge(edge: Edge) -> Iterator[tuple[float, float, float]]:
    """Points along it: its ends, or many of a curve."""
    many = 2 if edge.geom_type == GeomType.LINE else min(max(round(POINTS_PER_MM * edge.length), FEWEST), MOST)
    # Asked of the curve itself: `edge @ part` measures the edge's length anew for every point.
    curve = edge.geom_adaptor()
    start, end = curve.FirstParameter(), curve.LastParameter()
    for parameter in np.linspace(*((start, end) if edge.is_forward else (end, start)), many):
        place = curve.Value(float(parameter))
        yield place.X(), place.Y(), place.Z()

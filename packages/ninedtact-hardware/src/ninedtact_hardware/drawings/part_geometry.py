"""Geometry of a part for drawings: projected and cut views as polylines, round features, corner radii and positions of
faces. Lengths in mm."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from build123d import Axis, Edge, Face, GeomType, Keep, Part, Plane, Wire, section, split
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact_hardware.assembly_dimensions import XY


@dataclass(frozen=True)
class RoundFeatures:
    """Holes or pins of one diameter."""

    diameter_mm: float
    positions: tuple[XY, ...]

    @property
    def grid(self) -> tuple[int, int, float] | None:
        """Columns, rows and pitch, if the positions are a complete square grid of more than eight; otherwise none."""
        xs, ys = (sorted({place[axis] for place in self.positions}) for axis in (0, 1))
        if len(self.positions) <= 8 or len(xs) * len(ys) != len(self.positions):
            return None
        return len(xs), len(ys), round((xs[-1] - xs[0]) / (len(xs) - 1), 3)


def find_round_features(part: Part) -> Iterator[RoundFeatures]:
    """Yield the full cylinders along z by diameter, largest first, each axis once."""
    found: dict[float, set[XY]] = {}
    for _, axis, radius in _cylinders_along_z(part, full=True):
        place = round(float(axis.position.X), 3) + 0.0, round(float(axis.position.Y), 3) + 0.0
        found.setdefault(round(2 * radius, 3), set()).add(place)
    for diameter in sorted(found, reverse=True):
        yield RoundFeatures(diameter, tuple(sorted(found[diameter])))


@dataclass(frozen=True)
class CornerRadius:
    """Vertical corners of one radius, and the point on one of them that lies farthest to +x and +y."""

    radius_mm: float
    place: XY


def find_corner_radii(part: Part) -> Iterator[CornerRadius]:
    """Yield the radii of vertical corners that are parts of cylinders, largest first."""
    found: dict[float, set[XY]] = {}
    for face, _, radius in _cylinders_along_z(part, full=False):
        middle = face.position_at(0.5, 0.5)
        found.setdefault(round(radius, 3), set()).add((round(float(middle.X), 3), round(float(middle.Y), 3)))
    for radius in sorted(found, reverse=True):
        yield CornerRadius(radius, max(found[radius], key=lambda place: (round(sum(place), 2), place)))


def _cylinders_along_z(part: Part, full: bool) -> Iterator[tuple[Face, Axis, float]]:
    """Yield face, axis and radius of the cylinders along z that go all the way around, or else of those that do not."""
    for face in part.faces().filter_by(GeomType.CYLINDER):
        axis, radius = face.axis_of_rotation, face.radius
        if axis is None or radius is None or abs(abs(axis.direction.Z) - 1) >= 1e-6:
            continue
        if any(edge.is_closed for edge in face.edges()) == full:
            yield face, axis, float(radius)


def find_face_positions(part: Part, axis: Axis) -> list[float]:
    """Return the positions of the flat faces across an axis, ascending."""
    flat = part.faces().filter_by(GeomType.PLANE).filter_by(axis)
    along = axis.direction
    return sorted({round(float(face.center().dot(along)), 2) + 0.0 for face in flat})


def find_feature_heights(part: Part) -> list[float]:
    """Return the heights of the flat faces across z and of the tops of round tips, ascending."""
    tips = {round(float(face.bounding_box().max.Z), 2) for face in part.faces().filter_by(GeomType.SPHERE)}
    return sorted({*find_face_positions(part, Axis.Z), *tips})


Polyline = Float[Array, "_ 2"]
FAR_MM = 500.0
VIEW_DIRECTIONS = {
    "top": ((0.0, 0.0, FAR_MM), (0.0, 1.0, 0.0)),
    "front": ((0.0, -FAR_MM, 0.0), (0.0, 0.0, 1.0)),
    "right": ((FAR_MM, 0.0, 0.0), (0.0, 0.0, 1.0)),
}
"""Position of the viewer, and the direction that is up in the view."""
DECIMALS = 6
"""Decimals of the points, in mm."""
POINTS_PER_MM, FEWEST, MOST = 8, 9, 97
"""Sampling of curves: points per mm, least and greatest number of points."""


@dataclass(frozen=True)
class ProjectedView:
    """One view of a part as polylines in mm."""

    visible: tuple[Polyline, ...]
    hidden: tuple[Polyline, ...]
    cut: tuple[tuple[Polyline, ...], ...] = ()
    """Faces in the cutting plane, each as its outline and its holes."""

    @cached_property
    def box(self) -> tuple[XY, XY]:
        """Lowest and highest point of the view's box."""
        points = np.concatenate(self.visible)
        low, high = points.min(axis=0), points.max(axis=0)
        return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def project_view(part: Part, side: str) -> ProjectedView:
    """Project a part as seen from the top, the front or the right, hidden edges apart."""
    eye, up = VIEW_DIRECTIONS[side]
    visible, hidden = part.project_to_viewport(eye, up, (0.0, 0.0, 0.0))
    return ProjectedView(_edges_to_polylines(visible), _edges_to_polylines(hidden))


def _edges_to_polylines(edges: Iterable[Edge]) -> tuple[Polyline, ...]:
    """Return projected edges as sorted polylines: the modelling library lists them in another order in every process."""
    return tuple(sorted(map(_edge_to_polyline, edges), key=lambda points: points.tolist()))


def project_section(part: Part) -> ProjectedView:
    """Project the half at −x as seen from the right: faces in the plane x = 0 and the edges behind it."""
    behind = split(part, bisect_by=Plane.YZ, keep=Keep.BOTTOM)
    # Their order differs between processes.
    faces = sorted(section(part, section_by=Plane.YZ).faces(), key=lambda face: (face.center().Y, face.center().Z))
    bare = tuple(tuple(_wire_to_polyline(wire) for wire in (face.outer_wire(), *face.inner_wires())) for face in faces)
    return ProjectedView(project_view(Part() + behind, "right").visible, (), bare)


def _wire_to_polyline(wire: Wire) -> Polyline:
    """Return a closed run of edges in the plane x = 0 as points (y, z)."""
    return np.array([(y, z) for edge in wire.order_edges() for _, y, z in _sample_edge(edge)])


def _edge_to_polyline(edge: Edge) -> Polyline:
    """Return a projected edge as points from its lower end: the modelling library may draw it from either."""
    points = np.array([(x, y) for x, y, _ in _sample_edge(edge)]).round(DECIMALS) + 0.0
    places = points.tolist()
    return points if places <= places[::-1] else points[::-1]


def _sample_edge(edge: Edge) -> Iterator[tuple[float, float, float]]:
    """Yield points along an edge: its ends, or many of a curve."""
    many = 2 if edge.geom_type == GeomType.LINE else min(max(round(POINTS_PER_MM * edge.length), FEWEST), MOST)
    # The curve is evaluated directly, because `edge @ part` measures the edge's length anew for every point.
    curve = edge.geom_adaptor()
    start, end = curve.FirstParameter(), curve.LastParameter()
    for parameter in np.linspace(*((start, end) if edge.is_forward else (end, start)), many):
        place = curve.Value(float(parameter))
        yield place.X(), place.Y(), place.Z()

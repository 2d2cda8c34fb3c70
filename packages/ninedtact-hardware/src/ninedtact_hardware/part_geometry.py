"""Geometry of a part for its drawing: projected and cut views as polylines, round features, positions of faces. Lengths in mm."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from build123d import Axis, Edge, GeomType, Keep, Part, Plane, section, split
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact_hardware.design import XY


@dataclass(frozen=True)
class RoundFeatures:
    """Holes or pins along z of one radius, or vertical corners of one radius, with their positions."""

    radius_mm: float
    positions: tuple[XY, ...]
    is_corner: bool

    @property
    def grid(self) -> tuple[int, int, float] | None:
        """Columns, rows and pitch, if the positions are a complete square grid of more than eight; otherwise none."""
        xs, ys = (sorted({place[axis] for place in self.positions}) for axis in (0, 1))
        if len(self.positions) <= 8 or len(xs) * len(ys) != len(self.positions):
            return None
        return len(xs), len(ys), round((xs[-1] - xs[0]) / (len(xs) - 1), 3)

    @property
    def label(self) -> str:
        """Number and diameter of holes, the pitch of a grid; the radius of corners."""
        if self.is_corner:
            return f"R{self.radius_mm:.2f}"
        pitch = f", pitch {self.grid[2]:.2f}" if self.grid else ""
        return f"{len(self.positions)} x ⌀{2 * self.radius_mm:.2f}{pitch}"


def find_round_features(part: Part, corners: bool = False) -> list[RoundFeatures]:
    """Return the cylinders along z that go all the way around, or else the rounded vertical corners, the largest first."""
    found: dict[float, set[XY]] = {}
    for face in part.faces().filter_by(GeomType.CYLINDER):
        axis, radius = face.axis_of_rotation, face.radius
        if axis is None or radius is None or abs(abs(axis.direction.Z) - 1) >= 1e-6:
            continue
        if any(edge.is_closed for edge in face.edges()) != corners:
            place = face.position_at(0.5, 0.5) if corners else axis.position
            rounded = round(float(place.X), 3) + 0.0, round(float(place.Y), 3) + 0.0
            found.setdefault(round(float(radius), 4), set()).add(rounded)
    return [RoundFeatures(radius, tuple(sorted(found[radius])), corners) for radius in sorted(found, reverse=True)]


def find_face_positions(part: Part, axis: Axis) -> list[float]:
    """Return the positions of the flat faces across an axis and, along z, of the tops of round tips, ascending."""
    flat = part.faces().filter_by(GeomType.PLANE).filter_by(axis)
    found = {round(float(face.center().dot(axis.direction)), 2) + 0.0 for face in flat}
    if axis == Axis.Z:
        found |= {round(float(face.bounding_box().max.Z), 2) for face in part.faces().filter_by(GeomType.SPHERE)}
    return sorted(found)


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
    hidden: tuple[Polyline, ...] = ()
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
    visible, hidden = part.project_to_viewport(*VIEW_DIRECTIONS[side], (0.0, 0.0, 0.0))
    return ProjectedView(_edges_to_polylines(visible), _edges_to_polylines(hidden))


def project_section(part: Part) -> ProjectedView:
    """Project the half at −x as seen from the right: faces in the plane x = 0 and the edges behind it."""
    behind = split(part, bisect_by=Plane.YZ, keep=Keep.BOTTOM)
    # Their order differs between processes.
    faces = sorted(section(part, section_by=Plane.YZ).faces(), key=lambda face: (face.center().Y, face.center().Z))
    bare = tuple(
        tuple(
            np.array([place[1:] for edge in wire.order_edges() for place in _sample_edge(edge)])
            for wire in (face.outer_wire(), *face.inner_wires())
        )
        for face in faces
    )
    return ProjectedView(project_view(Part() + behind, "right").visible, cut=bare)


def _edges_to_polylines(edges: Iterable[Edge]) -> tuple[Polyline, ...]:
    """Return projected edges as polylines in one order and direction: the modelling library's differ between processes."""
    lines = [(np.array([place[:2] for place in _sample_edge(edge)]).round(DECIMALS) + 0.0).tolist() for edge in edges]
    return tuple(np.array(points) for points in sorted(min(points, points[::-1]) for points in lines))


def _sample_edge(edge: Edge) -> Iterator[tuple[float, float, float]]:
    many = 2 if edge.geom_type == GeomType.LINE else min(max(round(POINTS_PER_MM * edge.length), FEWEST), MOST)
    # The curve is evaluated directly, because `edge @ part` measures the edge's length anew for every point.
    curve = edge.geom_adaptor()
    ends = curve.FirstParameter(), curve.LastParameter()
    for parameter in np.linspace(*(ends if edge.is_forward else ends[::-1]), many):
        place = curve.Value(float(parameter))
        yield place.X(), place.Y(), place.Z()

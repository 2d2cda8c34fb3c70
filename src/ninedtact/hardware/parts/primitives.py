"""Primitive bodies from which the parts are composed: plates, cylinders, cones and extruded polygons. Lengths in mm."""

from collections.abc import Iterable
from math import hypot

from build123d import (
    Circle,
    Face,
    Location,
    Part,
    Plane,
    Polygon,
    Pos,
    Rectangle,
    RectangleRounded,
    Sketch,
    Solid,
    Vertex,
    extrude,
    fillet,
)

from ninedtact.hardware.assembly_dimensions import XY

ZRange = tuple[float, float]
COINCIDENT_MM = 1e-4
"""Points nearer than this coincide."""


def make_plate(size: XY, heights: ZRange, radius_mm: float = 0.0, at: XY = (0.0, 0.0)) -> Part:
    """Return a plate with vertical corners of this radius."""
    outline = RectangleRounded(*size, radius_mm) if radius_mm > COINCIDENT_MM else Rectangle(*size)
    return extrude_along_z(outline, heights, at)


def make_cylinder(diameter_mm: float, heights: ZRange, at: XY = (0.0, 0.0)) -> Part:
    """Return a cylinder along z, centred at a point."""
    return extrude_along_z(Circle(diameter_mm / 2), heights, at)


def extrude_along_z(outline: Sketch | Face, heights: ZRange, at: XY = (0.0, 0.0)) -> Part:
    """Extrude an outline in x and y along z."""
    return Part() + extrude(Pos(*at, heights[0]) * outline, amount=heights[1] - heights[0])


def make_cylinders_at(diameter_mm: float, heights: ZRange, places: Iterable[XY]) -> list[Part]:
    """Return equal cylinders along z, one at each position."""
    return [make_cylinder(diameter_mm, heights, place) for place in places]


def extrude_along_x(outline_yz: list[XY], half_width_mm: float, rounds: dict[XY, float] | None = None) -> Part:
    """Extrude a polygon in (y, z) to both sides along x; `rounds` are the fillet radii of its corners, by position."""
    face = _filleted_polygon(outline_yz, rounds or {})
    return Part() + extrude(Plane.YZ.location * face, amount=half_width_mm, both=True)


def extrude_along_y(outline_xz: list[XY], y_mm: XY, rounds: dict[XY, float] | None = None) -> Part:
    """Extrude a polygon in (x, z) from one y to the other; `rounds` are the fillet radii of its corners, by position."""
    face = _filleted_polygon(outline_xz, rounds or {})
    start, end = y_mm
    plane = Plane(origin=(0, start, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0))
    return Part() + extrude(plane.location * face, amount=start - end)


def _filleted_polygon(corners: list[XY], rounds: dict[XY, float]) -> Face:
    """Return a polygon with fillets at the corners that are given by their position."""
    outline = Polygon(*corners, align=None)
    for place, radius in rounds.items():
        if radius > COINCIDENT_MM:
            outline = fillet(nearest_vertex(outline.vertices(), place), radius)
    return Face(outline.face().wrapped)


def nearest_vertex(vertices: Iterable[Vertex], place: XY) -> Vertex:
    """Return the vertex that is nearest to a position."""
    return min(vertices, key=lambda vertex: hypot(vertex.X - place[0], vertex.Y - place[1]))


def make_cone(below_mm: float, above_mm: float, heights: ZRange) -> Part:
    """Return a truncated cone along z, given by its lower and upper diameter."""
    made = Solid.make_cone(below_mm / 2, above_mm / 2, heights[1] - heights[0])
    return Part() + made.moved(Location((0, 0, heights[0])))


def require_single_solid(part: Part) -> Part:
    """Return the single solid of a part; more or fewer are an error of the model, not of the design."""
    (solid,) = part.solids()
    return Part() + solid

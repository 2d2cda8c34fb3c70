"""The few bodies that parts are put together from, each between two heights."""

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
"""Places nearer than this are one."""


def make_plate(size: XY, heights: ZRange, radius_mm: float = 0.0, at: XY = (0.0, 0.0)) -> Part:
    """A plate with vertical corners of this radius."""
    outline = RectangleRounded(*size, radius_mm) if radius_mm > COINCIDENT_MM else Rectangle(*size)
    return extrude_along_z(outline, heights, at)


def make_cylinder(diameter_mm: float, heights: ZRange, at: XY = (0.0, 0.0)) -> Part:
    """A cylinder along z."""
    return extrude_along_z(Circle(diameter_mm / 2), heights, at)


def extrude_along_z(outline: Sketch | Face, heights: ZRange, at: XY = (0.0, 0.0)) -> Part:
    """An outline in x and y, drawn out along z."""
    return Part() + extrude(Pos(*at, heights[0]) * outline, amount=heights[1] - heights[0])


def make_cylinders(diameter_mm: float, heights: ZRange, places: Iterable[XY]) -> list[Part]:
    """The same cylinder at several places."""
    return [make_cylinder(diameter_mm, heights, place) for place in places]


def extrude_along_x(outline_yz: list[XY], half_width_mm: float, rounds: dict[XY, float] | None = None) -> Part:
    """A polygon in (y, z), drawn out to both sides along x; `rounds` are fillets at its corners, by place."""
    face = _filleted_polygon(outline_yz, rounds or {})
    return Part() + extrude(Plane.YZ.location * face, amount=half_width_mm, both=True)


def extrude_along_y(outline_xz: list[XY], y_mm: XY, rounds: dict[XY, float] | None = None) -> Part:
    """A polygon in (x, z), drawn out from the one y to the other."""
    face = _filleted_polygon(outline_xz, rounds or {})
    start, end = y_mm
    plane = Plane(origin=(0, start, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0))
    return Part() + extrude(plane.location * face, amount=start - end)


def _filleted_polygon(corners: list[XY], rounds: dict[XY, float]) -> Face:
    """A polygon with fillets at the corners that are named by their place."""
    outline = Polygon(*corners, align=None)
    for place, radius in rounds.items():
        if radius > COINCIDENT_MM:
            outline = fillet(nearest_vertex(outline.vertices(), place), radius)
    return Face(outline.face().wrapped)


def nearest_vertex(vertices: Iterable[Vertex], place: XY) -> Vertex:
    """The vertex there."""
    return min(vertices, key=lambda vertex: hypot(vertex.X - place[0], vertex.Y - place[1]))


def make_cone(below_mm: float, above_mm: float, heights: ZRange) -> Part:
    """A truncated cone along z, by its diameters."""
    made = Solid.make_cone(below_mm / 2, above_mm / 2, heights[1] - heights[0])
    return Part() + made.moved(Location((0, 0, heights[0])))


def require_single_solid(part: Part) -> Part:
    """The part as its single solid; more or fewer are an error of the model, not of the design."""
    (solid,) = part.solids()
    return Part() + solid

"""Three views of a part as polylines, hidden edges apart, and the round holes and heights that a drawing tells."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from build123d import Axis, Edge, Face, GeomType, Part
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
POINTS = 25
"""Of a curve."""


@dataclass(frozen=True)
class View:
    """One view, mm."""

    visible: tuple[Line, ...]
    hidden: tuple[Line, ...]

    @property
    def box(self) -> tuple[Pair, Pair]:
        """Lowest and highest x and y."""
        places = np.concatenate(self.visible)
        low, high = places.min(axis=0), places.max(axis=0)
        return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def view(part: Part, side: str) -> View:
    """From the top, the front or the right."""
    eye, up = SIDES[side]
    visible, hidden = part.project_to_viewport(eye, up, (0.0, 0.0, 0.0))
    return View(tuple(map(line, visible)), tuple(map(line, hidden)))


def line(edge: Edge) -> Line:
    """An edge as points."""
    many = 2 if edge.geom_type == GeomType.LINE else POINTS
    places = (edge @ part for part in np.linspace(0, 1, many))
    return np.array([(place.X, place.Y) for place in places])


@dataclass(frozen=True)
class Rounds:
    """Holes or pins of one diameter."""

    diameter_mm: float
    places: tuple[Pair, ...]


def rounds(part: Part) -> Iterator[Rounds]:
    """Whole cylinders along z by diameter, largest first; each axis once."""
    found: dict[float, set[Pair]] = {}
    for face in part.faces().filter_by(GeomType.CYLINDER):
        axis, radius = face.axis_of_rotation, face.radius
        if axis is not None and radius is not None and whole(face, axis):
            place = round(float(axis.position.X), 3) + 0.0, round(float(axis.position.Y), 3) + 0.0
            found.setdefault(round(2 * float(radius), 3), set()).add(place)
    for diameter in sorted(found, reverse=True):
        yield Rounds(diameter, tuple(sorted(found[diameter])))


def whole(face: Face, axis: Axis) -> bool:
    """Whether a cylinder goes all the way round a vertical axis."""
    return abs(abs(axis.direction.Z) - 1) < 1e-6 and any(edge.is_closed for edge in face.edges())


def levels(part: Part, axis: Axis) -> list[float]:
    """Where the flat faces across this axis lie, ascending."""
    flat = part.faces().filter_by(GeomType.PLANE).filter_by(axis)
    along = axis.direction
    return sorted({round(float(face.center().dot(along)), 2) + 0.0 for face in flat})

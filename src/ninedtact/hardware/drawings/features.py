"""What a drawing tells of a part in numbers: round holes and pins, rounded corners, heights of faces."""

from collections.abc import Iterator
from dataclasses import dataclass

from build123d import Axis, Face, GeomType, Part

from ninedtact.hardware.plan import Pair


@dataclass(frozen=True)
class Rounds:
    """Holes or pins of one diameter."""

    diameter_mm: float
    places: tuple[Pair, ...]

    @property
    def lattice(self) -> tuple[int, int, float] | None:
        """Columns, rows and pitch, where the places are a whole square lattice of more than eight."""
        xs, ys = (sorted({place[axis] for place in self.places}) for axis in (0, 1))
        if len(self.places) <= 8 or len(xs) * len(ys) != len(self.places):
            return None
        return len(xs), len(ys), round((xs[-1] - xs[0]) / (len(xs) - 1), 3)


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


@dataclass(frozen=True)
class Rounding:
    """Vertical corners of one radius, and the place on one of them that lies farthest to +x and +y."""

    radius_mm: float
    place: Pair


def roundings(part: Part) -> Iterator[Rounding]:
    """Of a part whose vertical corners are parts of cylinders, largest first."""
    found: dict[float, set[Pair]] = {}
    for face in part.faces().filter_by(GeomType.CYLINDER):
        axis, radius = face.axis_of_rotation, face.radius
        if axis is not None and radius is not None and upright(axis) and not whole(face, axis):
            middle = face.position_at(0.5, 0.5)
            found.setdefault(round(float(radius), 3), set()).add((round(float(middle.X), 3), round(float(middle.Y), 3)))
    for radius in sorted(found, reverse=True):
        yield Rounding(radius, max(found[radius], key=lambda place: (round(sum(place), 2), place)))


def upright(axis: Axis) -> bool:
    """Whether it is parallel to z."""
    return abs(abs(axis.direction.Z) - 1) < 1e-6


def whole(face: Face, axis: Axis) -> bool:
    """Whether a cylinder goes all the way round a vertical axis."""
    return upright(axis) and any(edge.is_closed for edge in face.edges())


def levels(part: Part, axis: Axis) -> list[float]:
    """Where the flat faces across this axis lie, ascending."""
    flat = part.faces().filter_by(GeomType.PLANE).filter_by(axis)
    along = axis.direction
    return sorted({round(float(face.center().dot(along)), 2) + 0.0 for face in flat})


def heights(part: Part) -> list[float]:
    """Levels along z, and the tops of round tips."""
    tips = {round(float(face.bounding_box().max.Z), 2) for face in part.faces().filter_by(GeomType.SPHERE)}
    return sorted({*levels(part, Axis.Z), *tips})

"""STEP and STL."""

from collections.abc import Sequence
from datetime import UTC, datetime
from io import BytesIO

from build123d import Compound, Part, Solid, export_step

from ninedtact.hardware.assembly.bodies import Body
from ninedtact.hardware.parts.stl import stl

SAME_DAY = datetime(2023, 8, 28, tzinfo=UTC)
"""Written as the files' date: the same design gives the same bytes."""
FLAT_MM, TURN_RAD = 0.01, 0.3
"""How far the triangles of an STL may stand off, and turn: a tenth of what a printer resolves."""


def step(name: str, solid: Part) -> bytes:
    """Exact, in mm."""
    return step_of(labelled(name, solid))


def assembly_step(bodies: Sequence[Body]) -> bytes:
    """All bodies at their places, each by its name."""
    return step_of(Compound(label="sensor", children=[labelled(body.name, body.solid) for body in bodies]))


def labelled(name: str, solid: Part) -> Solid:
    """The solid alone, under this name."""
    (alone,) = solid.solids()
    named = Solid(alone.wrapped)
    named.label = name
    return named


def step_of(shape: Compound | Solid) -> bytes:
    """As the file has it."""
    buffer = BytesIO()
    export_step(shape, buffer, timestamp=SAME_DAY)
    return buffer.getvalue()


def printable(solid: Part) -> bytes:
    """Triangles in mm, binary STL."""
    return stl(solid, FLAT_MM, TURN_RAD)

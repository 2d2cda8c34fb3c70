"""A solid as triangles, in the binary form that printers take: watertight, every edge shared by exactly two triangles.

Solids as triangles.

STEP and STL.
"""

from collections.abc import Sequence
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from build123d import Compound, Part, Solid, export_step
from jaxtyping import Float, Shaped
from numpy import ndarray as Array

from ninedtact.hardware.sensor_assembly import AssemblyBody

STL_HEADER_BYTES = 84
"""A title of 80, then the number of triangles."""
STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
"""Of a binary STL file, once for each triangle after the header."""
CORNER_DECIMALS = 5
"""Corners are rounded to 10⁻⁵ mm: faces that meet agree on their corners only to about 10⁻¹⁵."""


def _solid_to_stl(solid: Part, flat_mm: float, turn_rad: float) -> bytes:
    """Triangles in mm, which stand off curved faces and turn from one to the next by no more than this."""
    return _merge_coincident_corners(_mesh_as_stl(solid, flat_mm, turn_rad))


def _mesh_as_stl(solid: Part, flat_mm: float, turn_rad: float) -> bytes:
    """As the modelling library writes it; not by its own `export_stl`, which takes flat_mm for a share of each edge's length."""
    from OCP.BRepMesh import BRepMesh_IncrementalMesh  # type: ignore[import-untyped]
    from OCP.StlAPI import StlAPI_Writer  # type: ignore[import-untyped]

    BRepMesh_IncrementalMesh(solid.wrapped, flat_mm, False, turn_rad, False).Perform()
    writer = StlAPI_Writer()
    writer.ASCIIMode = False
    with TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        writer.Write(solid.wrapped, str(path))
        return path.read_bytes()


def _merge_coincident_corners(file: bytes) -> bytes:
    """The same with corners that are meant to be one made one, and without the triangles that this leaves no area."""
    triangles = np.frombuffer(file, STL_RECORD, offset=STL_HEADER_BYTES).copy()
    triangles["corners"] = triangles["corners"].astype(float).round(CORNER_DECIMALS) + 0.0
    kept = triangles[~_is_degenerate(triangles["corners"])]
    return file[: STL_HEADER_BYTES - 4] + np.array(len(kept), "<u4").tobytes() + kept.tobytes()


def _is_degenerate(corners: Shaped[Array, "triangles 3 3"]) -> Shaped[Array, " triangles"]:
    """Triangles two of whose corners are one."""
    return np.any(
        [(corners[:, one] == corners[:, other]).all(axis=1) for one, other in ((0, 1), (1, 2), (2, 0))], axis=0
    )


Triangles = Float[Array, "_ 3 3"]
IMAGE_DEVIATION_MM, IMAGE_ANGLE_RAD = 0.02, 0.25
"""How far triangles may stand off curved faces, and turn from one to the next: finer than an image shows."""


def triangulate_solid(solid: Part) -> Triangles:
    """Its surface in mm; by way of STL, since corner by corner through Python takes ten times as long."""
    return np.frombuffer(
        _solid_to_stl(solid, IMAGE_DEVIATION_MM, IMAGE_ANGLE_RAD), STL_RECORD, offset=STL_HEADER_BYTES
    )["corners"].astype(float)


STEP_TIMESTAMP = datetime(2023, 8, 28, tzinfo=UTC)
"""Written as the files' date: the same design gives the same bytes."""
PRINT_DEVIATION_MM, PRINT_ANGLE_RAD = 0.01, 0.3
"""How far the triangles of an STL may stand off, and turn: a tenth of what a printer resolves."""


def part_to_step(name: str, solid: Part) -> bytes:
    """Exact, in mm."""
    return _shape_to_step(_label_solid(name, solid))


def assembly_to_step(bodies: Sequence[AssemblyBody]) -> bytes:
    """All bodies at their places, each by its name."""
    return _shape_to_step(Compound(label="sensor", children=[_label_solid(body.name, body.solid) for body in bodies]))


def _label_solid(name: str, solid: Part) -> Solid:
    """The solid alone, under this name."""
    (alone,) = solid.solids()
    named = Solid(alone.wrapped)
    named.label = name
    return named


def _shape_to_step(shape: Compound | Solid) -> bytes:
    """As the file has it."""
    buffer = BytesIO()
    export_step(shape, buffer, timestamp=STEP_TIMESTAMP)
    return buffer.getvalue()


def part_to_stl(solid: Part) -> bytes:
    """Triangles in mm, binary STL."""
    return _solid_to_stl(solid, PRINT_DEVIATION_MM, PRINT_ANGLE_RAD)

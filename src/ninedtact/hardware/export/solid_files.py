"""Solids as STEP, as watertight binary STL and as triangles. Lengths in mm."""

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
"""A title of 80 bytes, then the number of triangles."""
STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
"""One triangle of a binary STL file."""
CORNER_DECIMALS = 5
"""Corners are rounded to 10⁻⁵ mm: faces that meet agree on their corners only to about 10⁻¹⁵."""


def _solid_to_stl(solid: Part, flat_mm: float, turn_rad: float) -> bytes:
    """Return a watertight binary STL in which every edge is shared by exactly two triangles.

    flat_mm, turn_rad: greatest distance of a triangle from a curved face, and greatest angle between neighbouring
    triangles.
    """
    return _merge_coincident_corners(_mesh_as_stl(solid, flat_mm, turn_rad))


def _mesh_as_stl(solid: Part, flat_mm: float, turn_rad: float) -> bytes:
    """Return the mesh as the modelling library writes it. Its own `export_stl` is not used because it takes flat_mm for
    a share of each edge's length."""
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
    """Return the file with coincident corners made equal and without the triangles that this leaves no area."""
    triangles = np.frombuffer(file, STL_RECORD, offset=STL_HEADER_BYTES).copy()
    triangles["corners"] = triangles["corners"].astype(float).round(CORNER_DECIMALS) + 0.0
    kept = triangles[~_is_degenerate(triangles["corners"])]
    return file[: STL_HEADER_BYTES - 4] + np.array(len(kept), "<u4").tobytes() + kept.tobytes()


def _is_degenerate(corners: Shaped[Array, "triangles 3 3"]) -> Shaped[Array, " triangles"]:
    """Return which triangles have two equal corners."""
    return np.any(
        [(corners[:, one] == corners[:, other]).all(axis=1) for one, other in ((0, 1), (1, 2), (2, 0))], axis=0
    )


Triangles = Float[Array, "_ 3 3"]
IMAGE_DEVIATION_MM, IMAGE_ANGLE_RAD = 0.02, 0.25
"""Tolerances of triangles for images: finer than an image shows."""


def triangulate_solid(solid: Part) -> Triangles:
    """Return the surface of a solid as triangles in mm. It goes by way of STL, since corner by corner through Python
    takes ten times as long."""
    return np.frombuffer(
        _solid_to_stl(solid, IMAGE_DEVIATION_MM, IMAGE_ANGLE_RAD), STL_RECORD, offset=STL_HEADER_BYTES
    )["corners"].astype(float)


STEP_TIMESTAMP = datetime(2023, 8, 28, tzinfo=UTC)
"""Date of every STEP file: the same design gives the same bytes."""
PRINT_DEVIATION_MM, PRINT_ANGLE_RAD = 0.01, 0.3
"""Tolerances of triangles for printing: a tenth of what a printer resolves."""


def part_to_step(name: str, solid: Part) -> bytes:
    """Return a part as a STEP file, exact and in mm."""
    return _shape_to_step(_label_solid(name, solid))


def assembly_to_step(bodies: Sequence[AssemblyBody]) -> bytes:
    """Return all bodies in position as one STEP file, each under its name."""
    return _shape_to_step(Compound(label="sensor", children=[_label_solid(body.name, body.solid) for body in bodies]))


def _label_solid(name: str, solid: Part) -> Solid:
    """Return the single solid of a part under this name."""
    (alone,) = solid.solids()
    named = Solid(alone.wrapped)
    named.label = name
    return named


def _shape_to_step(shape: Compound | Solid) -> bytes:
    """Return a shape as a STEP file."""
    buffer = BytesIO()
    export_step(shape, buffer, timestamp=STEP_TIMESTAMP)
    return buffer.getvalue()


def part_to_stl(solid: Part) -> bytes:
    """Return a part as a binary STL file for printing."""
    return _solid_to_stl(solid, PRINT_DEVIATION_MM, PRINT_ANGLE_RAD)

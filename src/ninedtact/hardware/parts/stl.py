"""A solid as triangles, in the binary form that printers take: watertight, every edge shared by exactly two triangles."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from build123d import Part
from jaxtyping import Shaped
from numpy import ndarray as Array

HEADER_BYTES = 84
"""A title of 80, then the number of triangles."""
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
"""Of a binary STL file, once for each triangle after the header."""
DECIMALS = 5
"""Corners are rounded to 10⁻⁵ mm: faces that meet agree on their corners only to about 10⁻¹⁵."""


def stl(solid: Part, flat_mm: float, turn_rad: float) -> bytes:
    """Triangles in mm, which stand off curved faces and turn from one to the next by no more than this."""
    return whole(meshed(solid, flat_mm, turn_rad))


def meshed(solid: Part, flat_mm: float, turn_rad: float) -> bytes:
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


def whole(file: bytes) -> bytes:
    """The same with corners that are meant to be one made one, and without the triangles that this leaves no area."""
    triangles = np.frombuffer(file, RECORD, offset=HEADER_BYTES).copy()
    triangles["corners"] = triangles["corners"].astype(float).round(DECIMALS) + 0.0
    kept = triangles[~degenerate(triangles["corners"])]
    return file[: HEADER_BYTES - 4] + np.array(len(kept), "<u4").tobytes() + kept.tobytes()


def degenerate(corners: Shaped[Array, "triangles 3 3"]) -> Shaped[Array, " triangles"]:
    """Triangles two of whose corners are one."""
    return np.any(
        [(corners[:, one] == corners[:, other]).all(axis=1) for one, other in ((0, 1), (1, 2), (2, 0))], axis=0
    )

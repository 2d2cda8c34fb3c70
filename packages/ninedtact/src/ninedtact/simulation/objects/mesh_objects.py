"""Triangle meshes as indenters: mesh files read by trimesh (docs/objects.md).

The centre of the footprint becomes the object's origin. A mesh need not be closed: only its underside matters, and where nothing
is visible from below there is no object. Of an object wider than `KEPT_MM`, only the middle is kept.
"""

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, Int
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import require_within_bounds
from ninedtact.errors import FileFormatError, MissingLibraryError
from ninedtact.limited_process import FileTooCostly, run_limited
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter, indenter_from_heights
from ninedtact.required_libraries import require_libraries
from ninedtact.simulation.objects.height_fields import Heightfield
from ninedtact.simulation.objects.mesh_raster import rasterize_lowest_mm

Vertices = Float[Array, "vertices 3"]
Faces = Int[Array, "faces 3"]

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
SIDES = {
    "-z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "+z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "-x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "+x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "-y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "+y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}
"""The rotation that makes this side of the mesh face the skin."""
PITCH_MM = 0.1
LEAST_MM, LARGEST_MM = 1.0, 60.0
KEPT_MM = 36.0
"""Side of the square of an object that is kept: the diagonal of the sensing area, 30 mm, and a margin for drags."""
MOST_TRIANGLES = 5_000_000
MOST_POINTS = 300_000_000
"""Number of points of the grid, counted once for every triangle whose bounding box holds them; about ten seconds of work."""


class MeshUnusable(FileFormatError):
    """Raised for a mesh that cannot be used as it is."""


class MeshMisplaced(MeshUnusable):
    """Raised for a mesh that another unit, size or side may make usable."""

    def __init__(self, finding: str, remedy: str) -> None:
        """finding: what was expected and what was found. remedy: how it is placed in another way where objects are named."""
        super().__init__(f"{finding}; {remedy}")
        self.finding = finding


@dataclass(frozen=True)
class MeshPlacement:
    """Unit, orientation and size of a mesh."""

    unit: str = "mm"
    side: str = "-z"
    """The side that faces the skin."""
    scale: Annotated[float, Meta(gt=0, le=1e6)] = 1.0
    fit_mm: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    """If given, the mesh is scaled until the longer side of its footprint has this length."""

    def __post_init__(self) -> None:
        if self.unit not in MM_PER_UNIT or self.side not in SIDES:
            raise MeshUnusable(
                expected=f"a unit of {', '.join(MM_PER_UNIT)} and a side of {', '.join(SIDES)}",
                got=f"{self.unit} and {self.side}",
                remedy="correct them",
            )
        require_within_bounds(self, refusal=MeshUnusable)


@dataclass(frozen=True)
class MeshObject:
    """The underside of a mesh, with the size and the defects of the mesh."""

    relief: HeightGridIndenter
    size_mm: tuple[float, float, float]
    triangles: int
    closed: bool
    """Whether the mesh bounds a solid; through a hole that faces the skin, its inside counts."""
    cropped: bool
    """Whether only the middle of the mesh was kept."""


def _object_from_triangles(
    name: str, vertices: Vertices, faces: Faces, placing: MeshPlacement = MeshPlacement()
) -> MeshObject:
    """Return the object of a triangle mesh; raises `MeshUnusable`."""
    _require_valid_triangles(name, vertices, faces)
    used = np.unique(faces)
    turned = vertices @ np.array(SIDES[placing.side], float).T * placing.scale * MM_PER_UNIT[placing.unit]
    if placing.fit_mm is not None:
        turned = turned * (placing.fit_mm / max(np.ptp(turned[used, :2], axis=0).max(), 1e-12))
    size = np.ptp(turned[used], axis=0)
    _require_plausible_size(name, size)
    _require_few_layers(name, turned, faces)
    heights, cropped = _crop_to_middle(rasterize_lowest_mm(turned[faces], PITCH_MM))
    x, y, z = size.tolist()
    return MeshObject(
        indenter_from_heights(name, heights, PITCH_MM), (x, y, z), len(faces), _is_closed(vertices, faces), cropped
    )


def _crop_to_middle(heights: Heightfield) -> tuple[Float[Array, "kept_rows kept_cols"], bool]:
    """Return the middle of a height field, and whether anything was cut off."""
    most = round(KEPT_MM / PITCH_MM)
    starts = [max(samples - most, 0) // 2 for samples in heights.shape]
    rows, cols = (slice(start, start + most) for start in starts)
    return heights[rows, cols], any(start > 0 for start in starts)


def _require_valid_triangles(name: str, vertices: Vertices, faces: Faces) -> None:
    """Refuse a mesh without triangles, or with vertices that are missing or not finite."""
    if not 0 < len(faces) <= MOST_TRIANGLES:
        raise MeshUnusable(
            expected=f"triangles in {name}, 1 to {MOST_TRIANGLES} of them",
            got=f"{len(faces)}",
            remedy="export a surface mesh, or simplify it",
        )
    there = faces.min() >= 0 and faces.max() < len(vertices)
    if not there or not np.isfinite(vertices[faces]).all():
        raise MeshUnusable(
            expected=f"every corner of {name} at a finite place",
            got="corners that are missing, infinite or not a number",
            remedy="repair or export it again",
        )


def _require_plausible_size(name: str, size_mm: Float[Array, "3"]) -> None:
    """Refuse a mesh in a wrong unit, without a face towards the skin, or much larger than the sensor."""
    got = " x ".join(f"{side:.3g}" for side in size_mm)
    if size_mm.max() < LEAST_MM:
        metres, inches = (" x ".join(f"{side * MM_PER_UNIT[unit]:.3g}" for side in size_mm) for unit in ("m", "in"))
        raise MeshMisplaced(
            f"expected {name} in millimetres, larger than {LEAST_MM:g} mm, got {got} mm",
            f"in metres it would be {metres} mm (give unit m), in inches {inches} mm (give unit in)",
        )
    if size_mm[:2].max() > LARGEST_MM:
        raise MeshMisplaced(
            f"expected {name} at most {LARGEST_MM:g} mm across, got {got} mm",
            "give a scale, a size to fit (fit:16), another side, or cut out the part that touches",
        )
    if size_mm[:2].min() < PITCH_MM:
        raise MeshMisplaced(f"expected {name} to have a face towards the skin, got {got} mm", "give another side")


def _require_few_layers(name: str, vertices_mm: Vertices, faces: Faces) -> None:
    """Refuse triangles that cover the grid so many times that they would take minutes."""
    corners = vertices_mm[faces, :2]
    points = ((corners.max(axis=1) - corners.min(axis=1)) / PITCH_MM + 2).prod(axis=1).sum()
    if points > MOST_POINTS:
        layers = points * PITCH_MM**2 / np.ptp(vertices_mm[np.unique(faces), :2], axis=0).prod()
        raise MeshUnusable(
            expected=f"a surface mesh of {name}",
            got=f"triangles that lie upon each other about {layers:.0f} times",
            remedy="simplify it, or export the surface alone",
        )


def _is_closed(vertices: Vertices, faces: Faces) -> bool:
    """Return whether every edge belongs to two different triangles or more, so that no hole shows the inside.

    Vertices at the same position count as one, and so do triangles with the same corners: a sheet that is stored with both of its
    sides is open. Triangles without area, whose corners coincide, do not count.
    """
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    corners = same.reshape(-1)[faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    if not len(corners):
        return False
    edges = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    keys, third = edges[:, 0] * len(vertices) + edges[:, 1], corners[:, [2, 0, 1]].reshape(-1)
    order = np.argsort(keys)
    starts, third = np.flatnonzero(np.diff(keys[order], prepend=-1)), third[order]
    return bool((np.minimum.reduceat(third, starts) != np.maximum.reduceat(third, starts)).all())


MESH_FILE_SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", ".3mf")
MOST_MB = 500
_PLAIN_BYTES, _PLAIN_PARTS = 1_000_000, 20
"""Largest size, and most bodies and materials, of an STL or OBJ file that is read in the program's own process."""
_PART_OF_OBJ = re.compile(rb"\b(?:usemtl|mtllib|[og])\b")


def load_mesh_object(path: Path, placing: MeshPlacement = MeshPlacement()) -> MeshObject:
    """Return the object in a mesh file; raises `MeshUnusable` and `MissingLibraryError`.

    All but small plain files are read in a process of their own, whose start takes about a second.
    """
    _require_mesh_file(path)
    if _is_small_and_plain(path):
        return _load_mesh_object(path, placing)
    try:
        return run_limited(_load_mesh_object, path, placing, file_bytes=path.stat().st_size)
    except FileTooCostly as error:
        raise MeshUnusable(
            expected=f"a mesh in {path}", got="a file that takes too long or too much memory", remedy="simplify it"
        ) from error


def _is_small_and_plain(path: Path) -> bool:
    """Return whether reading a file takes time and memory in proportion to its small size: no count in it is only stated.

    The time per body or material of an OBJ file grows with their number, and so does that of bodies in an STL file of text.
    """
    suffix = path.suffix.lower()
    if suffix not in (".obj", ".stl") or path.stat().st_size > _PLAIN_BYTES:
        return False
    content = path.read_bytes()
    parts = content.count(b"solid") if suffix == ".stl" else len(_PART_OF_OBJ.findall(content))
    return parts <= _PLAIN_PARTS


def _load_mesh_object(path: Path, placing: MeshPlacement) -> MeshObject:
    vertices, faces, stated_unit = _read_mesh(path)
    if placing.fit_mm is None and stated_unit not in (None, placing.unit):
        remedy = f"give unit {stated_unit}" if stated_unit in MM_PER_UNIT else "export it in millimetres"
        raise MeshMisplaced(
            f"expected {path.stem} in {placing.unit}, got a file that states the unit {stated_unit}", remedy
        )
    return _object_from_triangles(path.stem, vertices, faces, placing)


_UNIT_OF_3MF = {"millimeter": "mm", "millimeters": "mm", "centimeter": "cm", "meter": "m", "inch": "in"}
"""Units that a 3MF file may state, by the names of its specification; trimesh calls the default one millimeters."""


def _read_mesh(path: Path) -> tuple[Vertices, Faces, str | None]:
    """Return vertices and triangles as the file has them, several bodies as one, and the unit that the file states, if any."""
    trimesh = _import_trimesh()
    try:
        # Processing is off, so that broken vertices reach the checks and are refused.
        plain = {"skip_materials": True, "group_material": False} if path.suffix.lower() == ".obj" else {}
        mesh = trimesh.load_mesh(path, process=False, **plain)
    except ImportError as absence:
        raise MissingLibraryError(
            f"expected the libraries with which trimesh reads {path.suffix} files, got: {absence}; run: pip install lxml networkx"
        ) from absence
    except Exception as failure:
        raise MeshUnusable(
            expected=f"a mesh in {path}", got=f"a file that cannot be read ({failure})", remedy="export it again"
        ) from failure
    if not hasattr(mesh, "faces"):
        raise MeshUnusable(expected=f"triangles in {path}", got="only points or lines", remedy="export a surface mesh")
    stated = mesh.units if path.suffix.lower() == ".3mf" else None
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
    return vertices.reshape(-1, 3), faces.reshape(-1, 3), None if stated is None else _UNIT_OF_3MF.get(stated, stated)


def _require_mesh_file(path: Path) -> None:
    """Raise `MeshUnusable` for what is no file, too large, or of another kind."""
    if not path.is_file() or path.suffix.lower() not in MESH_FILE_SUFFIXES or path.stat().st_size > MOST_MB * 1e6:
        raise MeshUnusable(
            expected=f"a file of at most {MOST_MB} MB ending in {', '.join(MESH_FILE_SUFFIXES)}",
            got=f"{path}{'' if path.exists() else ', which is not there'}",
            remedy="check the path, or convert or simplify the mesh",
        )


def _import_trimesh() -> Any:
    """Return the library; raises `MissingLibraryError`."""
    require_libraries("objects", "trimesh")
    import trimesh

    # Without any handler, Python prints the library's warnings, tracebacks included, beside the sentence of this package.
    if not (log := logging.getLogger("trimesh")).handlers:
        log.addHandler(logging.NullHandler())
    return trimesh

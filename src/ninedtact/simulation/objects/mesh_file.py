"""Mesh files, read by trimesh."""

from pathlib import Path
from typing import Any

import numpy as np

from ninedtact.errors import NinedtactError
from ninedtact.simulation.objects.mesh import Faces, MeshObject, MeshUnusable, Placing, Vertices, mesh_object

ENDINGS = (".stl", ".obj", ".ply", ".off", ".glb", ".3mf")
MOST_MB = 500


class ObjectsNotInstalled(NinedtactError):
    """A library that reads objects is missing."""


def load_mesh(path: Path, placing: Placing = Placing()) -> MeshObject:
    """The object in a file; raises `MeshUnusable` and `ObjectsNotInstalled`."""
    vertices, faces = read_mesh(path)
    return mesh_object(path.stem, vertices, faces, placing)


def read_mesh(path: Path) -> tuple[Vertices, Faces]:
    """Corners and triangles as the file has them, several bodies as one."""
    if not path.is_file() or path.suffix.lower() not in ENDINGS or path.stat().st_size > MOST_MB * 1e6:
        raise MeshUnusable(
            f"expected a file of at most {MOST_MB} MB ending in {', '.join(ENDINGS)}, got {path}"
            f"{'' if path.exists() else ', which is not there'}; check the path, or convert or simplify the mesh"
        )
    trimesh = required_trimesh()
    try:
        # Nothing is merged or mended here, so that broken corners are seen and refused.
        mesh = trimesh.load_mesh(path, process=False)
    except Exception as failure:
        raise MeshUnusable(
            f"expected a mesh in {path}, got a file that cannot be read ({failure}); export it again"
        ) from failure
    if not hasattr(mesh, "faces"):
        raise MeshUnusable(f"expected triangles in {path}, got only points or lines; export a surface mesh")
    return np.asarray(mesh.vertices, float).reshape(-1, 3), np.asarray(mesh.faces, np.int64).reshape(-1, 3)


def required_trimesh() -> Any:
    """The library, or how to get it."""
    try:
        import trimesh
    except ImportError as absence:
        raise ObjectsNotInstalled(
            "expected the library trimesh, got an environment without it; run: pip install 'ninedtact[objects]'"
        ) from absence
    return trimesh

"""Write a shape as the files that other tools open: .npy, 16-bit .png, .ply, .stl, .obj. All lengths in mm."""

from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int32
from numpy import ndarray as Array

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import NinedtactError
from ninedtact.quantities import HeightMap, Mesh, PointCloud
from ninedtact.shape.cloud import point_cloud
from ninedtact.shape.height_png import height_png
from ninedtact.shape.mesh import faces_between, surface_mesh

NO_FACES = np.empty((0, 3), np.int32)
PLY_FACE = np.dtype([("corners", "u1"), ("faces", "<i4", 3)])
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


class FormatUnknown(NinedtactError):
    """A file name whose ending says nothing that can be written."""


def export(height: HeightMap, path: Path | str, every: int = 1) -> None:
    """Write `height` in the format that the ending of `path` names: .npy, .png (16 bit), .ply, .stl or .obj.

    `every` = 3 keeps each third row and column of a mesh. Raises `FormatUnknown`, `FileNotWritten`.
    """
    match Path(path).suffix.lower():
        case ".npy":
            write_npy(path, height)
        case ".png":
            write_file_atomically(path, height_png(height))
        case ".ply":
            write_ply(path, point_cloud(height, every), faces_between(height.in_view[::every, ::every]))
        case ".stl":
            write_stl(path, surface_mesh(height, every))
        case ".obj":
            write_obj(path, surface_mesh(height, every))
        case other:
            raise FormatUnknown(
                f"expected a file name ending in .npy, .png, .ply, .stl or .obj, got {other or path!s}; rename it"
            )


def write_npy(path: Path | str, height: HeightMap) -> None:
    """float32 heights in mm, NaN out of view; `numpy.load` reads it."""
    buffer = BytesIO()
    np.save(buffer, np.where(height.in_view, height.z_mm, np.float32(np.nan)))
    write_file_atomically(path, buffer.getbuffer())


def write_ply(path: Path | str, cloud: PointCloud, faces: Int32[Array, "m 3"] = NO_FACES) -> None:
    """Binary PLY: points with normals and, if given, triangles between them."""
    vertices = np.hstack([cloud.points_mm, cloud.normals]).astype("<f4")
    triangles = np.empty(len(faces), PLY_FACE)
    triangles["corners"], triangles["faces"] = 3, faces
    write_file_atomically(path, ply_header(len(vertices), len(faces)), vertices.tobytes(), triangles.tobytes())


def ply_header(points: int, faces: int) -> bytes:
    """Header of a binary PLY; the triangles are left out where there are none."""
    properties = [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    lines = ["ply", "format binary_little_endian 1.0", "comment lengths in mm", f"element vertex {points}", *properties]
    if faces:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""]).encode()


def write_stl(path: Path | str, mesh: Mesh) -> None:
    """Binary STL."""
    triangles = np.zeros(len(mesh.faces), STL_TRIANGLE)
    triangles["corners"] = mesh.vertices_mm[mesh.faces]
    triangles["normal"] = face_normals(triangles["corners"])
    header = b"binary STL, lengths in mm".ljust(80)  # must not begin with "solid", which announces a text STL
    write_file_atomically(path, header, np.uint32(len(triangles)).astype("<u4").tobytes(), triangles.tobytes())


def face_normals(corners: Float32[Array, "m 3 3"]) -> Float32[Array, "m 3"]:
    """Unit normals of triangles, by the right-hand rule; zero for a triangle without area."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.asarray(across / np.where(length > 0, length, 1), np.float32)


def write_obj(path: Path | str, mesh: Mesh) -> None:
    """Wavefront OBJ, to a tenth of a micrometre."""
    vertices = "v %.4f %.4f %.4f\n" * len(mesh.vertices_mm) % tuple(mesh.vertices_mm.ravel().tolist())
    faces = "f %d %d %d\n" * len(mesh.faces) % tuple((mesh.faces + 1).ravel().tolist())
    write_file_atomically(path, b"# lengths in mm\n", vertices.encode(), faces.encode())

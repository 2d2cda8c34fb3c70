"""Export of a height map to the files that other tools open: .npy, 16-bit .png, .ply, .stl and .obj. All lengths are in mm.

The PNG has one grey level per micrometre and describes itself in its text chunks; `read_height_png` reads it back.

    z_mm = (level − 32768) / 1000, level 0 where the camera does not see the skin

The text chunks `mm_per_px`, `noise_mm`, `camera_distance_mm` and `stamp_ns` carry the rest of a `HeightMap`, except which heights
are extrapolated: when read back, all heights are MEASURED.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from jaxtyping import Float32, Int32, UInt16
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.atomic_write import write_file_atomically
from ninedtact.bounds import checks_arguments
from ninedtact.checked_reading import read_regular_file
from ninedtact.errors import FileFormatError, InputError, OutputError
from ninedtact.quantities import HeightMap, HeightSource, Mesh, PointCloud
from ninedtact.shape.surface import point_cloud, require_mesh_spacing, surface_mesh, triangulate_view

LEVELS_PER_MM = 1000
ZERO_LEVEL = 32768
"""Grey level of height zero."""
OUT_OF_VIEW_LEVEL = 0
REACH_MM = 32.767
"""The largest height, up or down, that the levels hold."""
LEGEND = "height of the skin: z_mm = (level - 32768) / 1000, level 0 = out of view, negative = pressed in"
SCALES = ("mm_per_px", "noise_mm", "camera_distance_mm")
"""The fields of a height map that are stored as text."""
SIGNATURE = b"\x89PNG\r\n\x1a\n"
TEXT_PLACE = len(SIGNATURE) + 25
"""Byte offset at which a PNG may first carry text: after its header chunk."""


def encode_height_png(height: HeightMap) -> bytes:
    """Encode heights, rounded to the micrometre; raises `OutputError` beyond ±32.767 mm."""
    png = cv2.imencode(".png", heights_to_grey_levels(height))[1].tobytes()
    numbers = {name: repr(float(getattr(height, name))) for name in SCALES}
    text = {"Description": LEGEND, **numbers, "stamp_ns": str(height.stamp_ns)}
    return png[:TEXT_PLACE] + b"".join(text_chunk(*entry) for entry in text.items()) + png[TEXT_PLACE:]


def heights_to_grey_levels(height: HeightMap) -> UInt16[Array, "rows cols"]:
    """Return the grey levels of the PNG."""
    z_mm = np.where(height.in_view, height.z_mm, 0)
    # The comparison is written so that NaN is refused too.
    if not (np.abs(z_mm) <= REACH_MM).all():
        worst = np.abs(z_mm).max()
        raise OutputError(
            expected=f"heights up to {REACH_MM} mm for a .png", got=f"{worst} mm", remedy="write .npy instead"
        )
    return np.where(height.in_view, np.rint(z_mm * LEVELS_PER_MM) + ZERO_LEVEL, OUT_OF_VIEW_LEVEL).astype(np.uint16)


@checks_arguments
def read_height_png(path: Path | str) -> HeightMap:
    """Read back what `encode_height_png` encoded; raises `FileFormatError`."""
    try:
        return decode_height_png(read_regular_file(path))
    except (OSError, ValueError, KeyError, struct.error, cv2.error) as trouble:
        raise FileFormatError(
            f"expected {path} to be an undamaged height image (16-bit grey PNG with its scale as text), "
            f"got: {trouble}; export it again"
        ) from trouble


def decode_height_png(png: bytes) -> HeightMap:
    """Return the height map in the bytes of a PNG."""
    text = dict(data.decode("latin-1").split("\0", 1) for kind, data in iterate_png_chunks(png) if kind == b"tEXt")
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise ValueError("an image that is not 16-bit grey")
    seen = image != OUT_OF_VIEW_LEVEL
    z_mm = np.where(seen, (image.astype(np.float32) - ZERO_LEVEL) / LEVELS_PER_MM, 0).astype(np.float32)
    source = np.where(seen, HeightSource.MEASURED, HeightSource.OUT_OF_VIEW).astype(np.uint8)
    numbers: dict[str, Any] = {name: float(text[name]) for name in SCALES}
    return HeightMap(z_mm, source, **numbers, stamp_ns=int(text["stamp_ns"]))


def iterate_png_chunks(png: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the type and content of every chunk; raises `ValueError` or `struct.error` where one is damaged or missing."""
    if not png.startswith(SIGNATURE):
        raise ValueError("no PNG")
    place, kind = len(SIGNATURE), b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", png, place)
        data = png[place + 8 : place + 8 + length]
        if struct.unpack_from(">I", png, place + 8 + length) != (zlib.crc32(kind + data),):
            raise ValueError(f"a damaged {kind!r} chunk")
        place += length + 12
        yield kind, data


def text_chunk(name: str, value: str) -> bytes:
    """Return one text entry as a PNG chunk."""
    kind, data = b"tEXt", f"{name}\0{value}".encode("latin-1")
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


NO_FACES = np.empty((0, 3), np.int32)
PLY_FACE = np.dtype([("corners", "u1"), ("faces", "<i4", 3)])
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@checks_arguments
def export_shape(height: HeightMap, path: Path | str, every: Annotated[int, Meta(ge=1)] = 1) -> None:
    """Write `height` in the format given by the extension of `path`: .npy, .png (16 bit), .ply, .stl or .obj.

    `every` = 3 keeps each third row and column of a mesh. Raises `InputError`, `FileNotWritten`, and `InputError` where
    that leaves no mesh.
    """
    match Path(path).suffix.lower():
        case ".npy":
            write_npy(path, height)
        case ".png":
            write_file_atomically(path, encode_height_png(height))
        case ".ply":
            require_mesh_spacing(height, every)
            write_ply(path, point_cloud(height, every), triangulate_view(height.in_view[::every, ::every]))
        case ".stl":
            write_mesh_as_stl(path, surface_mesh(height, every))
        case ".obj":
            write_obj(path, surface_mesh(height, every))
        case other:
            raise InputError(
                expected="a file name ending in .npy, .png, .ply, .stl or .obj",
                got=f"{other or path!s}",
                remedy="rename it",
            )


def write_npy(path: Path | str, height: HeightMap) -> None:
    """Write float32 heights in mm, NaN out of view; `numpy.load` reads the file."""
    buffer = BytesIO()
    np.save(buffer, height.visible_z_mm)
    write_file_atomically(path, buffer.getvalue())


def write_ply(path: Path | str, cloud: PointCloud, faces: Int32[Array, "m 3"] = NO_FACES) -> None:
    """Write a binary PLY file: points with normals and, if given, triangles between them."""
    vertices = np.hstack([cloud.points_mm, cloud.normals]).astype("<f4")
    triangles = np.empty(len(faces), PLY_FACE)
    triangles["corners"], triangles["faces"] = 3, faces
    write_file_atomically(path, ply_header(len(vertices), len(faces)), vertices.tobytes(), triangles.tobytes())


def ply_header(points: int, faces: int) -> bytes:
    """Return the header of a binary PLY file; triangles are not declared where there are none."""
    properties = [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    lines = ["ply", "format binary_little_endian 1.0", "comment lengths in mm", f"element vertex {points}", *properties]
    if faces:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""]).encode()


def write_mesh_as_stl(path: Path | str, mesh: Mesh) -> None:
    """Write a binary STL file."""
    triangles = np.zeros(len(mesh.faces), STL_TRIANGLE)
    triangles["corners"] = mesh.vertices_mm[mesh.faces]
    triangles["normal"] = face_normals(triangles["corners"])
    header = b"binary STL, lengths in mm".ljust(80)  # "solid" at the start would mark a text STL
    write_file_atomically(path, header, np.uint32(len(triangles)).astype("<u4").tobytes(), triangles.tobytes())


def face_normals(corners: Float32[Array, "m 3 3"]) -> Float32[Array, "m 3"]:
    """Return the unit normals of triangles by the right-hand rule; a triangle without area has the normal zero."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.asarray(across / np.where(length > 0, length, 1), np.float32)


def write_obj(path: Path | str, mesh: Mesh) -> None:
    """Write a Wavefront OBJ file, rounded to a tenth of a micrometre."""
    vertices = "v %.4f %.4f %.4f\n" * len(mesh.vertices_mm) % tuple(mesh.vertices_mm.ravel().tolist())
    faces = "f %d %d %d\n" * len(mesh.faces) % tuple((mesh.faces + 1).ravel().tolist())
    write_file_atomically(path, b"# lengths in mm\n", vertices.encode(), faces.encode())

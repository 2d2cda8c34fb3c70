"""Triangles over the skin: as an open surface, or closed into a block of gel that can be printed."""

import numpy as np
from jaxtyping import Bool, Int32
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap, Mesh
from ninedtact.shape.cloud import point_cloud


def surface_mesh(height: HeightMap, every: int = 1) -> Mesh:
    """Two triangles per square of pixels wholly in view; vertex k is point k of `point_cloud(height, every)`."""
    return Mesh(point_cloud(height, every).points_mm.copy(), faces_between(height.in_view[::every, ::every]))


def solid_mesh(height: HeightMap, base_mm: float = 2.0, every: int = 1) -> Mesh:
    """The surface with walls and a flat base, `base_mm` below its deepest point: closed, for 3D printing."""
    surface = surface_mesh(height, every)
    base = surface.vertices_mm.copy()
    base[:, 2] = surface.vertices_mm[:, 2].min(initial=0) - base_mm
    below = np.int32(len(base))
    start, end = rim(surface.faces).T
    walls = [np.stack([end, start, start + below], 1), np.stack([end, start + below, end + below], 1)]
    faces = np.concatenate([surface.faces, surface.faces[:, ::-1] + below, *walls])
    return Mesh(np.concatenate([surface.vertices_mm, base]), faces)


def faces_between(seen: Bool[Array, "rows cols"]) -> Int32[Array, "m 3"]:
    """Triangles as numbers of seen pixels counted row by row, counter-clockwise with x right and y up."""
    number = np.cumsum(seen, dtype=np.int32).reshape(seen.shape) - np.int32(1)
    whole = seen[:-1, :-1] & seen[:-1, 1:] & seen[1:, :-1] & seen[1:, 1:]
    near, right, far, across = (
        part[whole] for part in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:])
    )
    return np.stack([near, right, across, near, across, far], axis=-1).reshape(-1, 3)


def rim(faces: Int32[Array, "m 3"]) -> Int32[Array, "k 2"]:
    """Edges that have a triangle on their left side only."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    there, back = (edges @ weights for weights in np.array([[1 << 32, 1], [1, 1 << 32]]))
    return edges[~np.isin(there, back)]

"""Rasterisation of triangles from below: the lowest height above every point of a grid.

The rasteriser uses scan lines. Each triangle is cut into the rows of the grid that it crosses, and each row into the columns
between the two edges that it meets. All triangles are processed together, in portions that fit into memory; the cost is
proportional to the number of covered points.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from ninedtact.simulation.objects.height_fields import Heightfield

Triangles = Float[Array, "triangles 3 3"]
Lines = Int[Array, " lines"]
Points = Int[Array, " points"]
Places = Float[Array, " lines"]

PORTION = 1_000_000
"""Number of grid points processed together; about 100 MB."""
NEAR = 1e-6
"""Fraction of a pitch by which triangles are widened, so that neighbours leave no gap."""


def rasterize_lowest_mm(triangles_mm: Triangles, pitch_mm: float) -> Heightfield:
    """Return the lowest z on a grid over the footprint of triangles, infinite where there is none."""
    flat = triangles_mm[..., :2].reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    cols, rows = (np.floor((high - low) / pitch_mm + NEAR).astype(int) + 1).tolist()
    placed = triangles_mm.astype(float)
    placed[..., :2] = (placed[..., :2] - (low + high) / 2) / pitch_mm + (np.array([cols, rows]) - 1) / 2
    table = np.full((rows, cols), np.inf)
    for portion in split_triangles_into_batches(placed):
        lower_to_triangles(table, portion)
    return table


def split_triangles_into_batches(placed: Triangles) -> Iterator[Triangles]:
    """Split triangles into batches whose bounding boxes hold a limited number of grid points."""
    sides = placed[..., :2].max(axis=1) - placed[..., :2].min(axis=1)
    load = np.cumsum((sides + 2).prod(axis=1))
    cuts = np.searchsorted(load, np.arange(PORTION, load[-1], PORTION))
    return (part for part in np.split(placed, np.unique(cuts)) if len(part))


def lower_to_triangles(table: Heightfield, placed: Triangles) -> None:
    """Lower a height table to triangles that are given in columns, rows and mm."""
    owner, row = _runs(*_covered(placed[:, :, 1].min(axis=1), placed[:, :, 1].max(axis=1), table.shape[0]))
    left, right = _crossings(placed, owner, row)
    span, col = _runs(*_covered(left, right, table.shape[1]))
    owner, row = owner[span], row[span]
    np.minimum.at(table.ravel(), row * table.shape[1] + col, _heights_at(placed, owner, col, row))


def _covered(low: Places, high: Places, samples: int) -> tuple[Lines, Lines]:
    """Return the first grid line at or above `low`, and the number of grid lines up to `high`."""
    first = np.ceil(np.clip(low - NEAR, 0, samples)).astype(int)
    last = np.floor(np.clip(high + NEAR, -1, samples - 1)).astype(int)
    return first, np.maximum(last - first + 1, 0)


def _runs(first: Lines, count: Lines) -> tuple[Points, Points]:
    """Return the run that each grid line belongs to, and the number of that grid line, for all runs laid end to end."""
    owner = np.repeat(np.arange(len(count)), count)
    return owner, first[owner] + np.arange(len(owner)) - (np.cumsum(count) - count)[owner]


def _crossings(placed: Triangles, owner: Lines, row: Lines) -> tuple[Places, Places]:
    """Return the columns between which each row of a triangle is inside the triangle."""
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for corner in range(3):
        start, end = placed[:, corner, :2], placed[:, (corner + 1) % 3, :2]
        step = end - start
        # A level edge ends where the other two do.
        slope = np.divide(step[:, 0], step[:, 1], out=np.zeros(len(step)), where=step[:, 1] != 0)
        low, high = np.minimum(start[:, 1], end[:, 1])[owner], np.maximum(start[:, 1], end[:, 1])[owner]
        meets = (row >= low - NEAR) & (row <= high + NEAR)
        x = start[owner, 0] + slope[owner] * (np.clip(row, low, high) - start[owner, 1])
        left, right = np.where(meets, np.minimum(left, x), left), np.where(meets, np.maximum(right, x), right)
    return left, right


def _heights_at(placed: Triangles, owner: Points, col: Points, row: Points) -> Float[Array, " points"]:
    """Return the height of each point's triangle at that point; an upright triangle has the height of its lower end."""
    corner, low, high = placed[:, 0], placed[:, :, 2].min(axis=1), placed[:, :, 2].max(axis=1)
    normal = np.cross(placed[:, 1] - corner, placed[:, 2] - corner)
    upright = np.abs(normal[:, 2]) < 1e-12
    slope = -normal[:, :2] / np.where(upright, 1.0, normal[:, 2])[:, None]
    height = corner[owner, 2] + slope[owner, 0] * (col - corner[owner, 0]) + slope[owner, 1] * (row - corner[owner, 1])
    return np.clip(np.where(upright[owner], low[owner], height), low[owner], high[owner])

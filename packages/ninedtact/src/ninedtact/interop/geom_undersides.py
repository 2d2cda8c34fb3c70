"""The undersides of turned solids: where vertical lines over the skin first enter a box, cylinder, capsule, ellipsoid or mesh.

Each solid stands anywhere in the sensor frame, in any orientation. A vertical line enters a convex solid where it has entered all
the slabs and quadrics whose intersection the solid is. Meshes are rasterised in their present orientation with all their cavities.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter
from ninedtact.mechanics.indenter import NO_OBJECT_MM, Heights, Indenter, PosedHeights
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.objects.mesh_raster import rasterize_lowest_mm

Vector = Float[Array, "3"]
Rotation = Float[Array, "3 3"]
Interval = tuple[Any, Any]
"""Heights at which lines enter and leave a part of a solid; a line that misses it enters at +inf and leaves at −inf."""

MESH_PITCH_MM = 0.2
_MESH_REACH_MM = 8.0
"""Triangles that are wholly higher than this over the lowest point are left out, because no skin bulges so far."""
_PARALLEL = 1e-9
"""Component of the vertical along an axis below which lines count as perpendicular to it."""


class Solid(ABC):
    """A solid in the sensor frame."""

    @abstractmethod
    def lowest_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the height of the underside at positions on the skin, infinite where there is none."""


@dataclass(frozen=True)
class _Lines:
    """Parallel lines p + t·d in the frame of a solid, where t is the height over the skin."""

    starts_mm: Sequence[Any]
    direction: Sequence[float]

    def through_slab(self, axis: int, half_mm: float) -> Interval:
        """Return where lines are between two planes across an axis."""
        start, along = self.starts_mm[axis], self.direction[axis]
        if abs(along) < _PARALLEL:
            return _everywhere_if(abs(start) <= half_mm)
        ends = (-half_mm - start) / along, (half_mm - start) / along
        return (ends[0], ends[1]) if along > 0 else (ends[1], ends[0])

    def through_quadric(self, half_axes_mm: Sequence[float], offset_z_mm: float = 0.0) -> Interval:
        """Return where lines are inside an ellipsoid, or a cylinder along z where only two half axes are given."""
        offsets = (0.0, 0.0, offset_z_mm)
        starts = [(self.starts_mm[axis] - offsets[axis]) / half for axis, half in enumerate(half_axes_mm)]
        steps = [self.direction[axis] / half for axis, half in enumerate(half_axes_mm)]
        square, outside = sum(step**2 for step in steps), sum(start**2 for start in starts) - 1
        if square < _PARALLEL**2:
            return _everywhere_if(outside <= 0)
        mixed = sum(start * step for start, step in zip(starts, steps, strict=True))
        root = np.sqrt(np.maximum(mixed**2 - square * outside, 0.0))
        meets = mixed**2 >= square * outside
        return np.where(meets, (-mixed - root) / square, np.inf), np.where(meets, (root - mixed) / square, -np.inf)


def _everywhere_if(inside: Any) -> Interval:
    """Return all heights of the lines that are inside, and none of the others."""
    return np.where(inside, -np.inf, np.inf), np.where(inside, np.inf, -np.inf)


def _first_entry_mm(*intervals: Interval) -> Any:
    """Return where lines enter the intersection of convex parts, infinite where they miss it."""
    enter = np.maximum.reduce([one for one, _ in intervals])
    leave = np.minimum.reduce([one for _, one in intervals])
    return np.where(enter <= leave, enter, np.inf)


@dataclass(frozen=True)
class ConvexSolid(Solid):
    """An ellipsoid or box, or a cylinder or capsule along its own z axis."""

    shape: Literal["ellipsoid", "box", "cylinder", "capsule"]
    centre_mm: Vector
    rotation: Rotation
    """The matrix whose columns are the solid's axes in the sensor frame."""
    size_mm: Sequence[float]
    """Half axes or half sides; of a cylinder or capsule radius and half length, as MuJoCo counts them."""

    def lowest_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return what is seen of its surface from below."""
        lines = self._own_lines(x_mm, y_mm)
        if self.shape == "ellipsoid":
            return _first_entry_mm(lines.through_quadric(self.size_mm))
        if self.shape == "box":
            return _first_entry_mm(*(lines.through_slab(axis, half) for axis, half in enumerate(self.size_mm)))
        radius, half = self.size_mm
        shell = _first_entry_mm(lines.through_quadric((radius, radius)), lines.through_slab(2, half))
        if self.shape == "cylinder":
            return shell
        ends = (_first_entry_mm(lines.through_quadric((radius,) * 3, end)) for end in (-half, half))
        return np.minimum.reduce([shell, *ends])

    def _own_lines(self, x_mm: Heights, y_mm: Heights) -> "_Lines":
        """Return the vertical lines in the solid's own frame, from where they cross the undeformed skin."""
        away = (x_mm - self.centre_mm[0], y_mm - self.centre_mm[1], -self.centre_mm[2])
        starts = [sum(self.rotation[row, axis] * away[row] for row in range(3)) for axis in range(3)]
        return _Lines(starts, self.rotation[2].tolist())


@dataclass(frozen=True)
class MeshSolid(Solid):
    """A triangle mesh, which need not be convex."""

    triangles_mm: Float[Array, "triangles 3 3"]
    """The corners of the triangles in the sensor frame."""

    def lowest_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return what of the mesh is seen from below, bilinear on a grid of 0.2 mm."""
        raster, middle, base = self._raster
        heights = raster.underside_mm(x_mm - middle[0], y_mm - middle[1])
        return np.where(heights < NO_OBJECT_MM, heights + base, np.inf)

    @cached_property
    def _raster(self) -> tuple[HeightGridIndenter, tuple[float, float], float]:
        """The heights over the lowest point, the (x, y) of their middle, and the lowest height."""
        lowest = self.triangles_mm[..., 2].min(axis=1)
        triangles = self.triangles_mm[lowest < lowest.min() + _MESH_REACH_MM]
        flat = triangles[..., :2].reshape(-1, 2)
        x, y = ((flat.min(axis=0) + flat.max(axis=0)) / 2).tolist()
        heights = rasterize_lowest_mm(triangles, MESH_PITCH_MM)
        base = float(heights.min())
        return HeightGridIndenter("mesh", np.minimum(heights - base, NO_OBJECT_MM), MESH_PITCH_MM), (x, y), base


@dataclass(frozen=True, eq=False)
class CompoundIndenter(Indenter):
    """Solids as they stand over the skin, as one indenter about a point of it.

    They are turned already: the angles of a pose say only how they turned since the last step, which carries the skin that sticks.
    """

    name: str
    solids: tuple[Solid, ...]
    about_mm: tuple[float, float]
    """The (x, y) on the skin over which the origin of the pose is."""
    within_mm: Sequence[tuple[float, float]] = ((-np.inf, np.inf), (-np.inf, np.inf))
    """The x and the y on the skin between which they count: gel beyond its rim cannot be pressed."""
    base_mm: float = 0.0
    """Height of the lowest point in the sensor frame, which counts as zero here."""

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the lowest surface of all solids at positions about the origin."""
        x, y = (np.asarray(along, float) + middle for along, middle in zip((x_mm, y_mm), self.about_mm, strict=True))
        lowest = np.minimum.reduce([solid.lowest_mm(x, y) for solid in self.solids]) - self.base_mm
        inside = [(low <= at) & (at <= high) for at, (low, high) in zip((x, y), self.within_mm, strict=True)]
        return np.where(inside[0] & inside[1], np.minimum(lowest, NO_OBJECT_MM), NO_OBJECT_MM).astype(x_mm.dtype)

    def height_over_skin_mm(self, pose: Pose, x_mm: Heights, y_mm: Heights) -> PosedHeights:
        """Return the height of the underside over the undeformed skin, negative where it is pressed in."""
        return self.underside_mm(x_mm, y_mm) - pose.depth_mm

"""The active region of the grid, in which a contact is solved: where the object can touch, rounded up so that few sizes occur.

`SharedActiveRectangle` is one rectangle for all contacts of a batch, cut out as a smaller grid: the cheapest for one contact.
`ActiveRectangles` is a rectangle for each contact of a batch; all are solved on the whole grid and kept at zero outside their own
rectangle.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Bool, Float

from ninedtact.mechanics.indenter import NO_OBJECT_MM
from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of, max_over_grid, to_numpy
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField, Skin

_SIZE_STEP = 8
"""Sides of a rectangle are multiples of this many points, so that operators of few sizes are built."""
_CLEARANCE = 0.3
"""Skin may bulge up to an underside that stands clear by less than this part of the deepest overlap: bulges of balls and
edges reach 0.15 to 0.2 of it, before a long drag. Where they reach farther, the contact is solved again on the whole grid."""


@dataclass(frozen=True)
class GridRectangle:
    """A rectangle of grid points."""

    rows: slice
    cols: slice

    @property
    def shape(self) -> tuple[int, int]:
        """The number of points as (rows, cols)."""
        return self.rows.stop - self.rows.start, self.cols.stop - self.cols.start

    def enlarged(self, points: PointMask) -> "GridRectangle":
        """Return the rectangle around this one and these points of all contacts of a batch, rounded up as all are."""
        return rectangle_around_both(self, rectangle_around_points(points), (points.shape[-2], points.shape[-1]))


class ActiveRegion(ABC):
    """Where on the grid contacts are solved, with the operators for it."""

    operators: DisplacementOperators
    """The operators from tractions in the region to displacements in the region."""

    @property
    @abstractmethod
    def whole_grid_operators(self) -> DisplacementOperators:
        """The operators from tractions to displacements anywhere on the grid."""

    @abstractmethod
    def crop(self, field: Any) -> Any:
        """Return the region's part of a field of the whole grid."""

    @abstractmethod
    def crop_overlap(self, overlap_mm: ScalarField) -> Any:
        """Return the region's part of the overlap; there is no object outside it."""

    @abstractmethod
    def embed(self, field: Any) -> Any:
        """Return a field of the region as one of the whole grid, zero outside it."""

    @abstractmethod
    def any_outside(self, points: PointMask) -> Any:
        """Return whether some of these points of the whole grid lie outside the region: for all contacts together, or for each."""


@dataclass(frozen=True)
class SharedActiveRectangle(ActiveRegion):
    """One rectangle for all contacts, as a grid of its own."""

    rectangle: GridRectangle
    skin: Skin
    operators: DisplacementOperators

    @property
    def whole_grid_operators(self) -> DisplacementOperators:
        """The operators of the periodic grid."""
        return self.skin.operators

    def crop(self, field: Any) -> Any:
        """Return the part of a field in the rectangle."""
        return field[..., self.rectangle.rows, self.rectangle.cols]

    def crop_overlap(self, overlap_mm: ScalarField) -> Any:
        """Return the part of the overlap in the rectangle."""
        return self.crop(overlap_mm)

    def embed(self, field: Any) -> Any:
        """Return a field of the rectangle on the whole grid, zero elsewhere."""
        shape = self.skin.grid.shape
        if field.shape[-2:] == shape:
            return field
        whole = array_namespace_of(field).zeros((*field.shape[:-2], *shape), dtype=field.dtype, device=device(field))
        whole[..., self.rectangle.rows, self.rectangle.cols] = field
        return whole

    def any_outside(self, points: PointMask) -> bool:
        """Return whether any contact of the batch has one of these points outside the rectangle."""
        return bool(points.sum() != self.crop(points).sum())

    def enlarged(self, points: PointMask) -> "SharedActiveRectangle":
        """Return a region that contains this one and these points of all contacts of the batch."""
        return region_of_rectangle(self.skin, self.rectangle.enlarged(points))


@dataclass(frozen=True)
class ActiveRectangles(ActiveRegion):
    """A rectangle for each contact of a batch, as a mask on the whole grid."""

    inside: PointMask
    """The points of every contact's rectangle, (batch, rows, cols)."""
    operators: DisplacementOperators
    """The operators whose mask is `inside` as numbers."""

    @property
    def whole_grid_operators(self) -> DisplacementOperators:
        """The operators without the mask."""
        return replace(self.operators, inside=None)

    def crop(self, field: Any) -> Any:
        """Return a field, zero outside each contact's rectangle."""
        inside = self.operators.inside
        return field * (inside if field.ndim == inside.ndim else inside[:, None])

    def crop_overlap(self, overlap_mm: ScalarField) -> Any:
        """Return the overlap, without an object outside each contact's rectangle."""
        return array_namespace_of(overlap_mm).where(self.inside, overlap_mm, -NO_OBJECT_MM)

    def embed(self, field: Any) -> Any:
        """Return the field, which is one of the whole grid already."""
        return field

    def any_outside(self, points: PointMask) -> Bool[Any, " batch"]:
        """Return for each contact whether it has one of these points outside its rectangle."""
        return array_namespace_of(points).any(points & ~self.inside, axis=(1, 2))


def whole_grid_rectangle(shape: tuple[int, int]) -> GridRectangle:
    """Return the rectangle that covers a grid of this shape."""
    return GridRectangle(slice(0, shape[0]), slice(0, shape[1]))


def whole_grid_region(skin: Skin) -> SharedActiveRectangle:
    """Return the region that is the whole periodic grid."""
    return SharedActiveRectangle(whole_grid_rectangle(skin.grid.shape), skin, skin.operators)


def find_touchable_region(skin: Skin, overlap_mm: ScalarField) -> SharedActiveRectangle:
    """Return the region in which objects with these overlaps can touch; one for all contacts of a batch."""
    return region_of_rectangle(skin, rectangle_around_points(_near_object(overlap_mm)))


def rectangle_around_points(points: PointMask) -> GridRectangle:
    """Return the rectangle around these points of all contacts of a batch; the whole grid where there are none."""
    near = to_numpy(array_namespace_of(points).any(points, axis=tuple(range(points.ndim - 2)))) > 0
    return _rectangle_around(near.any(axis=1), near.any(axis=0), (near.shape[0], near.shape[1]))


def region_of_rectangle(skin: Skin, rectangle: GridRectangle) -> SharedActiveRectangle:
    """Return the region of a rectangle, for all contacts of a batch."""
    if rectangle.shape == skin.grid.shape:
        return whole_grid_region(skin)
    return SharedActiveRectangle(rectangle, skin, skin.cropped_operators(*rectangle.shape))


def rectangle_around_both(one: GridRectangle, other: GridRectangle, shape: tuple[int, int]) -> GridRectangle:
    """Return the rectangle around two rectangles of a grid of this shape, rounded up as all are."""
    near_rows, near_cols = (np.zeros(points, bool) for points in shape)
    for rectangle in (one, other):
        near_rows[rectangle.rows], near_cols[rectangle.cols] = True, True
    return _rectangle_around(near_rows, near_cols, shape)


def find_active_rectangles(overlap_mm: Float[Any, "batch rows cols"]) -> list[GridRectangle]:
    """Return for each contact of a batch the rectangle that `find_touchable_region` chooses for it alone."""
    near = _near_object(overlap_mm)
    xp, shape = array_namespace_of(near), (near.shape[1], near.shape[2])
    by_row, by_col = (to_numpy(xp.any(near, axis=axis)) > 0 for axis in (2, 1))
    return [_rectangle_around(rows, cols, shape) for rows, cols in zip(by_row, by_col, strict=True)]


def points_inside_rectangles(rectangles: Sequence[GridRectangle], field: Any) -> Bool[Any, "batch rows cols"]:
    """Return the points of each rectangle, in the array library, shape and device of a field."""
    xp = array_namespace_of(field)
    sides = []
    for name, points in (("rows", field.shape[-2]), ("cols", field.shape[-1])):
        ends = np.array([(getattr(one, name).start, getattr(one, name).stop) for one in rectangles])
        indices = np.arange(points)
        sides.append((indices >= ends[:, :1]) & (indices < ends[:, 1:]))
    by_row, by_col = (xp.asarray(side, device=device(field)) for side in sides)
    return by_row[:, :, None] & by_col[:, None, :]


def _near_object(overlap_mm: ScalarField) -> PointMask:
    """Return the points where the skin may touch the object; none where the object reaches no skin."""
    deepest = max_over_grid(overlap_mm)
    return (overlap_mm > -_CLEARANCE * deepest) & (deepest > 0)


def _rectangle_around(near_rows: Any, near_cols: Any, shape: tuple[int, int]) -> GridRectangle:
    """Return the rectangle around these rows and columns; the whole grid where there are none."""
    if not near_rows.any():
        return whole_grid_rectangle(shape)
    return GridRectangle(*(_interval_around(*side) for side in zip((near_rows, near_cols), shape, strict=True)))


def _interval_around(near: Any, points: int) -> slice:
    """Return the interval from the first to the last near point, lengthened to a rounded length that fits into all points."""
    first, last = np.flatnonzero(near)[[0, -1]]
    length = min(-(-(last + 1 - first) // _SIZE_STEP) * _SIZE_STEP, points)
    start = min(max(first - (length - (last + 1 - first)) // 2, 0), points - length)
    return slice(int(start), int(start + length))

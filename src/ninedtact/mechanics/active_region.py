"""The part of the patch where a contact may be: all solving happens there."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import device

from ninedtact.mechanics.array_namespace import array_namespace_of, to_numpy
from ninedtact.mechanics.batching import max_over_grid
from ninedtact.mechanics.skin import DisplacementOperators, PointMask, ScalarField, Skin

_REGION_STEP = 8
"""Windows grow by this many points, so that few kinds of them are made."""
REGION_CLEARANCE = 0.3
"""Skin may bulge up to an underside that stands clear by less than this part of the deepest overlap: bulges of balls and
edges reach 0.15 to 0.2 of it, before a long drag. Where they reach farther, `ContactModel` sees it and takes the whole patch."""


@dataclass(frozen=True)
class ActiveRegion:
    """Rows and columns of a patch, with the operators for them."""

    rows: slice
    cols: slice
    patch_shape: tuple[int, int]
    response: DisplacementOperators

    def cut(self, field: Any) -> Any:
        """The window's part of a field of the patch."""
        return field[..., self.rows, self.cols]

    def put(self, field: Any) -> Any:
        """A field of the window in one of the patch, zero elsewhere."""
        if field.shape[-2:] == self.patch_shape:
            return field
        xp = array_namespace_of(field)
        whole = xp.zeros((*field.shape[:-2], *self.patch_shape), dtype=field.dtype, device=device(field))
        whole[..., self.rows, self.cols] = field
        return whole

    def holds(self, points: PointMask) -> bool:
        """Whether all these points of the patch are in the window."""
        return int(points.sum()) == int(self.cut(points).sum())


def whole_grid_region(skin: Skin) -> ActiveRegion:
    """The window that is the patch."""
    rows, cols = skin.patch.shape
    return ActiveRegion(slice(0, rows), slice(0, cols), skin.patch.shape, skin.response)


def find_active_region(skin: Skin, overlap_mm: ScalarField) -> ActiveRegion:
    """The window in which objects with these overlaps can touch; one for all contacts of a batch.

    Contacts wider than half the patch get the whole patch: a window would cost more.
    """
    deepest = max_over_grid(overlap_mm)
    near = to_numpy(_any_contact((overlap_mm > -REGION_CLEARANCE * deepest) & (deepest > 0)))
    rows, cols = (
        active_interval(near.any(axis=axis), points) for axis, points in zip((1, 0), skin.patch.shape, strict=True)
    )
    if rows is None or cols is None:
        return whole_grid_region(skin)
    return ActiveRegion(rows, cols, skin.patch.shape, skin.window(rows.stop - rows.start, cols.stop - cols.start))


def _any_contact(points: PointMask) -> Any:
    """Where it holds for any contact of a batch."""
    return array_namespace_of(points).any(points, axis=tuple(range(points.ndim - 2)))


def active_interval(near: Any, points: int) -> slice | None:
    """From the first to the last point that is near, lengthened to a rounded length; None for more than half of all."""
    if not near.any():
        return None
    first, last = np.flatnonzero(near)[[0, -1]]
    length = -(-(last + 1 - first) // _REGION_STEP) * _REGION_STEP
    if 2 * length > points:
        return None
    start = min(max(first - (length - (last + 1 - first)) // 2, 0), points - length)
    return slice(int(start), int(start + length))

"""The part of the patch where a contact may be: all solving happens there."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import device

from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.per_contact import largest, on_cpu
from ninedtact.mechanics.response import Field, Points, Response
from ninedtact.mechanics.skin import Skin

COARSENESS = 8
"""Windows grow by this many points, so that few kinds of them are made."""
CLEARANCE = 0.3
"""Skin may bulge up to an underside that stands clear by less than this part of the deepest overlap: bulges of balls and
edges reach 0.15 to 0.2 of it, before a long drag. Where they reach farther, `ContactModel` sees it and takes the whole patch."""


@dataclass(frozen=True)
class Window:
    """Rows and columns of a patch, with the operators for them."""

    rows: slice
    cols: slice
    patch_shape: tuple[int, int]
    response: Response

    def cut(self, field: Any) -> Any:
        """The window's part of a field of the patch."""
        return field[..., self.rows, self.cols]

    def put(self, field: Any) -> Any:
        """A field of the window in one of the patch, zero elsewhere."""
        if field.shape[-2:] == self.patch_shape:
            return field
        xp = library_of(field)
        whole = xp.zeros((*field.shape[:-2], *self.patch_shape), dtype=field.dtype, device=device(field))
        whole[..., self.rows, self.cols] = field
        return whole

    def holds(self, points: Points) -> bool:
        """Whether all these points of the patch are in the window."""
        return int(points.sum()) == int(self.cut(points).sum())


def whole_patch(skin: Skin) -> Window:
    """The window that is the patch."""
    rows, cols = skin.patch.shape
    return Window(slice(0, rows), slice(0, cols), skin.patch.shape, skin.response)


def window_around(skin: Skin, overlap_mm: Field) -> Window:
    """The window in which objects with these overlaps can touch; one for all contacts of a batch.

    Contacts wider than half the patch get the whole patch: a window would cost more.
    """
    deepest = largest(overlap_mm)
    near = on_cpu(any_contact((overlap_mm > -CLEARANCE * deepest) & (deepest > 0)))
    rows, cols = (stretch(near.any(axis=axis), points) for axis, points in zip((1, 0), skin.patch.shape, strict=True))
    if rows is None or cols is None:
        return whole_patch(skin)
    return Window(rows, cols, skin.patch.shape, skin.window(rows.stop - rows.start, cols.stop - cols.start))


def any_contact(points: Points) -> Any:
    """Where it holds for any contact of a batch."""
    return library_of(points).any(points, axis=tuple(range(points.ndim - 2)))


def stretch(near: Any, points: int) -> slice | None:
    """From the first to the last point that is near, lengthened to a rounded length; None for more than half of all."""
    if not near.any():
        return None
    first, last = np.flatnonzero(near)[[0, -1]]
    length = -(-(last + 1 - first) // COARSENESS) * COARSENESS
    if 2 * length > points:
        return None
    start = min(max(first - (length - (last + 1 - first)) // 2, 0), points - length)
    return slice(int(start), int(start + length))

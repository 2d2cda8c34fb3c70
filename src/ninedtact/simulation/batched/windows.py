"""Where on the patch each contact of a batch may be.

Windows are those that `mechanics.window` chooses for one contact. Here they are no cut-out grids: contacts are solved on the
whole patch, and what lies outside a contact's own window is kept at zero, so that all windows are one batch.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Bool, Float

from ninedtact.mechanics.active_region import REGION_CLEARANCE, active_interval
from ninedtact.mechanics.array_namespace import array_namespace_of, to_numpy
from ninedtact.mechanics.batching import max_over_grid

Shape = tuple[int, int]


@dataclass(frozen=True)
class Rectangle:
    """Rows and columns of a patch."""

    rows: slice
    cols: slice

    @property
    def shape(self) -> Shape:
        """(rows, cols)"""
        return self.rows.stop - self.rows.start, self.cols.stop - self.cols.start


def whole(shape: Shape) -> Rectangle:
    """The patch."""
    return Rectangle(slice(0, shape[0]), slice(0, shape[1]))


def windows_around(overlap_mm: Float[Any, "batch rows cols"]) -> list[Rectangle]:
    """Of each contact, where its object can touch: as `mechanics.window.window_around` says of it alone."""
    xp, deepest = array_namespace_of(overlap_mm), max_over_grid(overlap_mm)
    near = (overlap_mm > -REGION_CLEARANCE * deepest) & (deepest > 0)
    shape = near.shape[1], near.shape[2]
    by_row, by_col = (to_numpy(xp.any(near, axis=axis)) > 0 for axis in (2, 1))
    return [rectangle(rows, cols, shape) for rows, cols in zip(by_row, by_col, strict=True)]


def rectangle(rows: Any, cols: Any, shape: Shape) -> Rectangle:
    """Around the rows and columns that are near; the patch where there are none, or too many."""
    down, across = (active_interval(near, points) for near, points in zip((rows, cols), shape, strict=True))
    return whole(shape) if down is None or across is None else Rectangle(down, across)


def inside(rectangles: Sequence[Rectangle], field: Any) -> Bool[Any, "batch rows cols"]:
    """The points of each contact's rectangle, where `field` is."""
    xp = array_namespace_of(field)
    sides = []
    for name, points in (("rows", field.shape[-2]), ("cols", field.shape[-1])):
        ends = np.array([(getattr(one, name).start, getattr(one, name).stop) for one in rectangles])
        places = np.arange(points)
        sides.append((places >= ends[:, :1]) & (places < ends[:, 1:]))
    by_row, by_col = (xp.asarray(side, device=device(field)) for side in sides)
    return by_row[:, :, None] & by_col[:, None, :]

"""An underside given as a table of heights: what generated objects and meshes become.

The table is a square grid, (rows, cols) along (y, x), centred on the object's origin as every grid of this package: the
middle of n samples is index (n − 1)/2. `indenter_from_heights` puts the origin in the middle of the footprint, so that twists turn
about it, at the height of the lowest point, wherever that is. Between two samples heights are bilinear, so the wall at the end of
the object rises within one pitch, to `NO_OBJECT_MM`.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import require_positive
from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import NO_OBJECT_MM, Heights, Indenter


class InvalidUnderside(InputError):
    """A table of heights that no object has."""


@dataclass(frozen=True, eq=False)
class HeightGridIndenter(Indenter):
    """An underside as a table; equal to itself alone, so that it is cheap to pass, to hash and to compare."""

    name: str
    table_mm: Float[Array, "rows cols"]
    """Heights from zero, which is reached, to `NO_OBJECT_MM`."""
    pitch_mm: float

    def __post_init__(self) -> None:
        require_positive("relief.pitch_mm", self.pitch_mm)
        if self.table_mm.size == 0 or self.table_mm.min() != 0 or not self.table_mm.max() <= NO_OBJECT_MM:
            raise InvalidUnderside(
                f"expected heights of {self.name} from 0 to {NO_OBJECT_MM:g} mm, got a table of {self.table_mm.shape} that is "
                f"empty, not finite or out of that range; make it with relief_of"
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """(x, y) of the rectangle around the footprint."""
        rows, cols = self.table_mm.shape
        return cols * self.pitch_mm, rows * self.pitch_mm

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Bilinear between samples, nothing beyond the table."""
        xp = array_namespace(x_mm)
        table, (rows, cols) = framed_heights(self, xp, x_mm.dtype, device(x_mm)), self.table_mm.shape
        row, down = _grid_cell(xp, y_mm, self.pitch_mm, rows)
        col, along = _grid_cell(xp, x_mm, self.pitch_mm, cols)
        first = xp.astype(row * (cols + 2) + col, xp.int64)
        upper, upper_right, lower, lower_right = (
            take_entries(xp, table, first + step) for step in (0, 1, cols + 2, cols + 3)
        )
        upper, lower = upper + along * (upper_right - upper), lower + along * (lower_right - lower)
        return upper + down * (lower - upper)


def _grid_cell(xp: Any, place_mm: Any, pitch_mm: float, samples: int) -> tuple[Any, Any]:
    """The cell of the framed table along one axis, and the place in it from 0 to 1."""
    index = place_mm * (1 / pitch_mm) + (samples + 1) / 2
    first = xp.clip(xp.floor(index), 0.0, float(samples))
    return first, xp.clip(index - first, 0.0, 1.0)


def take_entries(xp: Any, table: Any, index: Any) -> Any:
    """Entries of a flat table, in the shape of the index."""
    return xp.reshape(xp.take(table, xp.reshape(index, (-1,)), axis=0), index.shape)


@lru_cache(maxsize=64)
def framed_heights(relief: HeightGridIndenter, xp: Any, dtype: Any, where: Any) -> Any:
    """The table with a frame of nothing, flat, in the library, precision and place that the look-up needs."""
    table = np.pad(relief.table_mm, 1, constant_values=NO_OBJECT_MM)
    return xp.asarray(table.ravel(), dtype=dtype, device=where)


def indenter_from_heights(name: str, heights_mm: Float[Array, "rows cols"], pitch_mm: float) -> HeightGridIndenter:
    """Heights on a grid, infinite or not-a-number where there is no object, as an underside.

    Lowered until the lowest point touches the plane, and cut to the footprint. Raises `InvalidUnderside` for a table
    without any object.
    """
    seen = np.isfinite(heights_mm)
    if not seen.any():
        raise InvalidUnderside(f"expected an underside of {name}, got a table with nothing in it; give another object")
    lowest = heights_mm[seen].min()
    heights = np.where(seen, np.minimum(heights_mm - lowest, NO_OBJECT_MM), NO_OBJECT_MM)
    rows, cols = (np.flatnonzero((heights < NO_OBJECT_MM).any(axis=axis)) for axis in (1, 0))
    return HeightGridIndenter(name, heights[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1], pitch_mm)

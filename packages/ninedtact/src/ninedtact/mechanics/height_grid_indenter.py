"""Indenters sampled on a grid of heights, as generated objects and meshes are; and batches of different objects.

The heights are a square grid, (rows, cols) along (y, x), centred on the object's origin as every grid of this package: the
middle of n samples is index (n − 1)/2. `indenter_from_heights` puts the origin in the middle of the footprint, so that twists turn
about it, at the height of the lowest point, wherever that is. Heights between samples are bilinear, so the wall at the end of
the object rises within one pitch, to `NO_OBJECT_MM`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import array_namespace, device
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import require_positive
from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import NO_OBJECT_MM, Heights, Indenter
from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of, expand_over_grid

_MAX_STORED_GRIDS = 512
"""Largest number of height grids kept on a device; when there are more, all are dropped."""


@dataclass(frozen=True, eq=False)
class HeightGridIndenter(Indenter):
    """An underside as a grid of heights. Instances compare by identity, so that they are cheap to hash and to compare."""

    name: str
    heights_mm: Float[Array, "rows cols"]
    """Heights above the lowest point, from zero, which occurs, to `NO_OBJECT_MM`."""
    pitch_mm: float

    def __post_init__(self) -> None:
        require_positive("height_grid_indenter.pitch_mm", self.pitch_mm)
        heights = self.heights_mm
        if heights.size == 0 or heights.min() != 0 or not heights.max() <= NO_OBJECT_MM:
            raise InputError(
                expected=f"heights of {self.name} from 0 to {NO_OBJECT_MM:g} mm",
                got=f"a grid of {heights.shape} that is empty, not finite or out of that range",
                remedy="make it with indenter_from_heights",
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """The (x, y) extent of the rectangle around the footprint."""
        rows, cols = self.heights_mm.shape
        return cols * self.pitch_mm, rows * self.pitch_mm

    @property
    def half_size_mm(self) -> tuple[float, float]:
        """Half the extent of the rectangle around the footprint and the wall at its end."""
        x_mm, y_mm = self.size_mm
        return (x_mm + self.pitch_mm) / 2, (y_mm + self.pitch_mm) / 2

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the bilinear height at (x, y); no object beyond the grid."""
        xp, (rows, cols) = array_namespace(x_mm), self.heights_mm.shape
        flat = _framed_heights(self, xp, x_mm.dtype, device(x_mm))
        return _bilinear_height(xp, flat, x_mm, y_mm, 1 / self.pitch_mm, rows, cols)


def indenter_from_heights(name: str, heights_mm: Float[Array, "rows cols"], pitch_mm: float) -> HeightGridIndenter:
    """Return an indenter with these heights, infinite or not-a-number where there is no object.

    The heights are lowered until the lowest point touches the plane, and cut to the footprint. Raises `InputError` where
    there is no object at all.
    """
    finite = np.isfinite(heights_mm)
    if not finite.any():
        raise InputError(
            expected=f"an underside of {name}", got="a grid of heights without an object", remedy="give another object"
        )
    lowest = heights_mm[finite].min()
    heights = np.where(finite, np.minimum(heights_mm - lowest, NO_OBJECT_MM), NO_OBJECT_MM)
    rows, cols = (np.flatnonzero((heights < NO_OBJECT_MM).any(axis=axis)) for axis in (1, 0))
    return HeightGridIndenter(name, heights[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1], pitch_mm)


@dataclass
class DeviceHeightGrids:
    """The height grids of the objects used so far, concatenated in one array of a device; makes batches of objects."""

    like: Any
    """The stored heights have the array library, precision and device of this array."""
    start_index: dict[HeightGridIndenter, int] = field(default_factory=dict)
    flat_mm: Any = None
    """All framed grids one after another; None before the first."""

    def batch(self, indenters: Sequence[Indenter]) -> "IndenterBatch":
        """Return one object for each contact of a batch; grids that are not yet on the device are stored."""
        grids = {indenter for indenter in indenters if isinstance(indenter, HeightGridIndenter)}
        if len(self.start_index) + len(grids) > _MAX_STORED_GRIDS:
            self.start_index, self.flat_mm = {}, None
        for indenter in indenters:
            if isinstance(indenter, HeightGridIndenter) and indenter not in self.start_index:
                self._append(indenter)
        return IndenterBatch(tuple(indenters), self)

    def _append(self, indenter: HeightGridIndenter) -> None:
        """Store one more grid at the end."""
        xp = array_namespace_of(self.like)
        heights = _framed_heights(indenter, xp, self.like.dtype, device(self.like))
        self.start_index[indenter] = 0 if self.flat_mm is None else self.flat_mm.shape[0]
        self.flat_mm = heights if self.flat_mm is None else xp.concat((self.flat_mm, heights))


@dataclass(frozen=True)
class IndenterBatch(Indenter):
    """Different objects as one indenter: the k-th contact of a batch meets the k-th object."""

    indenters: tuple[Indenter, ...]
    store: DeviceHeightGrids

    @property
    def name(self) -> str:  # type: ignore[override]
        """The names of all objects, joined by commas."""
        return ", ".join(indenter.name for indenter in self.indenters)

    @property
    def half_size_mm(self) -> tuple[float, float]:
        """That of the largest object along each axis."""
        x_mm, y_mm = (max(one.half_size_mm[axis] for one in self.indenters) for axis in (0, 1))
        return x_mm, y_mm

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the undersides of all objects, (batch, rows, cols), each at its own positions."""
        groups = self._similar_objects()
        if len(groups) == 1:
            return self._underside_of_group_mm(groups[0], x_mm, y_mm)
        xp, parts = array_namespace_of(x_mm), []
        for group in groups:
            indices = xp.asarray(group, device=device(x_mm))
            x, y = xp.take(x_mm, indices, axis=0), xp.take(y_mm, indices, axis=0)
            parts.append(self._underside_of_group_mm(group, x, y))
        back = np.argsort(np.concatenate(groups))
        return xp.take(xp.concat(parts), xp.asarray(back, device=device(x_mm)), axis=0)

    def _similar_objects(self) -> list[list[int]]:
        """Return the indices of objects that are evaluated in one call: all height grids, and equal primitives."""
        groups: dict[Any, list[int]] = {}
        for index, indenter in enumerate(self.indenters):
            kind = HeightGridIndenter if isinstance(indenter, HeightGridIndenter) else indenter
            groups.setdefault(kind, []).append(index)
        return list(groups.values())

    def _underside_of_group_mm(self, group: list[int], x_mm: Heights, y_mm: Heights) -> Heights:
        """Return the undersides of one group of similar objects, (group, rows, cols)."""
        grids = [one for index in group if isinstance(one := self.indenters[index], HeightGridIndenter)]
        if not grids:
            return self.indenters[group[0]].underside_mm(x_mm, y_mm)
        xp = array_namespace_of(x_mm)
        rows, cols = (
            expand_over_grid(np.array([one.heights_mm.shape[axis] for one in grids], float), x_mm) for axis in (0, 1)
        )
        per_mm = expand_over_grid(np.array([1 / one.pitch_mm for one in grids]), x_mm)
        start = np.array([self.store.start_index[one] for one in grids])[:, None, None]
        start = xp.asarray(start, device=device(x_mm))
        return _bilinear_height(xp, self.store.flat_mm, x_mm, y_mm, per_mm, rows, cols, start)


def _bilinear_height(
    xp: Any, flat_mm: Any, x_mm: Any, y_mm: Any, per_mm: Any, rows: Any, cols: Any, start: Any = None
) -> Any:
    """Return heights between the samples of framed grids that are stored flat.

    per_mm: samples per mm; rows, cols: of the grid without its frame; start: where it begins in `flat_mm`, None for the beginning.
    All are numbers, or arrays (batch, 1, 1).
    """
    row, down = _grid_cell(xp, y_mm, per_mm, rows)
    col, along = _grid_cell(xp, x_mm, per_mm, cols)
    stride = cols + 2 if isinstance(cols, int) else xp.astype(cols + 2, xp.int64)
    first = xp.astype(row * (cols + 2) + col, xp.int64)
    first = first if start is None else first + start
    upper, upper_right, lower, lower_right = (
        xp.reshape(xp.take(flat_mm, xp.reshape(first + step, (-1,)), axis=0), first.shape)
        for step in (0, 1, stride, stride + 1)
    )
    upper, lower = upper + along * (upper_right - upper), lower + along * (lower_right - lower)
    return upper + down * (lower - upper)


def _grid_cell(xp: Any, position_mm: Any, per_mm: Any, samples: Any) -> tuple[Any, Any]:
    """Return the cell of the framed grid along one axis, and the position in it from 0 to 1."""
    index = position_mm * per_mm + (samples + 1) / 2
    # Not `clip`, which costs ten times as much in array_api_compat.
    zero = 0 * index
    last = zero + samples
    first = xp.minimum(xp.maximum(xp.floor(index), zero), last)
    return first, xp.minimum(xp.maximum(index - first, zero), zero + 1)


@lru_cache(maxsize=64)
def _framed_heights(indenter: HeightGridIndenter, xp: Any, dtype: Any, where: Any) -> Any:
    """Return the heights with a frame of no object, flat, in this library and precision and on this device."""
    heights = np.pad(indenter.heights_mm, 1, constant_values=NO_OBJECT_MM)
    return xp.asarray(heights.ravel(), dtype=dtype, device=where)

"""Several objects, each over its own contact: one look-up for all that are tables of heights, whatever their sizes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from array_api_compat import device

from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.mechanics.batching import expand_over_grid
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter, framed_heights, take_entries
from ninedtact.mechanics.indenter import Heights, Indenter

KEPT = 512
"""Tables on the device; when there are more, all are put down."""


@dataclass
class Shelf:
    """The tables of all objects that came so far, one behind the other in one array of a device."""

    like: Any
    begins: dict[HeightGridIndenter, int] = field(default_factory=dict)
    flat: Any = None

    def several(self, indenters: Sequence[Indenter]) -> "Several":
        """Objects side by side; the tables that are new are put on the shelf."""
        reliefs = {indenter for indenter in indenters if isinstance(indenter, HeightGridIndenter)}
        if len(self.begins) + len(reliefs) > KEPT:
            self.begins, self.flat = {}, None
        for relief in indenters:
            if isinstance(relief, HeightGridIndenter) and relief not in self.begins:
                self.put(relief)
        return Several(tuple(indenters), self)

    def put(self, relief: HeightGridIndenter) -> None:
        """One more at the end."""
        xp = array_namespace_of(self.like)
        table = framed_heights(relief, xp, self.like.dtype, device(self.like))
        self.begins[relief] = 0 if self.flat is None else self.flat.shape[0]
        self.flat = table if self.flat is None else xp.concat((self.flat, table))


@dataclass(frozen=True)
class Several(Indenter):
    """Objects side by side: places of the k-th contact of a batch are asked of the k-th."""

    indenters: tuple[Indenter, ...]
    shelf: Shelf

    @property
    def name(self) -> str:  # type: ignore[override]
        """All of them."""
        return ", ".join(indenter.name for indenter in self.indenters)

    def underside_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Each object's own."""
        groups = self.alike
        if len(groups) == 1:
            return self.of_alike(groups[0], x_mm, y_mm)
        xp, parts = array_namespace_of(x_mm), []
        for group in groups:
            which = xp.asarray(group, device=device(x_mm))
            parts.append(self.of_alike(group, xp.take(x_mm, which, axis=0), xp.take(y_mm, which, axis=0)))
        back = np.argsort(np.concatenate(groups))
        return xp.take(xp.concat(parts), xp.asarray(back, device=device(x_mm)), axis=0)

    @property
    def alike(self) -> list[list[int]]:
        """Numbers of those that are answered in one go: all tables, and each solid in closed form."""
        groups: dict[Any, list[int]] = {}
        for number, indenter in enumerate(self.indenters):
            groups.setdefault(HeightGridIndenter if isinstance(indenter, HeightGridIndenter) else indenter, []).append(
                number
            )
        return list(groups.values())

    def of_alike(self, group: list[int], x_mm: Heights, y_mm: Heights) -> Heights:
        """The undersides of one group, (group, rows, cols)."""
        first = self.indenters[group[0]]
        if not isinstance(first, HeightGridIndenter):
            return first.underside_mm(x_mm, y_mm)
        return self.looked_up(
            [relief for k in group if isinstance(relief := self.indenters[k], HeightGridIndenter)], x_mm, y_mm
        )

    def looked_up(self, reliefs: list[HeightGridIndenter], x_mm: Heights, y_mm: Heights) -> Heights:
        """As `Relief.underside_mm`, each in its own table."""
        xp = array_namespace_of(x_mm)
        rows, cols = (
            expand_over_grid(np.array([relief.table_mm.shape[axis] for relief in reliefs], float), x_mm)
            for axis in (0, 1)
        )
        finer = expand_over_grid(np.array([1 / relief.pitch_mm for relief in reliefs]), x_mm)
        begins = np.array([self.shelf.begins[relief] for relief in reliefs])[:, None, None]
        row, down = cell(y_mm, finer, rows)
        col, along = cell(x_mm, finer, cols)
        first = xp.astype(row * (cols + 2) + col, xp.int64) + xp.asarray(begins, device=device(x_mm))
        below = xp.astype(cols + 2, xp.int64)
        upper, upper_right, lower, lower_right = (
            take_entries(xp, self.shelf.flat, first + step) for step in (0, 1, below, below + 1)
        )
        upper, lower = upper + along * (upper_right - upper), lower + along * (lower_right - lower)
        return upper + down * (lower - upper)


def cell(place_mm: Any, per_mm: Any, samples: Any) -> tuple[Any, Any]:
    """The cell of each framed table along one axis, and the place in it from 0 to 1, as `mechanics.relief` has them."""
    xp, index = array_namespace_of(place_mm), place_mm * per_mm + (samples + 1) / 2
    first = xp.minimum(xp.clip(xp.floor(index), min=0.0), samples)
    return first, xp.clip(index - first, min=0.0, max=1.0)

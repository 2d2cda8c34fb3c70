"""The pairs of a data set that a training holds out to choose its best epoch by."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from ninedtact.bounds_and_checked_reading import require_within_bounds
from ninedtact.quantities import NO_OBJECT
from ninedtact_train.dataset.split import (
    Kind,
    SplitKeys,
    SplitRows,
    SplitSettings,
    read_split,
    split_dataset,
)


@dataclass(frozen=True)
class HeldOutSettings:
    """Which pairs are held out of the training; the best epoch is chosen by them. Raises `InputError`."""

    held_out: Kind | None = None
    """What is held out to choose the best epoch by. By default sensors and objects, or objects alone for data of one sensor."""
    held_out_fraction: Annotated[float, Meta(gt=0, lt=1)] = 0.1
    """Held-out part of the objects, of the sensors or of the pairs."""
    split: Path | None = None
    """Split file. Its test part is not used at all."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of the held-out pairs, and in a training of the initial weights, the order and the augmentation."""

    def __post_init__(self) -> None:
        require_within_bounds(self)

    def rows(
        self,
        ids: Sequence[str],
        objects: Sequence[str],
        sensors: Sequence[str],
        all_ids: Sequence[str] | None = None,
    ) -> SplitRows:
        """Return the rows for training and for validation; raises `InputError`, `FileFormatError`.

        all_ids: ids of the whole data set, which a split file is of, where some of its pairs are no examples.
        """
        train = np.arange(len(ids))
        if self.split is not None:
            split = read_split(self.split)
            split.rows(ids if all_ids is None else all_ids)
            train = np.flatnonzero(np.isin(np.asarray(ids, dtype=str), split.train))
        names, objects_kept, sensors_kept = (np.asarray(column)[train].tolist() for column in (ids, objects, sensors))
        settings = self._split_settings(set(objects_kept), set(sensors_kept), len(train))
        inner = split_dataset(SplitKeys(names, objects_kept, sensors_kept), settings).rows(names)
        return SplitRows(train[inner.train], train[inner.test])

    def _split_settings(self, objects: set[str], sensors: set[str], pairs: int) -> SplitSettings:
        """Return the settings of a split with this fraction of each, and one of each at least."""
        kind = self.held_out or ("sensor_and_object" if len(sensors) > 1 else "object")
        counts = [
            max(1, round(self.held_out_fraction * count)) for count in (len(objects - {NO_OBJECT}), len(sensors), pairs)
        ]
        return SplitSettings(kind, objects=counts[0], sensors=counts[1], pairs=counts[2], seed=self.seed)

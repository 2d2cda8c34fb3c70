"""Reader of a data set for training: names and wrenches in memory, images decoded once into memory-mapped files."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float32, Float64, Int, Int64, Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.errors import FileFormatError
from ninedtact.quantities import NO_OBJECT
from ninedtact_train.dataset.folder import REFERENCES_FILE, find_pair_files
from ninedtact_train.dataset.image_cache import DecodedImages, load_or_decode_images
from ninedtact_train.dataset.parquet_files import read_columns, wrench_array
from ninedtact_train.dataset.schema import PAIR_COLUMNS
from ninedtact_train.dataset.split import SplitKeys

_UNKNOWN_TIME = -1
_Index = Int[Array, " b"]


@dataclass(frozen=True)
class CategoricalColumn:
    """A column of names with few different values."""

    names: tuple[str, ...]
    codes: Int64[Array, " n"]
    """Index of every pair's name in `names`; −1 if it has none."""

    @property
    def values(self) -> Shaped[Array, " n"]:
        """The name of every pair; "" if it has none."""
        return np.array([*self.names, ""], dtype=np.str_)[self.codes]

    def __len__(self) -> int:
        return len(self.codes)

    def select(self, rows: Shaped[Array, " m"]) -> "CategoricalColumn":
        """Return the column of some pairs, by index or by mask."""
        return CategoricalColumn(self.names, self.codes[rows])


@dataclass(frozen=True)
class PairBatch:
    """Some pairs as arrays."""

    images: UInt8[Array, "b rows cols"]
    references: UInt8[Array, "b rows cols"]
    """The reference image (no contact) of every pair."""
    wrenches: Float32[Array, "b 6"]
    """Wrenches, N and N·m about the skin's centre."""
    indices: Int64[Array, " b"]
    """Indices of the pairs in the data set."""


@dataclass(frozen=True)
class TactileDataset:
    """The pairs of a data set in the order of its files. All wrenches are finite, and all pairs have a reference image.

    Arrays that methods return are copies.
    """

    folder: Path
    size: tuple[int, int]
    """Columns and rows of the images."""
    ids: Shaped[Array, " n"]
    wrenches: Float32[Array, "n 6"]
    """Wrenches, N and N·m about the skin's centre."""
    objects: CategoricalColumn
    contacts: CategoricalColumn
    sensors: CategoricalColumn
    kinds: CategoricalColumn
    sources: CategoricalColumn
    references: CategoricalColumn
    """Ids of the reference images, in the order of `decoded.references`."""
    times_ns: Int64[Array, " n"]
    """Time of every image; −1 if unknown."""
    mm_per_px: Float64[Array, " n"]
    """Scale of the images at this size along their columns; NaN if unknown."""
    rows: Int64[Array, " n"]
    """Row of every pair in `decoded.images`."""
    decoded: DecodedImages

    def __len__(self) -> int:
        return len(self.rows)

    def images(self, indices: _Index) -> UInt8[Array, "b rows cols"]:
        """Return the images of some pairs."""
        return np.asarray(self.decoded.images[self.rows[indices]])

    def reference_images(self, indices: _Index) -> UInt8[Array, "b rows cols"]:
        """Return the reference images (no contact) of some pairs."""
        return np.asarray(self.decoded.references[self.references.codes[indices]])

    def batch(self, indices: _Index) -> PairBatch:
        """Return the pairs of these indices as arrays."""
        wrenches = self.wrenches[indices]
        return PairBatch(self.images(indices), self.reference_images(indices), wrenches, np.asarray(indices, np.int64))

    def batches(self, pairs: int, rng: np.random.Generator | None = None) -> Iterator[PairBatch]:
        """Yield all pairs once in batches, shuffled if a generator is given; the last batch may be smaller."""
        order = np.arange(len(self)) if rng is None else rng.permutation(len(self))
        for at in range(0, len(self), pairs):
            yield self.batch(order[at : at + pairs])

    def select(self, indices: Shaped[Array, " m"]) -> "TactileDataset":
        """Return some pairs, by index or by mask, as a data set of the same files."""
        kept = np.arange(len(self))[indices]
        label_columns = ("objects", "contacts", "sensors", "kinds", "sources", "references")
        arrays = ("ids", "wrenches", "times_ns", "mm_per_px", "rows")
        selected: dict[str, Any] = {name: getattr(self, name).select(kept) for name in label_columns}
        return replace(self, **selected, **{name: getattr(self, name)[kept] for name in arrays})

    def to_split_pairs(self) -> SplitKeys:
        """Return the ids, objects, sensors and contacts by which `force.splits` divides the pairs."""
        labels = (self.objects, self.sensors, self.contacts)
        return SplitKeys(self.ids.tolist(), *(column.values.tolist() for column in labels))


def load_dataset(
    folder: Path | str,
    size: tuple[int, int] = (160, 120),
    cache: Path | None = None,
    threads: int = 1,
    *,
    progress: bool = False,
) -> TactileDataset:
    """Open a data set for training. At the first time with this size, its images are decoded into files beside it.

    Args:
        folder: the data set's folder, as `ninedtact dataset build` or `ninedtact simulate dataset` made it.
        size: columns and rows of the images. A smaller image contains means over the area of each pixel.
        cache: folder of the decoded images; `folder/cache` by default.
        threads: number of threads that decode images.
        progress: whether to show a progress bar while decoding.

    Raises `FileFormatError`, also for wrenches that are not finite and pairs without a reference image, and `InputError`.

    Example:
        >>> import numpy as np
        >>> from ninedtact_train.dataset import load_dataset
        >>> dataset = load_dataset("pairs", size=(32, 24))
        >>> pressed = dataset.select(dataset.kinds.values == "rule")
        >>> for batch in pressed.batches(8, np.random.default_rng(0)):
        ...     images, references, wrenches = batch.images, batch.references, batch.wrenches
        >>> images.shape[1:], wrenches.shape[1:]
        ((24, 32), (6,))

    """
    folder = Path(folder)
    table = read_pair_columns(folder)
    decoded = load_or_decode_images(folder, size, cache, threads, progress=progress)
    stored_cols = decoded.stored_shapes[:, 1].astype(float)
    stored_mm_per_px = table["mm_per_px"].cast(pa.float64()).fill_null(np.nan).to_numpy()
    return TactileDataset(
        folder,
        size,
        ids=np.array(table["id"].to_pylist(), dtype=np.str_),
        wrenches=wrench_array(table),
        objects=_label_column(table, "object"),
        contacts=_label_column(table, "contact_id"),
        sensors=_label_column(table, "sensor"),
        kinds=_label_column(table, "kind"),
        sources=_label_column(table, "source", missing=folder.resolve().name),
        references=_reference_column(folder, table),
        times_ns=table["time_ns"].fill_null(_UNKNOWN_TIME).to_numpy().astype(np.int64),
        mm_per_px=np.asarray(stored_mm_per_px * stored_cols / size[0]),
        rows=np.arange(len(stored_cols)),
        decoded=decoded,
    )


def read_pair_columns(folder: Path) -> Any:
    """Return all columns but the images as one Arrow table, in the order of the files.

    Raises `FileFormatError`, also for wrenches that are not finite and pairs without a reference image.
    """
    table = read_columns(find_pair_files(folder), [column.name for column in PAIR_COLUMNS if column.name != "image"])
    wrenches, references = wrench_array(table), _reference_column(folder, table)
    not_finite, alone = int((~np.isfinite(wrenches).all(1)).sum()), int((references.codes < 0).sum())
    if not_finite or alone or not len(wrenches):
        raise FileFormatError(
            expected=f"pairs with six finite numbers and a reference in {folder}",
            got=f"{len(wrenches)} pairs, {not_finite} not finite and {alone} without reference",
            remedy=f"leave those out: ninedtact dataset build --drop --out NEW {folder}",
        )
    return table


def read_name_column(table: Any, column: str, missing: str = "") -> list[str]:
    """Return a column of names as a list; an empty value becomes `missing`."""
    return [name or missing for name in table[column].to_pylist()]


def _label_column(table: Any, column: str, missing: str = "") -> CategoricalColumn:
    """Return a column of names with its sorted different values."""
    values = read_name_column(table, column, missing or (NO_OBJECT if column == "object" else ""))
    names, codes = np.unique(np.array(values, dtype=np.str_), return_inverse=True)
    return CategoricalColumn(tuple(names.tolist()), codes.astype(np.int64).ravel())


def _reference_column(folder: Path, table: Any) -> CategoricalColumn:
    """Return the reference ids of the pairs, in the order of the file of reference images."""
    ids: Sequence[str] = read_columns([folder / REFERENCES_FILE], ["reference_id"])["reference_id"].to_pylist()
    index = {name: number for number, name in enumerate(ids)}
    codes = [-1 if name is None else index.get(name, -1) for name in table["reference_id"].to_pylist()]
    return CategoricalColumn(tuple(ids), np.array(codes, np.int64))

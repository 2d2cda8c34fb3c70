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
_Names = Shaped[Array, " n"]


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
    ids: _Names
    wrenches: Float32[Array, "n 6"]
    """Wrenches, N and N·m about the skin's centre."""
    objects: _Names
    contacts: _Names
    sensors: _Names
    kinds: _Names
    sources: _Names
    reference_rows: Int64[Array, " n"]
    """Row of every pair's reference image in `decoded.references`."""
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
        return np.asarray(self.decoded.references[self.reference_rows[indices]])

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
        arrays = {name: value[indices] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)

    def to_split_pairs(self) -> SplitKeys:
        """Return the ids, objects, sensors and contacts by which `split_dataset` divides the pairs."""
        return SplitKeys(*(column.tolist() for column in (self.ids, self.objects, self.sensors, self.contacts)))


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
        >>> pressed = dataset.select(dataset.kinds == "rule")
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
        ids=read_name_column(table, "id"),
        wrenches=wrench_array(table),
        objects=read_name_column(table, "object", NO_OBJECT),
        contacts=read_name_column(table, "contact_id"),
        sensors=read_name_column(table, "sensor"),
        kinds=read_name_column(table, "kind"),
        sources=read_name_column(table, "source", folder.resolve().name),
        reference_rows=_reference_rows(folder, table),
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
    wrenches, references = wrench_array(table), _reference_rows(folder, table)
    not_finite, alone = int((~np.isfinite(wrenches).all(1)).sum()), int((references < 0).sum())
    if not_finite or alone or not len(wrenches):
        raise FileFormatError(
            expected=f"pairs with six finite numbers and a reference in {folder}",
            got=f"{len(wrenches)} pairs, {not_finite} not finite and {alone} without reference",
            remedy=f"leave those out: ninedtact dataset build --drop --out NEW {folder}",
        )
    return table


def read_name_column(table: Any, column: str, missing: str = "") -> Shaped[Array, " n"]:
    """Return a column of names; an empty value becomes `missing`."""
    return np.array([name or missing for name in table[column].to_pylist()], dtype=np.str_)


def _reference_rows(folder: Path, table: Any) -> Int64[Array, " n"]:
    """Return the row of each pair's reference image in the file of reference images, −1 where there is none."""
    ids: Sequence[str] = read_columns([folder / REFERENCES_FILE], ["reference_id"])["reference_id"].to_pylist()
    rows = {name: number for number, name in enumerate(ids)}
    return np.array([rows.get(name, -1) for name in table["reference_id"].to_pylist()], np.int64)

"""A data set in training: names and wrenches in memory, images on disk, decoded once.

    pairs = DataSet.open("pairs", size=(160, 120))
    batch = pairs.batch(indices)            # images, references, wrenches
    train = pairs.take(rows)                # some of them, the same files

Rows are in the order of the Parquet files. What is handed out is a copy.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int, Int64, Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.dataset.arrow import pa, pq
from ninedtact.dataset.columns import DataSetDamaged, damaged
from ninedtact.dataset.decoded import DecodedImages, decoded_images
from ninedtact.dataset.sources.table import NO_OBJECT, REFERENCES, TWINS_WIDTH_MM, pair_files
from ninedtact.force.splits import Pairs

NO_TIME = -1
Index = Int[Array, " b"]


@dataclass(frozen=True)
class Labels:
    """A name for every pair, of few different ones."""

    names: tuple[str, ...]
    codes: Int64[Array, " n"]
    """Places in `names`; −1 for none."""

    @property
    def each(self) -> Shaped[Array, " n"]:
        """The name of every pair; "" for none."""
        return np.array([*self.names, ""], dtype=np.str_)[self.codes]

    def __len__(self) -> int:
        return len(self.codes)

    def take(self, rows: Shaped[Array, " m"]) -> "Labels":
        """Of some pairs; the names stay."""
        return Labels(self.names, self.codes[rows])


@dataclass(frozen=True)
class Batch:
    """Some pairs, as numbers."""

    images: UInt8[Array, "b rows cols"]
    references: UInt8[Array, "b rows cols"]
    """The untouched image of each."""
    wrenches: Float32[Array, "b 6"]
    """N and N·m about the skin's centre."""
    indices: Int64[Array, " b"]
    """Where they are in the data set."""


@dataclass(frozen=True)
class DataSet:
    """Pairs for training. All finite, all with a reference."""

    folder: Path
    size: tuple[int, int]
    """Columns and rows of its images."""
    ids: Shaped[Array, " n"]
    wrenches: Float32[Array, "n 6"]
    """N and N·m about the skin's centre."""
    objects: Labels
    contacts: Labels
    sensors: Labels
    kinds: Labels
    sources: Labels
    references: Labels
    """Names in the order of `reference_images`."""
    times_ns: Int64[Array, " n"]
    """−1 where no time is known."""
    mm_per_px: Float64[Array, " n"]
    """Of the images at this size, along their columns; not a number where it is not known."""
    rows: Int64[Array, " n"]
    """Where the pairs are in the files."""
    files: DecodedImages

    @staticmethod
    def open(
        folder: Path | str,
        size: tuple[int, int] = (160, 120),
        cache: Path | None = None,
        threads: int = 1,
        *,
        progress: bool = False,
    ) -> "DataSet":
        """Read a data set; the first time at this size, its images are decoded (`decoded.decoded_images`).

        size: columns and rows. Raises `DataSetDamaged`, also for wrenches that are not numbers and pairs without a reference.
        """
        folder = Path(folder)
        table = columns_of(pair_files(folder))
        references = names_in(folder / REFERENCES)
        wrenches = six_of(table)
        codes = codes_in(references, table["reference"].to_pylist())
        require_whole(folder, wrenches, codes)
        files = decoded_images(folder, size, cache, threads, progress=progress)
        objects = [name or NO_OBJECT for name in words(table, "object")]
        return DataSet(
            folder,
            size,
            ids=np.array(ids_of(table), dtype=np.str_),
            wrenches=wrenches,
            objects=labels(objects),
            contacts=labels(words(table, "contact")),
            sensors=labels(words(table, "sensor")),
            kinds=labels(words(table, "kind")),
            sources=labels(words(table, "source")),
            references=Labels(tuple(references), codes),
            times_ns=times_of(table),
            mm_per_px=scale_of(table, files, size),
            rows=np.arange(len(wrenches)),
            files=files,
        )

    def __len__(self) -> int:
        return len(self.rows)

    def images(self, indices: Index) -> UInt8[Array, "b rows cols"]:
        """Some images."""
        return np.asarray(self.files.images[self.rows[indices]])

    def reference_images(self, indices: Index) -> UInt8[Array, "b rows cols"]:
        """The untouched images of some pairs."""
        return np.asarray(self.files.references[self.references.codes[indices]])

    def batch(self, indices: Index) -> Batch:
        """Some pairs."""
        return Batch(
            self.images(indices),
            self.reference_images(indices),
            self.wrenches[indices],
            np.asarray(indices, np.int64),
        )

    def named(self) -> Pairs:
        """What splits go by."""
        labelled = (self.objects, self.sensors, self.contacts)
        return Pairs(self.ids.tolist(), *(labels.each.tolist() for labels in labelled))

    def batches(self, pairs: int, rng: np.random.Generator | None = None) -> Iterator[Batch]:
        """All pairs once, so many at a time, shuffled where there is a generator; the last batch may be smaller."""
        order = np.arange(len(self)) if rng is None else rng.permutation(len(self))
        for at in range(0, len(self), pairs):
            yield self.batch(order[at : at + pairs])

    def take(self, indices: Shaped[Array, " m"]) -> "DataSet":
        """Some pairs (by index or by mask) as a data set of the same files."""
        kept = np.arange(len(self))[indices]
        names = ("objects", "contacts", "sensors", "kinds", "sources", "references")
        columns = ("ids", "wrenches", "times_ns", "mm_per_px", "rows")
        parts: dict[str, Any] = {name: getattr(self, name).take(kept) for name in names}
        return replace(self, **parts, **{name: getattr(self, name)[kept] for name in columns})


COLUMNS = ("wrench", "reference", "object", "contact", "sensor", "kind", "source", "time_ns", "mm_per_px", "id")


def columns_of(files: Iterable[Path]) -> Any:
    """All but the images, and where each row is; raises `DataSetDamaged`."""
    tables = []
    for file in files:
        try:
            present = [name for name in COLUMNS if name in pq.read_schema(file).names]
            table = pq.read_table(file, columns=present)
        except (pa.ArrowException, OSError) as trouble:
            raise damaged(file, trouble) from trouble
        begin = file.stem.split("-of-")[0]
        own_id = pa.array([f"{begin}-{number:05d}" for number in range(table.num_rows)], pa.string())
        own_source = pa.array([file.parents[1].name] * table.num_rows, pa.string())
        for name, column in (("own_id", own_id), ("own_source", own_source)):
            table = table.append_column(name, column)
        tables.append(table)
    return pa.concat_tables(tables, promote_options="default")


def words(table: Any, name: str) -> list[str]:
    """A column of names, "" where there is none."""
    if name not in table.column_names:
        return table["own_source"].to_pylist() if name == "source" else [""] * table.num_rows
    return [word or "" for word in table[name].to_pylist()]


def ids_of(table: Any) -> list[str]:
    """Its own ids, or else file and row."""
    own = table["own_id"].to_pylist()
    return [given or made for given, made in zip(words(table, "id"), own, strict=True)]


def six_of(table: Any) -> Float32[Array, "n 6"]:
    """The wrenches; not a number where there is none."""
    column = table["wrench"].combine_chunks()
    if column.null_count == 0 and pa.types.is_fixed_size_list(column.type):
        numbers = column.flatten().to_numpy(zero_copy_only=False)
    else:
        numbers = np.array([six or [np.nan] * 6 for six in column.to_pylist()])
    return np.array(numbers, np.float32).reshape(-1, 6)


def times_of(table: Any) -> Int64[Array, " n"]:
    """When each image was taken."""
    if "time_ns" not in table.column_names:
        return np.full(table.num_rows, NO_TIME, np.int64)
    return table["time_ns"].fill_null(NO_TIME).to_numpy().astype(np.int64)


def scale_of(table: Any, files: DecodedImages, size: tuple[int, int]) -> Float64[Array, " n"]:
    """mm per pixel at the size that was asked for."""
    stored_cols = files.stored[:, 1].astype(float)
    if "mm_per_px" in table.column_names:
        stored = table["mm_per_px"].cast(pa.float64()).fill_null(np.nan).to_numpy()
    else:
        stored = TWINS_WIDTH_MM / stored_cols
    return np.asarray(stored * stored_cols / size[0])


def labels(each: list[str]) -> Labels:
    """Names sorted, and which of them each pair has."""
    names, codes = np.unique(np.array(each, dtype=np.str_), return_inverse=True)
    return Labels(tuple(names.tolist()), codes.astype(np.int64).ravel())


def names_in(references: Path) -> list[str]:
    """Of the untouched images; raises `DataSetDamaged`."""
    try:
        return list(pq.read_table(references, columns=["reference"])["reference"].to_pylist())
    except (pa.ArrowException, OSError) as trouble:
        raise damaged(references, trouble) from trouble


def codes_in(names: list[str], each: list[str | None]) -> Int64[Array, " n"]:
    """Places of names in a list, −1 where they are not."""
    places = {name: number for number, name in enumerate(names)}
    return np.array([-1 if name is None else places.get(name, -1) for name in each], np.int64)


def require_whole(folder: Path, wrenches: Float32[Array, "n 6"], references: Int64[Array, " n"]) -> None:
    """Refuse pairs that nothing can be learnt from; raises `DataSetDamaged`."""
    odd, alone = int((~np.isfinite(wrenches).all(1)).sum()), int((references < 0).sum())
    if odd or alone or not len(wrenches):
        raise DataSetDamaged(
            f"expected pairs with six finite numbers and a reference in {folder}, got {len(wrenches)} pairs, {odd} not finite "
            f"and {alone} without reference; leave those out: ninedtact dataset build --drop --out NEW {folder}"
        )

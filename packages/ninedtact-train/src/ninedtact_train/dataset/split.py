"""Split of a data set into training and test pairs: at random, by object, by sensor, or by both; read from and written to JSON.

    standard            holds out pairs at random (the paper's: 10,000 of 100,417)
    object              holds out all pairs of some objects (the paper's: 18 of 175)
    sensor              holds out all pairs of some sensors
    sensor_and_object   tests on held-out objects on held-out sensors, trains on pairs with neither, and leaves out all others

Frames of one contact differ little, so a random split tests on pairs that are almost training pairs; `by_contact` keeps the pairs
of a contact together. Names are ranked by a hash of the seed and the name. The same data therefore give the same split, whatever
the order of their rows, the machine and the library versions. Pairs without contact (object `none`) have no object to hold out:
they follow their sensor, or are divided at random in the proportion of the objects.

A split file is JSON with one id a line, so that two splits can be compared by a text comparison.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from jaxtyping import Bool, Int, Shaped
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.atomic_write import write_file_atomically
from ninedtact.bounds import checks_arguments
from ninedtact.checked_reading import read_regular_file
from ninedtact.errors import FileFormatError, InputError
from ninedtact.quantities import NO_OBJECT

Kind = Literal["standard", "object", "sensor", "sensor_and_object"]
_What = Literal["pairs", "objects", "sensors"]
_Amount = int | float


@dataclass(frozen=True)
class SplitSettings:
    """Kind of a split, and how much is held out: each amount is a number (18) or a fraction between 0 and 1 (0.1)."""

    kind: Kind = "standard"
    pairs: _Amount = 10_000
    """Amount of pairs that `standard` holds out."""
    objects: _Amount = 18
    """Amount of objects that `object` and `sensor_and_object` hold out."""
    sensors: _Amount = 0.2
    """Amount of sensors that `sensor` and `sensor_and_object` hold out."""
    by_contact: bool = False
    """Whether `standard` holds out whole contacts, as many as make up the number of pairs."""
    seed: int = 0


@dataclass(frozen=True)
class SplitKeys:
    """Labels by which pairs are split: a unique id for every pair and, where known, its object, sensor and contact."""

    ids: Sequence[str]
    objects: Sequence[str] | None = None
    sensors: Sequence[str] | None = None
    contacts: Sequence[str] | None = None

    def __post_init__(self) -> None:
        if repeated := [name for name, count in Counter(self.ids).items() if count > 1]:
            raise InputError(
                expected="every id once", got=f"{repeated[0]!r} more often", remedy="give every pair an id of its own"
            )
        for what in ("objects", "sensors", "contacts"):
            column = getattr(self, what)
            if column is not None and len(column) != len(self.ids):
                raise InputError(
                    expected=f"{what} of {len(self.ids)} pairs", got=f"{len(column)}", remedy="give one for every id"
                )

    def column(self, what: Literal["objects", "sensors", "contacts"]) -> Shaped[Array, " n"]:
        """Return the labels of one kind as an array; raises `InputError` where they are not known."""
        column = getattr(self, what)
        if column is None:
            raise InputError(
                expected=f"the {what[:-1]} of every pair", got="none", remedy=f"give {what}, or split the standard way"
            )
        return np.asarray(column, dtype=str)


@dataclass(frozen=True)
class SplitRows:
    """Row indices of a split's training and test pairs in a data set."""

    train: Int[Array, " train"]
    test: Int[Array, " test"]


@dataclass(frozen=True)
class DatasetSplit:
    """Ids of the training and test pairs; every list is sorted. `write_split` and `read_split` store it."""

    settings: SplitSettings
    train: tuple[str, ...]
    test: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    held_out_objects: tuple[str, ...] = ()
    held_out_sensors: tuple[str, ...] = ()

    def rows(self, ids: Sequence[str]) -> SplitRows:
        """Return the rows of the training and test pairs in a data set with these ids.

        Raises `FileFormatError` unless the ids are exactly those of the split.
        """
        place = {name: row for row, name in enumerate(ids)}
        known = {*self.train, *self.test, *self.left_out}
        if len(place) != len(ids) or place.keys() != known:
            raise FileFormatError(
                expected=f"the {len(known)} pairs of the split",
                got=f"{_count_with_example(set(place) - known)} that it does not know, "
                f"{_count_with_example(known - set(place))} of its own missing, and {len(ids) - len(place)} "
                "ids repeated",
                remedy="give the data set that it was made from, or split again",
            )
        train, test = (np.array([place[name] for name in part], dtype=int) for part in (self.train, self.test))
        return SplitRows(train, test)


def split_dataset(pairs: SplitKeys, settings: SplitSettings = SplitSettings()) -> DatasetSplit:
    """Split pairs into training and test pairs.

    Raises `InputError` where a part would be empty, or where there are too few objects, sensors or pairs to choose from.
    """
    if len(pairs.ids) < 2:
        raise InputError(expected="at least 2 pairs to divide", got=f"{len(pairs.ids)}", remedy="record more")
    ids, kind = np.asarray(pairs.ids, dtype=str), settings.kind
    objects = _held_out_names(pairs, settings, "objects") if "object" in kind else ()
    sensors = _held_out_names(pairs, settings, "sensors") if "sensor" in kind else ()
    of_objects = _is_of_objects(pairs, objects, settings.seed) if objects else None
    of_sensors = np.isin(pairs.column("sensors"), sensors) if sensors else None
    if of_objects is not None and of_sensors is not None:
        # Pairs without contact have no object: their sensor alone decides, and none of them is left out.
        of_objects = np.where(pairs.column("objects") == NO_OBJECT, of_sensors, of_objects)
        is_test, is_train = of_sensors & of_objects, ~(of_sensors | of_objects)
    else:
        held = of_objects if of_objects is not None else of_sensors
        is_test = _is_of_random_pairs(pairs, settings) if held is None else held
        is_train = ~is_test
    for name, part in (("train", is_train), ("test", is_test)):
        if not part.any():
            raise InputError(
                expected=f"pairs to {name} with",
                got=f"none of {len(ids)} by the {kind} split",
                remedy="hold out other amounts, or take another seed",
            )
    train, test, rest = (tuple(sorted(ids[part].tolist())) for part in (is_train, is_test, ~(is_train | is_test)))
    return DatasetSplit(settings, train, test, rest, objects, sensors)


def _is_of_random_pairs(pairs: SplitKeys, settings: SplitSettings) -> Bool[Array, " n"]:
    """Return the mask of randomly chosen pairs, or of randomly chosen whole contacts up to the number of pairs."""
    missing = _held_out_count(settings.pairs, len(pairs.ids), "pairs")
    groups = pairs.column("contacts") if settings.by_contact else np.asarray(pairs.ids, dtype=str)
    sizes, held = Counter(groups.tolist()), []
    for name in _rank_by_hash(sizes, settings.seed, "pairs"):
        if missing <= 0:
            break
        held.append(name)
        missing -= sizes[name]
    return np.isin(groups, held)


def _is_of_objects(pairs: SplitKeys, held: Sequence[str], seed: int) -> Bool[Array, " n"]:
    """Return the mask of all pairs of these objects, and of the same fraction of the pairs without contact."""
    objects, ids = pairs.column("objects"), np.asarray(pairs.ids, dtype=str)
    untouched = _rank_by_hash(ids[objects == NO_OBJECT].tolist(), seed, "pairs")
    share = len(held) / len(set(objects.tolist()) - {NO_OBJECT})
    return np.isin(objects, held) | np.isin(ids, untouched[: round(share * len(untouched))])


def _held_out_names(pairs: SplitKeys, settings: SplitSettings, what: Literal["objects", "sensors"]) -> tuple[str, ...]:
    different = set(pairs.column(what).tolist()) - {NO_OBJECT}
    if len(different) < 2:
        raise InputError(
            expected=f"at least 2 different {what} to hold some out",
            got=f"{len(different)}",
            remedy=f"record more {what}, or split the standard way",
        )
    number = _held_out_count(getattr(settings, what), len(different), what)
    return tuple(sorted(_rank_by_hash(different, settings.seed, what)[:number]))


def _held_out_count(amount: _Amount, available: int, what: _What) -> int:
    """Return an amount as a whole number that leaves at least one item on each side; raises `InputError`."""
    number = round(amount * available) if 0 < amount < 1 else amount
    if not (0 < number < available and number == int(number)):
        raise InputError(
            expected=f"a number of {what} from 1 to {available - 1} or a part between 0 and 1",
            got=f"{amount} of {available}",
            remedy=f"hold out another amount, as {max(1, available // 10)}",
        )
    return int(number)


def _rank_by_hash(names: Iterable[str], seed: int, what: _What) -> list[str]:
    """Return names in a pseudo-random order that depends only on the seed, on `what`, and on each name itself."""
    return sorted(names, key=lambda name: (blake2b(f"{seed}/{what}/{name}".encode()).digest(), name))


def _count_with_example(names: set[str]) -> str:
    return f"{len(names)} (such as {min(names)!r})" if names else "0"


_SPLIT_FORMAT = 1


def write_split(path: Path | str, split: DatasetSplit) -> None:
    """Write a split file atomically; raises `FileNotWritten`."""
    table = {"format": _SPLIT_FORMAT, **asdict(split)}
    write_file_atomically(path, msgspec.json.format(msgspec.json.encode(table), indent=1), b"\n")


def read_split(path: Path | str) -> DatasetSplit:
    """Read and check a file that `write_split` wrote; raises `FileFormatError`."""
    try:
        content = read_regular_file(path)
        version = msgspec.json.decode(content, type=dict[str, object]).get("format")
        read = msgspec.json.decode(content, type=DatasetSplit)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as trouble:
        raise FileFormatError(
            f"expected a split in {path}, got: {trouble}; give a file that this program wrote, or split again"
        ) from trouble
    counts = Counter([*read.train, *read.test, *read.left_out])
    repeated = counts.total() - len(counts)
    if version != _SPLIT_FORMAT or not read.train or not read.test or repeated:
        raise FileFormatError(
            expected=f"a split in {path}, format {_SPLIT_FORMAT}, with pairs to train and to test, each once",
            got=f"format {version} with {len(read.train)} to train, {len(read.test)} to test and {repeated} repeated",
            remedy="split again",
        )
    return read


@checks_arguments
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

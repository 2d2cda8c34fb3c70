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
from functools import cached_property
from hashlib import blake2b
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Bool, Int, Shaped
from numpy import ndarray as Array

from ninedtact.atomic_write import write_file_atomically
from ninedtact.bounds_and_checked_reading import read_regular_file
from ninedtact.errors import FileFormatError, InputError
from ninedtact.quantities import NO_OBJECT

Kind = Literal["standard", "object", "sensor", "sensor_and_object"]
What = Literal["pairs", "objects", "sensors"]
Amount = int | float


@dataclass(frozen=True)
class SplitSettings:
    """Kind of a split, and how much is held out: each amount is a number (18) or a fraction between 0 and 1 (0.1)."""

    kind: Kind = "standard"
    pairs: Amount = 10_000
    """Amount of pairs that `standard` holds out."""
    objects: Amount = 18
    """Amount of objects that `object` and `sensor_and_object` hold out."""
    sensors: Amount = 0.2
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
                got=f"{count_with_example(set(place) - known)} that it does not know, "
                f"{count_with_example(known - set(place))} of its own missing, and {len(ids) - len(place)} "
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
    held = HeldOutSelection(pairs, settings)
    is_test, is_train = held.masks
    ids = np.asarray(pairs.ids, dtype=str)
    for name, part in (("train", is_train), ("test", is_test)):
        if not part.any():
            raise InputError(
                expected=f"pairs to {name} with",
                got=f"none of {len(ids)} by the {settings.kind} split",
                remedy="hold out other amounts, or take another seed",
            )
    train, test, rest = (tuple(sorted(ids[part].tolist())) for part in (is_train, is_test, ~(is_train | is_test)))
    return DatasetSplit(settings, train, test, rest, held.object_names, held.sensor_names)


@dataclass(frozen=True)
class HeldOutSelection:
    """Computes which of the pairs a split with these settings holds out."""

    pairs: SplitKeys
    settings: SplitSettings

    @property
    def masks(self) -> tuple[Bool[Array, " n"], Bool[Array, " n"]]:
        """Masks of the test pairs and of the training pairs."""
        if self.settings.kind == "sensor_and_object":
            # Pairs without contact have no object: their sensor alone decides, and none of them is left out.
            untouched = self.pairs.column("objects") == NO_OBJECT
            of_object = np.where(untouched, self.of_sensors, self.of_objects)
            return self.of_sensors & of_object, ~(self.of_sensors | of_object)
        kinds = {"standard": "of_pairs", "object": "of_objects", "sensor": "of_sensors"}
        held: Bool[Array, " n"] = getattr(self, kinds[self.settings.kind])
        return held, ~held

    @property
    def of_pairs(self) -> Bool[Array, " n"]:
        """Mask of randomly chosen pairs, or of randomly chosen whole contacts up to the number of pairs."""
        missing = held_out_count(self.settings.pairs, len(self.pairs.ids), "pairs")
        groups = self.pairs.column("contacts") if self.settings.by_contact else np.asarray(self.pairs.ids, dtype=str)
        sizes, held = Counter(groups.tolist()), []
        for name in rank_by_hash(sizes, self.settings.seed, "pairs"):
            if missing <= 0:
                break
            held.append(name)
            missing -= sizes[name]
        return np.isin(groups, held)

    @property
    def of_objects(self) -> Bool[Array, " n"]:
        """Mask of all pairs of the held-out objects, and of the same fraction of the pairs without contact."""
        objects, ids = self.pairs.column("objects"), np.asarray(self.pairs.ids, dtype=str)
        untouched = rank_by_hash(ids[objects == NO_OBJECT].tolist(), self.settings.seed, "pairs")
        share = len(self.object_names) / len(set(objects.tolist()) - {NO_OBJECT})
        return np.isin(objects, self.object_names) | np.isin(ids, untouched[: round(share * len(untouched))])

    @property
    def of_sensors(self) -> Bool[Array, " n"]:
        """Mask of all pairs of the held-out sensors."""
        return np.isin(self.pairs.column("sensors"), self.sensor_names)

    @cached_property
    def object_names(self) -> tuple[str, ...]:
        """Names of the held-out objects."""
        return self.chosen("objects") if "object" in self.settings.kind else ()

    @cached_property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the held-out sensors."""
        return self.chosen("sensors") if "sensor" in self.settings.kind else ()

    def chosen(self, what: Literal["objects", "sensors"]) -> tuple[str, ...]:
        """Return the sorted names of the objects or sensors to hold out; raises `InputError`."""
        different = set(self.pairs.column(what).tolist()) - {NO_OBJECT}
        if len(different) < 2:
            raise InputError(
                expected=f"at least 2 different {what} to hold some out",
                got=f"{len(different)}",
                remedy=f"record more {what}, or split the standard way",
            )
        number = held_out_count(getattr(self.settings, what), len(different), what)
        return tuple(sorted(rank_by_hash(different, self.settings.seed, what)[:number]))


def held_out_count(amount: Amount, available: int, what: What) -> int:
    """Return an amount as a whole number that leaves at least one item on each side; raises `InputError`."""
    number = round(amount * available) if 0 < amount < 1 else amount
    if not (0 < number < available and number == int(number)):
        raise InputError(
            expected=f"a number of {what} from 1 to {available - 1} or a part between 0 and 1",
            got=f"{amount} of {available}",
            remedy=f"hold out another amount, as {max(1, available // 10)}",
        )
    return int(number)


def rank_by_hash(names: Iterable[str], seed: int, what: What) -> list[str]:
    """Return names in a pseudo-random order that depends only on the seed, on `what`, and on each name itself."""
    return sorted(names, key=lambda name: (blake2b(f"{seed}/{what}/{name}".encode()).digest(), name))


def count_with_example(names: set[str]) -> str:
    """Return the number of names as text, with one of them as an example."""
    return f"{len(names)} (such as {min(names)!r})" if names else "0"


SPLIT_FORMAT = 1


def write_split(path: Path | str, split: DatasetSplit) -> None:
    """Write a split file atomically; raises `FileNotWritten`."""
    table = {"format": SPLIT_FORMAT, **asdict(split)}
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
    if version != SPLIT_FORMAT or not read.train or not read.test or repeated:
        raise FileFormatError(
            expected=f"a split in {path}, format {SPLIT_FORMAT}, with pairs to train and to test, each once",
            got=f"format {version} with {len(read.train)} to train, {len(read.test)} to test and {repeated} repeated",
            remedy="split again",
        )
    return read

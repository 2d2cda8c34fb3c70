"""Which pairs train a force model and which test it, decided by names.

    standard            pairs at random (the paper's: 10,000 of 100,417)
    object              all pairs of some objects (the paper's: 18 of 175)
    sensor              all pairs of some sensors
    sensor_and_object   test: held-out objects on held-out sensors; train: neither; what has one of both is left out

Frames of one contact differ little, so a random split tests on what it has nearly trained on: `by_contact` keeps the
pairs of a contact together. Names are ranked by a hash of the seed and themselves: the same data give the same split
whatever the order of their rows, the machine and the version of any library. Where nothing touches (object `none`) there is no
object to hold out: such pairs follow their sensor, or are divided at random in the proportion of the objects.

A split on disk: JSON, an id a line, so that two can be compared.
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
from ninedtact.errors import FileFormatError, InputError

Kind = Literal["standard", "object", "sensor", "sensor_and_object"]
What = Literal["pairs", "objects", "sensors"]
Amount = int | float
NO_OBJECT = "none"
"""Name of the object where nothing touches."""


class SplitImpossible(InputError):
    """A split that cannot be made of these data."""


class SplitUnfit(FileFormatError):
    """A stored split that is damaged, or belongs to other data."""


@dataclass(frozen=True)
class SplitSettings:
    """How to divide. An amount is a number (18) or a part between 0 and 1 (0.1)."""

    kind: Kind = "standard"
    pairs: Amount = 10_000
    """Held out by `standard`."""
    objects: Amount = 18
    """Held out by `object` and `sensor_and_object`."""
    sensors: Amount = 0.2
    """Held out by `sensor` and `sensor_and_object`."""
    by_contact: bool = False
    """`standard` only: hold out whole contacts, as many as make up the number of pairs."""
    seed: int = 0


@dataclass(frozen=True)
class PairLabels:
    """What a split goes by: a unique id for every pair and, where known, the object, sensor and contact of each."""

    ids: Sequence[str]
    objects: Sequence[str] | None = None
    sensors: Sequence[str] | None = None
    contacts: Sequence[str] | None = None

    def __post_init__(self) -> None:
        if repeated := [name for name, count in Counter(self.ids).items() if count > 1]:
            raise SplitImpossible(
                f"expected every id once, got {repeated[0]!r} more often; give every pair an id of its own"
            )
        for what in ("objects", "sensors", "contacts"):
            column = getattr(self, what)
            if column is not None and len(column) != len(self.ids):
                raise SplitImpossible(
                    f"expected {what} of {len(self.ids)} pairs, got {len(column)}; give one for every id"
                )

    def column(self, what: Literal["objects", "sensors", "contacts"]) -> Shaped[Array, " n"]:
        """One of them; raises `SplitImpossible` where it is not known."""
        column = getattr(self, what)
        if column is None:
            raise SplitImpossible(
                f"expected the {what[:-1]} of every pair, got none; give {what}, or split the standard way"
            )
        return np.asarray(column, dtype=str)


@dataclass(frozen=True)
class SplitRows:
    """Places of a split's pairs in a data set."""

    train: Int[Array, " train"]
    test: Int[Array, " test"]


@dataclass(frozen=True)
class DatasetSplit:
    """A division of pairs, by id; every list is sorted. `split_file` keeps it."""

    settings: SplitSettings
    train: tuple[str, ...]
    test: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    held_out_objects: tuple[str, ...] = ()
    held_out_sensors: tuple[str, ...] = ()

    def rows(self, ids: Sequence[str]) -> SplitRows:
        """Where the pairs of a data set belong; raises `SplitUnfit` unless it holds exactly this split's ids."""
        place = {name: row for row, name in enumerate(ids)}
        known = {*self.train, *self.test, *self.left_out}
        if len(place) != len(ids) or place.keys() != known:
            raise SplitUnfit(
                f"expected the {len(known)} pairs of the split, got {count_with_example(set(place) - known)} that it does not "
                f"know, {count_with_example(known - set(place))} of its own missing, and {len(ids) - len(place)} ids repeated; "
                "give the data set that it was made from, or split again"
            )
        train, test = (np.array([place[name] for name in part], dtype=int) for part in (self.train, self.test))
        return SplitRows(train, test)


def split_dataset(pairs: PairLabels, settings: SplitSettings = SplitSettings()) -> DatasetSplit:
    """Divide; raises `SplitImpossible` where a part would be empty or there is too little to choose from."""
    if len(pairs.ids) < 2:
        raise SplitImpossible(f"expected at least 2 pairs to divide, got {len(pairs.ids)}; record more")
    held = HeldOut(pairs, settings)
    is_test, is_train = held.divided
    ids = np.asarray(pairs.ids, dtype=str)
    for name, part in (("train", is_train), ("test", is_test)):
        if not part.any():
            raise SplitImpossible(
                f"expected pairs to {name} with, got none of {len(ids)} by the {settings.kind} split; hold out other "
                "amounts, or take another seed"
            )
    train, test, rest = (tuple(sorted(ids[part].tolist())) for part in (is_train, is_test, ~(is_train | is_test)))
    return DatasetSplit(settings, train, test, rest, held.object_names, held.sensor_names)


@dataclass(frozen=True)
class HeldOut:
    """What is held out, and of which pairs."""

    pairs: PairLabels
    settings: SplitSettings

    @property
    def divided(self) -> tuple[Bool[Array, " n"], Bool[Array, " n"]]:
        """PairLabels to test and to train with."""
        if self.settings.kind == "sensor_and_object":
            # Where nothing touches the sensor alone decides: nothing of such a pair needs leaving out.
            untouched = self.pairs.column("objects") == NO_OBJECT
            of_object = np.where(untouched, self.of_sensors, self.of_objects)
            return self.of_sensors & of_object, ~(self.of_sensors | of_object)
        kinds = {"standard": "of_pairs", "object": "of_objects", "sensor": "of_sensors"}
        held: Bool[Array, " n"] = getattr(self, kinds[self.settings.kind])
        return held, ~held

    @property
    def of_pairs(self) -> Bool[Array, " n"]:
        """PairLabels at random, or whole contacts until there are enough pairs."""
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
        """All pairs of some objects, and the same part of those in which nothing touches."""
        objects, ids = self.pairs.column("objects"), np.asarray(self.pairs.ids, dtype=str)
        untouched = rank_by_hash(ids[objects == NO_OBJECT].tolist(), self.settings.seed, "pairs")
        share = len(self.object_names) / len(set(objects.tolist()) - {NO_OBJECT})
        return np.isin(objects, self.object_names) | np.isin(ids, untouched[: round(share * len(untouched))])

    @property
    def of_sensors(self) -> Bool[Array, " n"]:
        """All pairs of some sensors."""
        return np.isin(self.pairs.column("sensors"), self.sensor_names)

    @cached_property
    def object_names(self) -> tuple[str, ...]:
        """The objects held out."""
        return self.chosen("objects") if "object" in self.settings.kind else ()

    @cached_property
    def sensor_names(self) -> tuple[str, ...]:
        """The sensors held out."""
        return self.chosen("sensors") if "sensor" in self.settings.kind else ()

    def chosen(self, what: Literal["objects", "sensors"]) -> tuple[str, ...]:
        """Some of the different names; raises `SplitImpossible`."""
        different = set(self.pairs.column(what).tolist()) - {NO_OBJECT}
        if len(different) < 2:
            raise SplitImpossible(
                f"expected at least 2 different {what} to hold some out, got {len(different)}; record more {what}, or split "
                "the standard way"
            )
        number = held_out_count(getattr(self.settings, what), len(different), what)
        return tuple(sorted(rank_by_hash(different, self.settings.seed, what)[:number]))


def held_out_count(amount: Amount, available: int, what: What) -> int:
    """An amount as a number that leaves something on both sides; raises `SplitImpossible`."""
    number = round(amount * available) if 0 < amount < 1 else amount
    if not (0 < number < available and number == int(number)):
        raise SplitImpossible(
            f"expected a number of {what} from 1 to {available - 1} or a part between 0 and 1, got {amount} of {available}; "
            f"hold out another amount, as {max(1, available // 10)}"
        )
    return int(number)


def rank_by_hash(names: Iterable[str], seed: int, what: What) -> list[str]:
    """Names in an order that looks random and depends on nothing but the seed, what they name, and each name itself."""
    return sorted(names, key=lambda name: (blake2b(f"{seed}/{what}/{name}".encode()).digest(), name))


def count_with_example(names: set[str]) -> str:
    """How many, and one of them."""
    return f"{len(names)} (such as {min(names)!r})" if names else "0"


SPLIT_FORMAT = 1


def write_split(path: Path | str, split: DatasetSplit) -> None:
    """Whole or not at all; raises `FileNotWritten`."""
    table = {"format": SPLIT_FORMAT, **asdict(split)}
    write_file_atomically(path, msgspec.json.format(msgspec.json.encode(table), indent=1), b"\n")


def read_split(path: Path | str) -> DatasetSplit:
    """What `write_split` wrote, checked; raises `SplitUnfit`."""
    try:
        content = Path(path).read_bytes()
        version = msgspec.json.decode(content, type=dict[str, object]).get("format")
        read = msgspec.json.decode(content, type=DatasetSplit)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as trouble:
        raise SplitUnfit(
            f"expected a split in {path}, got: {trouble}; give a file that this program wrote, or split again"
        ) from trouble
    counts = Counter([*read.train, *read.test, *read.left_out])
    repeated = counts.total() - len(counts)
    if version != SPLIT_FORMAT or not read.train or not read.test or repeated:
        raise SplitUnfit(
            f"expected a split in {path}, format {SPLIT_FORMAT}, with pairs to train and to test, each once, got format "
            f"{version} with {len(read.train)} to train, {len(read.test)} to test and {repeated} repeated; split again"
        )
    return read

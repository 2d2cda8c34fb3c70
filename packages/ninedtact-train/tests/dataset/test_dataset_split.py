"""Nothing held out is trained on, whatever the data; the same data always divide alike; a stored split is checked."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ninedtact.errors import FileFormatError, InputError
from ninedtact_train.dataset.split import DatasetSplit, SplitKeys, SplitSettings, read_split, split_dataset, write_split

KINDS = ("standard", "object", "sensor", "sensor_and_object")


def made(number: int = 400, objects: int = 20, sensors: int = 5, seed: int = 0) -> SplitKeys:
    """Contacts of four pairs each, one in twenty of them without contact."""
    draw = np.random.default_rng(seed)
    contacts = [f"c{row // 4}" for row in range(number)]
    object_of, sensor_of = (draw.integers(0, many, number // 4 + 1) for many in (objects, sensors))
    named = [("none" if (row // 4) % 20 == 0 else f"gear_{object_of[row // 4]:02d}") for row in range(number)]
    return SplitKeys(
        [f"p{row:05d}" for row in range(number)], named, [f"s{sensor_of[row // 4]}" for row in range(number)], contacts
    )


@given(
    kind=st.sampled_from(KINDS),
    seed=st.integers(0, 1000),
    part=st.floats(0.05, 0.9),
    by_contact=st.booleans(),
    rows=st.lists(
        st.tuples(st.sampled_from(["none", *"abcdef"]), st.sampled_from("xyz"), st.integers(0, 9)), max_size=60
    ),
)
def test_whatever_the_data_nothing_held_out_is_trained_on(kind, seed, part, by_contact, rows) -> None:
    objects, sensors, contacts = ([str(row[which]) for row in rows] for which in range(3))
    pairs = SplitKeys([f"{row:02d}" for row in range(len(rows))], objects, sensors, contacts)
    try:
        found = split_dataset(pairs, SplitSettings(kind, part, part, part, by_contact, seed))
    except InputError:
        return
    assert sorted([*found.train, *found.test, *found.left_out]) == list(pairs.ids)
    assert found.train and found.test and (not found.left_out or kind == "sensor_and_object")

    def of(column: list[str], names: tuple[str, ...]) -> set[str]:
        return {column[int(name)] for name in names}

    touched_objects = of(objects, found.train) - {"none"}
    if "object" in kind:
        assert of(objects, found.test) - {"none"} <= set(found.held_out_objects)
        assert touched_objects.isdisjoint(found.held_out_objects)
    if "sensor" in kind:
        assert of(sensors, found.test) <= set(found.held_out_sensors)
        assert of(sensors, found.train).isdisjoint(found.held_out_sensors)
    if kind == "standard" and by_contact:
        assert of(contacts, found.test).isdisjoint(of(contacts, found.train))


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_the_rows_does_not_matter_and_the_seed_does(kind) -> None:
    pairs = made()
    backwards = SplitKeys(pairs.ids[::-1], pairs.objects[::-1], pairs.sensors[::-1], pairs.contacts[::-1])
    settings = SplitSettings(kind, pairs=0.1)
    assert split_dataset(pairs, settings) == split_dataset(backwards, settings)
    assert split_dataset(pairs, settings).test != split_dataset(pairs, SplitSettings(kind, pairs=0.1, seed=2)).test


REFUSED: dict[str, tuple[Callable[[], SplitKeys], SplitSettings, str]] = {
    "one pair": (lambda: made(1), SplitSettings(), "at least 2 pairs to divide, got 1"),
    "more pairs than there are": (made, SplitSettings(), "from 1 to 399 or a part between 0 and 1, got 10000 of 400"),
    "no part": (
        made,
        SplitSettings(pairs=0.0),
        "a part between 0 and 1, got 0.0 of 400; hold out another amount, as 40",
    ),
    "not a number": (made, SplitSettings(pairs=float("nan")), "got nan of 400"),
    "all objects": (made, SplitSettings("object", objects=20), "from 1 to 19"),
    "one object": (lambda: made(objects=1), SplitSettings("object"), "at least 2 different objects.*got 1"),
    "no objects known": (lambda: SplitKeys(["a", "b"]), SplitSettings("object"), "object of every pair, got none"),
    "no contacts known": (lambda: SplitKeys("abc"), SplitSettings(pairs=1, by_contact=True), "contact of every pair"),
    "an id twice": (lambda: SplitKeys(["a", "b", "a"]), SplitSettings(), "every id once, got 'a' more often"),
    "a column too short": (lambda: SplitKeys(["a", "b"], ["x"]), SplitSettings(), "objects of 2 pairs, got 1"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_divided_is_refused_in_one_sentence(case: str) -> None:
    pairs, settings, words = REFUSED[case]
    with pytest.raises(InputError, match=words):
        split_dataset(pairs(), settings)


def test_a_held_out_object_that_was_never_on_a_held_out_sensor_leaves_nothing_to_test() -> None:
    pairs = SplitKeys([*"abcd"], ["o", "o", "q", "q"], ["s", "s", "t", "t"])
    outcomes = set()
    for seed in range(20):
        try:
            outcomes.add(split_dataset(pairs, SplitSettings("sensor_and_object", objects=1, sensors=1, seed=seed)).test)
        except InputError as refusal:
            assert "pairs to train with, got none" in str(refusal) or "pairs to test with, got none" in str(refusal)
            outcomes.add(())
    assert outcomes == {("a", "b"), ("c", "d"), ()}


def test_a_split_is_read_as_it_was_written(tmp_path: Path) -> None:
    found = split_dataset(made(), SplitSettings("sensor_and_object", seed=3))
    write_split(tmp_path / "split.json", found)
    assert read_split(tmp_path / "split.json") == found
    rows = read_split(tmp_path / "split.json").rows(made().ids)
    assert [made().ids[row] for row in rows.test] == list(found.test)


def test_a_split_of_other_data_is_refused_and_says_what_differs() -> None:
    found = DatasetSplit(SplitSettings(), ("a", "b"), ("c",))
    with pytest.raises(
        FileFormatError, match=r"got 1 \(such as 'x'\) that it does not know, 1 \(such as 'b'\) of its own missing"
    ):
        found.rows(["a", "c", "x"])
    with pytest.raises(FileFormatError, match="1 ids repeated"):
        found.rows(["a", "b", "c", "c"])


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.update(format=2),
        lambda table: table.update(test=table["train"][:1]),
        lambda table: table["settings"].update(kind="by luck"),
        lambda table: table.update(test=[1]),
    ],
)
def test_a_damaged_split_is_refused(tmp_path: Path, change: Callable[[dict], object]) -> None:
    path = tmp_path / "split.json"
    write_split(path, split_dataset(made(), SplitSettings(pairs=0.1)))
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))
    with pytest.raises(FileFormatError, match=r"expected a split in .*, got.*split again"):
        read_split(path)

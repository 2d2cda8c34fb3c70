"""A data set in training: the right images with the right wrenches, fast, and decoded once."""

import doctest
import os
import re
import shutil
from pathlib import Path
from time import process_time

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from built_sets import decoded, references_in, rows_in

import ninedtact_train.dataset
from ninedtact.cli import main
from ninedtact.errors import FileFormatError, InputError
from ninedtact_train.dataset.calibrated_readings import iterate_rows_with_references
from ninedtact_train.dataset.folder import find_pair_files
from ninedtact_train.dataset.parquet_files import write_pair_file, write_reference_images_file
from ninedtact_train.dataset.reader import load_dataset
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage


@pytest.fixture
def folder(twins: Path, tmp_path: Path) -> Path:
    """A copy of the twin's, to be changed."""
    shutil.copytree(twins, tmp_path / "pairs", ignore=shutil.ignore_patterns("cache"))
    return tmp_path / "pairs"


def test_the_example_of_load_dataset_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder.parent)
    (example,) = doctest.DocTestFinder().find(load_dataset, "load_dataset", globs={})
    assert len(example.examples) > 4
    assert doctest.DocTestRunner().run(example).failed == 0
    assert all(getattr(ninedtact_train.dataset, name) for name in ninedtact_train.dataset.__all__)


def test_a_data_set_of_another_format_is_refused(folder: Path) -> None:
    first = min((folder / "data").iterdir())
    pq.write_table(pq.read_table(first).replace_schema_metadata({}), first)
    with pytest.raises(FileFormatError, match=r"of format 2 .*got no format; make it again"):
        load_dataset(folder)


OTHER_COLUMNS = {
    "seven numbers": ("wrench", pa.array([[float("nan")] * 7] * 9, pa.list_(pa.float32(), 7))),
    "seven in a list of any length": ("wrench", pa.array([[0.0] * 7] * 9, pa.list_(pa.float32()))),
    "five": ("wrench", pa.array([[0.0] * 5] * 9, pa.list_(pa.float32(), 5))),
    "texts as numbers": ("wrench", pa.array([["1"] * 6] * 9)),
    "one number": ("wrench", pa.array([1.0] * 9)),
    "numbers as texts": ("object", pa.array([1] * 9)),
    "texts as steps": ("step", pa.array(["1"] * 9)),
}


@pytest.mark.parametrize("kind", OTHER_COLUMNS)
def test_columns_of_another_type_are_refused(kind: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name, column = OTHER_COLUMNS[kind]
    for file in (folder / "data").iterdir():
        table = pq.read_table(file)
        rows = pa.array(column.to_pylist()[:1] * len(table), column.type)
        pq.write_table(table.set_column(table.schema.get_field_index(name), name, rows), file)
    for command in ("show", "check"):
        assert main(["dataset", command, str(folder)]) == 1
        assert re.search("expected (six numbers|string|int32) in .*, got .*; build it again", capsys.readouterr().err)


def test_texts_larger_than_memory_are_refused_unread(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is lowered here, so that the file is made in a moment."""
    monkeypatch.setattr("ninedtact_train.dataset.parquet_files._MOST_TEXT_BYTES", 50_000_000)
    first = min((folder / "data").iterdir())
    table = pq.read_table(first).slice(0, 1)
    table = pa.concat_tables([table] * 600)
    table = table.set_column(table.schema.get_field_index("object"), "object", pa.array(["x" * 100_000] * 600))
    pq.write_table(table, first, dictionary_pagesize_limit=10**7)
    before = pa.total_allocated_bytes()
    with pytest.raises(FileFormatError, match="texts of 60 MB, more than 50 MB"):
        find_pair_files(folder)
    assert pa.total_allocated_bytes() - before < 1e7


def test_rows_are_those_of_the_files(folder: Path) -> None:
    pairs, rows, untouched = load_dataset(folder, size=(64, 48)), rows_in(folder), references_in(folder)
    assert len(pairs) == len(rows) == 18
    assert np.array_equal(pairs.wrenches, np.array([row["wrench"] for row in rows], np.float32))
    for name, column in (("object", "object"), ("contact", "contact_id"), ("sensor", "sensor"), ("kind", "kind")):
        assert list(getattr(pairs, f"{name}s")) == [row[column] for row in rows]
        assert name == "kind" or list(getattr(pairs.to_split_pairs(), f"{name}s")) == [row[column] for row in rows]
    assert list(pairs.times_ns) == [row["time_ns"] for row in rows]
    assert pairs.to_split_pairs().ids == list(pairs.ids) and len(set(pairs.ids)) == 18
    batch = pairs.batch(np.array([17, 3, 3]))
    for image, reference, at in zip(batch.images, batch.references, batch.indices, strict=True):
        assert np.array_equal(image, decoded(rows[at]["image"]))
        assert np.array_equal(reference, untouched[rows[at]["reference_id"]])
    assert np.array_equal(batch.wrenches, pairs.wrenches[[17, 3, 3]])
    batch.images[:] = 7  # a copy
    assert (pairs.images(np.array([17, 3, 3])) != 7).any() and not pairs.decoded.images.flags.writeable


def test_one_of_every_ten_pairs_keeps_the_shares_of_their_kinds(tmp_path: Path) -> None:
    png = cv2.imencode(".png", np.full((16, 16), 140, np.uint8))[1].tobytes()
    write_reference_images_file(tmp_path / "references.parquet", [ReferenceImage("a/0", png, "a")])
    objects = ["none" if number % 50 == 0 else "ball" for number in range(1000)]
    rows = [
        DatasetRow(*(f"{number}", png, "a/0", np.zeros(6, np.float32), name, f"c{number}", 0, None, "a", "rule", None))
        for number, name in enumerate(objects)
    ]
    (tmp_path / "data").mkdir()
    write_pair_file(tmp_path / "data" / "train-00000-of-00001.parquet", rows)
    chosen = [
        [row for group in iterate_rows_with_references(find_pair_files(tmp_path), 10) for row in group.rows]
        for _ in range(2)
    ]
    assert chosen[0] == chosen[1] and len(chosen[0]) == 100
    assert sum(row["object"] == "none" for row in chosen[0]) < 7, "2 % of all, though each session begins with one"
    assert sum(len(group.rows) for group in iterate_rows_with_references(find_pair_files(tmp_path))) == 1000


def test_batches_hold_every_pair_once(folder: Path) -> None:
    pairs = load_dataset(folder, size=(32, 24))
    batches = list(pairs.batches(5, np.random.default_rng(1)))
    assert [len(batch.images) for batch in batches] == [5, 5, 5, 3]
    order = np.concatenate([batch.indices for batch in batches])
    assert sorted(order) == list(range(18))
    assert list(order) != list(range(18))
    assert [batch.indices[0] for batch in pairs.batches(5)] == [0, 5, 10, 15]


def test_images_are_decoded_once_and_again_where_the_files_changed(folder: Path) -> None:
    def cached() -> tuple[Path, int]:
        (images,) = (folder / "cache").glob("32x24-*/images.npy")
        return images, images.stat().st_mtime_ns

    def first_image_is_right() -> bool:
        image = load_dataset(folder, size=(32, 24)).images(np.array([0]))[0]
        return np.array_equal(image, small(rows_in(folder)[0]["image"]))

    load_dataset(folder, size=(32, 24))
    before = cached()
    first = min((folder / "data").iterdir())
    first.touch()
    load_dataset(folder, size=(32, 24))
    assert cached() == before
    table = pq.read_table(first)
    pq.write_table(table.take(list(reversed(range(table.num_rows)))), first)
    assert first_image_is_right()
    again, _ = cached()
    assert again != before[0]
    again.write_bytes(again.read_bytes()[:-1])
    assert first_image_is_right(), "a damaged cache is made again"


def small(image: dict[str, bytes]) -> np.ndarray:
    return cv2.resize(decoded(image), (32, 24), interpolation=cv2.INTER_AREA)


def test_what_a_killed_process_left_is_removed(folder: Path) -> None:
    load_dataset(folder, size=(32, 24))
    (images,) = (folder / "cache").glob("32x24-*/images.npy")
    left, at_work = images.with_name(".a.partial"), images.with_name(".b.partial")
    for partial in (left, at_work):
        partial.touch()
    os.utime(left, (0, 0))
    images.unlink()
    load_dataset(folder, size=(32, 24))
    assert not left.exists() and at_work.exists()


@pytest.mark.parametrize("column", ["wrench", "reference_id"])
def test_pairs_that_nothing_can_be_learnt_from_are_refused(folder: Path, column: str) -> None:
    first = min((folder / "data").iterdir())
    table = pq.read_table(first)
    values = table[column].to_pylist()
    values[2] = [0, 0, float("nan"), 0, 0, 0] if column == "wrench" else None
    at = table.schema.get_field_index(column)
    pq.write_table(table.set_column(at, table.schema.field(at), pa.array(values, table.schema.field(at).type)), first)
    with pytest.raises(FileFormatError, match=r"1 (not finite|without reference).*--drop"):
        load_dataset(folder)


@pytest.mark.parametrize("column", ["kind", "source"])
def test_texts_too_long_to_be_names_are_refused_before_they_are_read(folder: Path, column: str) -> None:
    first = min((folder / "data").iterdir())
    table = pq.read_table(first)
    at, long = table.schema.get_field_index(column), pa.array(["x" * 8_000_000] * len(table))
    pq.write_table(table.set_column(at, column, long), first, compression="zstd")
    began_s = process_time()
    with pytest.raises(FileFormatError, match=rf"bytes of texts in \d+ rows of {column}"):
        load_dataset(folder)
    assert process_time() - began_s < 1


def test_a_flipped_bit_in_a_column_is_refused(folder: Path) -> None:
    first = min((folder / "data").iterdir())
    content = bytearray(first.read_bytes())
    chunk = pq.ParquetFile(first).metadata.row_group(0)
    wrench = next(chunk.column(at) for at in range(chunk.num_columns) if "wrench" in chunk.column(at).path_in_schema)
    content[wrench.data_page_offset + wrench.total_compressed_size - 4] ^= 1
    first.write_bytes(content)
    with pytest.raises(FileFormatError, match="expected a whole Parquet file"):
        load_dataset(folder)


def test_damaged_images_and_impossible_sizes_are_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="at least 8 x 8"):
        load_dataset(folder, size=(4, 3))
    first = min((folder / "data").iterdir())
    rows = pq.read_table(first).to_pylist()
    rows[1]["image"]["bytes"] = rows[1]["image"]["bytes"][:50]
    pq.write_table(pa.Table.from_pylist(rows, pq.read_schema(first)), first)
    with pytest.raises(FileFormatError, match=r"cut short.*row 1 of .*--drop"):
        load_dataset(folder)
    assert not list((folder / "cache").glob("*x*/*"))

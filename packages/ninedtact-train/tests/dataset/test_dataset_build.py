"""Building: several sources in one set, nothing lost, nothing half written, the same again after a stop."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pyarrow.parquet as pq
import pytest
from built_sets import built_from, full_disk, references_in, rows_in, sources_at
from little_sources import LittleTree, little_episode, little_tree

from ninedtact.atomic_write import FileNotWritten
from ninedtact.checked_reading import mapping_checksum
from ninedtact.design import rectified_mm_per_px
from ninedtact.errors import DatasetError, FileFormatError, InputError, OutputError
from ninedtact.recording.attached_sensor import read_folder_files
from ninedtact_train.dataset.build import BuildSettings, build_dataset
from ninedtact_train.dataset.fault_report import read_quality_report
from ninedtact_train.workflows.dataset_calibrations import load_simulated_sensors

KEPT = ("reference_id", "wrench", "object", "contact_id", "step", "time_ns", "sensor", "kind")
BUILD = """
import sys
from ninedtact.cli import main
if __name__ == "__main__":
    sys.exit(main(["dataset", "build", "--workers", "1", "--out", *sys.argv[1:]]))
"""


def test_the_twin_s_output_comes_through_byte_by_byte(twins: Path, tmp_path: Path) -> None:
    built = built_from(tmp_path / "out", twins)
    assert built.report.findings == []
    before, after = rows_in(twins), rows_in(tmp_path / "out")
    assert len(before) == len(after) == 18
    for old, new in zip(before, after, strict=True):
        assert new["image"]["bytes"] == old["image"]["bytes"]
        assert [new[name] for name in KEPT] == [old[name] for name in KEPT]
        assert new["mm_per_px"] == old["mm_per_px"] == pytest.approx(rectified_mm_per_px((64, 48)))
    assert len({row["id"] for row in after}) == 18
    for name, image in references_in(twins).items():
        assert np.array_equal(references_in(tmp_path / "out")[name], image)


def test_simulated_sensors_and_their_calibrations_come_along_unless_a_name_is_that_of_two(
    twins: Path, tmp_path: Path
) -> None:
    source = shutil.copytree(twins, tmp_path / "source")
    (source / "sensors" / "twin_0_001").mkdir(parents=True)
    (source / "sensors" / "twin_0_001" / "sensor.toml").write_text("calibrated")
    built_from(tmp_path / "out", source)
    assert load_simulated_sensors(tmp_path / "out") == load_simulated_sensors(twins)
    assert [path.name for path in (tmp_path / "out" / "sensors").iterdir()] == ["twin_0_001"]
    assert (tmp_path / "out" / "sensors" / "twin_0_001" / "sensor.toml").read_text() == "calibrated"
    tables = json.loads((twins / "sensors.json").read_text())
    tables[1]["friction"] += 0.1
    tables[1]["checksum"] = mapping_checksum(tables[1])
    (source / "sensors.json").write_text(json.dumps(tables))
    with pytest.raises(InputError, match=r"got another 'twin_0_001' in .*source"):
        built_from(tmp_path / "both", twins, source)


def test_several_sources_keep_their_ids_apart(twins: Path, tree: LittleTree, tmp_path: Path) -> None:
    little_episode(tmp_path / "press.npz")
    built = built_from(
        tmp_path / "out", twins, f"again={twins}", tree.root, f"lab2={tree.root}", tmp_path / "press.npz"
    )
    rows = rows_in(tmp_path / "out")
    assert len(rows) == len({row["id"] for row in rows}) == 2 * 18 + 2 * 6 + 5
    assert {row["source"] for row in rows} == {"twins", "again", "Dataset", "lab2", "press"}
    assert built.report.counts == {"duplicate image": 18 + 6}
    assert {row["reference_id"] for row in rows} <= set(references_in(tmp_path / "out"))
    of_twins = {row["contact_id"] for row in rows if row["source"] == "twins"}
    assert not of_twins & {row["contact_id"] for row in rows if row["source"] == "again"}
    both = [{row["object"] for row in rows if row["source"] == name} for name in ("twins", "again")]
    assert both[0] == both[1]


def test_objects_of_another_seed_are_other_objects(twins: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(twins, copy)
    settings = {**json.loads((copy / "settings.json").read_text()), "objects_seed": 7}
    (copy / "settings.json").write_text(json.dumps(settings))
    with pytest.raises(FileFormatError, match="checksum"):
        built_from(tmp_path / "edited", copy)
    (copy / "settings.json").write_text(json.dumps({**settings, "checksum": mapping_checksum(settings)}))
    built_from(tmp_path / "out", copy)
    assert {row["object"] for row in rows_in(tmp_path / "out")} <= {"none", "ball:3@7", "cylinder:2,5@7", "cone@7"}


def test_the_report_says_where_each_finding_is(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "0.npz").write_bytes(b"no zip")
    for number in (1, 2):
        forces = np.outer(np.linspace(0.1, 4, 5), [0, 0, -1, 0, 0, 0])
        forces[number, 2] = 4.0
        changes = {"6d_force": forces, "ref_force": np.zeros(6)}
        little_episode(tmp_path / "in" / f"{number}.npz", seed=number, **changes)
    built_from(tmp_path / "kept", tmp_path / "in")
    found = [one for one in read_quality_report(tmp_path / "kept" / "report.json").findings if one.row is not None]
    assert {one.id for one in found} >= {"in/1/00001", "in/2/00002"}
    for one in found:
        assert pq.read_table(tmp_path / "kept" / "data" / one.file)["id"][one.row].as_py() == one.id
    built_from(tmp_path / "dropped", tmp_path / "in", settings=BuildSettings(drop=True))
    left_out = read_quality_report(tmp_path / "dropped" / "report.json").findings
    assert {(one.row, one.file) for one in left_out} == {(None, "")}
    names, kept = {one.id for one in left_out}, [row["id"] for row in rows_in(tmp_path / "dropped")]
    assert names == {one.id for one in read_quality_report(tmp_path / "kept" / "report.json").findings}
    assert kept == [row["id"] for row in rows_in(tmp_path / "kept") if row["id"] not in names]
    assert "left out" in (tmp_path / "dropped" / "README.md").read_text()


def test_a_card_says_what_a_person_needs(tree: LittleTree, twins: Path, tmp_path: Path) -> None:
    built_from(tmp_path / "out", tree.root, twins, settings=BuildSettings(licence="CC-BY-4.0"))
    card = (tmp_path / "out" / "README.md").read_text()
    assert "\nlicense: cc-by-4.0\n" in card
    for said in ("35 mm below the skin", "seed 0", "24 pairs (", "Fz", "no faults found", "skin's\ncentre"):
        assert said.replace("\n", " ") in card.replace("\n", " ")
    with pytest.raises(InputError, match="mit"):
        BuildSettings(licence="do what you like\nsplit: none")


def test_hugging_face_opens_it(tree: LittleTree, twins: Path, tmp_path: Path) -> None:
    datasets = pytest.importorskip("datasets", reason="expected Hugging Face datasets to try it; install datasets")
    pytest.importorskip("PIL", reason="expected Pillow, which decodes the images; install pillow")
    built_from(tmp_path / "out", tree.root, twins)
    opened = datasets.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "hf"))["train"]
    assert len(opened) == 24
    assert opened[0]["image"].size == (48, 36)
    assert opened[0]["id"] == "Dataset/1/1"
    references = datasets.load_dataset(str(tmp_path / "out"), "references", cache_dir=str(tmp_path / "hf"))["train"]
    assert len(references) == 3


def test_a_killed_build_goes_on_with_any_number_of_workers_and_ends_the_same(tmp_path: Path) -> None:
    for number in range(20):
        little_episode(tmp_path / "in" / f"{number}.npz", steps=12, seed=number)
    job = subprocess.Popen([sys.executable, "-c", BUILD, str(tmp_path / "killed"), str(tmp_path / "in")])
    third, until = tmp_path / "killed" / "parts" / "00002.result.json", monotonic() + 60
    while not third.is_file() and job.poll() is None and monotonic() < until:
        sleep(0.002)
    job.send_signal(signal.SIGKILL)
    job.wait()
    assert not (tmp_path / "killed" / "README.md").exists()
    (tmp_path / "killed" / "parts" / ".abc.partial").write_bytes(b"half")
    whole = built_from(tmp_path / "whole", tmp_path / "in")
    for made in (tmp_path / "in" / f"{number}.npz" for number in range(3)):  # which nobody reads again
        entry = made.stat()
        made.write_bytes(bytes(entry.st_size))
        os.utime(made, ns=(entry.st_atime_ns, entry.st_mtime_ns))
    build_dataset(tmp_path / "killed", sources_at(tmp_path / "in"), workers=2)
    assert read_folder_files(tmp_path / "killed") == read_folder_files(whole.folder)
    with pytest.raises(InputError, match="1 worker"):
        build_dataset(tmp_path / "none", sources_at(tmp_path / "in"), workers=0)


def test_a_stop_while_files_are_put_together_is_made_good(tree: LittleTree, tmp_path: Path) -> None:
    """Whatever was moved already stays; what was not is still among the parts."""
    little_episode(tmp_path / "press.npz")
    whole = built_from(tmp_path / "whole", tree.root, tmp_path / "press.npz")
    stopped = tmp_path / "stopped"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ninedtact_train.dataset.build._unique_references", interrupted)
        with pytest.raises(KeyboardInterrupt):
            built_from(stopped, tree.root, tmp_path / "press.npz")
    assert len(list((stopped / "data").iterdir())) == 2
    with pytest.raises(FileFormatError, match="finish"):
        sources_at(stopped)[0].parts()
    built_from(stopped, tree.root, tmp_path / "press.npz")
    assert read_folder_files(stopped) == read_folder_files(whole.folder)


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_finished_one_is_left_as_it_is(tree: LittleTree, tmp_path: Path) -> None:
    built_from(tmp_path / "out", tree.root)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}
    assert built_from(tmp_path / "out", tree.root).statistics.pairs == 6
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")} == before


def test_other_sources_are_not_mixed_in(tree: LittleTree, twins: Path, tmp_path: Path) -> None:
    built_from(tmp_path / "out", tree.root)
    with pytest.raises(OutputError, match="another source"):
        built_from(tmp_path / "out", tree.root, twins)
    tree.add("3", "1", 3.0, 5)
    with pytest.raises(OutputError, match="another source Dataset"):
        built_from(tmp_path / "out", tree.root)
    with pytest.raises(OutputError, match="something else"):
        built_from(tmp_path, tree.root)
    with pytest.raises(OutputError, match="outside of the sources"):
        built_from(tree.root / "out", tree.root)


def test_a_full_disk_is_one_sentence_and_nothing_half(tree: LittleTree, tmp_path: Path) -> None:
    with full_disk(6000), pytest.raises(FileNotWritten, match=r"expected to write .*; free the disk"):
        built_from(tmp_path / "full", tree.root)
    assert not list((tmp_path / "full" / "parts").iterdir())
    assert built_from(tmp_path / "full", tree.root).statistics.pairs == 6


def test_damaged_data_sets_are_refused(twins: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(twins, copy)
    first, *_, last = sorted((copy / "data").iterdir())
    last.rename(tmp_path / "last")
    with pytest.raises(FileFormatError, match="got 2"):
        sources_at(copy)[0].parts()
    (tmp_path / "last").rename(last)
    first.write_bytes(first.read_bytes()[:1000])
    with pytest.raises(FileFormatError, match="whole Parquet file"):
        built_from(tmp_path / "out", copy)
    pq.write_table(pq.read_table(last).drop_columns(["wrench"]), first)
    with pytest.raises(FileFormatError, match=r"columns id, image, .* got no column wrench"):
        built_from(tmp_path / "out", copy)


def test_nothing_usable_is_a_refusal_that_names_the_list(tmp_path: Path) -> None:
    tree = little_tree(tmp_path / "Dataset", objects=1, pairs=1)
    tree.put_wrench("1", "1", np.full(6, np.inf))
    with pytest.raises(DatasetError, match=r"1 not finite.*report\.json"):
        built_from(tmp_path / "out", tree.root)
    assert (tmp_path / "out" / "report.json").is_file()

"""What is wrong with a pair is found and named; what is right is left in peace."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from built_sets import listed
from little_sources import grey, touched, untouched

from ninedtact.dataset.check import check_folder
from ninedtact.dataset.checks import CheckSettings, darkening
from ninedtact.dataset.columns import write_rows, write_untouched
from ninedtact.dataset.generation.pair import png
from ninedtact.dataset.report import (
    FindingsListed,
    NothingUsable,
    read_report,
    require_nothing_listed,
    require_usable,
    write_report,
)
from ninedtact.dataset.rows import MEANINGS, Fault, Row, UntouchedImage

SKIN = untouched()
PRESSED = np.array([0.2, -0.1, -3.0, 0.01, 0.01, 0.001], np.float32)


def row(name: str, seed: int, load_n: float = 3.0) -> Row:
    """A good one."""
    image = png(grey(touched(SKIN, load_n, seed)))
    return Row(name, image, "skin", PRESSED, "cup", "c1", seed, 1000 * seed, "ours", "rule", "test", 0.5, 1.0)


def wrench(*six: float) -> np.ndarray:
    return np.array(six, np.float32)


def data_set(folder: Path, *rows: Row) -> Path:
    (folder / "data").mkdir(parents=True)
    half = -(-len(rows) // 2)
    write_rows(folder / "data" / "train-00000-of-00002.parquet", rows[:half])
    write_rows(folder / "data" / "train-00001-of-00002.parquet", rows[half:])
    small = png(cv2.resize(grey(SKIN), (24, 18)))
    images = [UntouchedImage("skin", png(grey(SKIN)), "ours"), UntouchedImage("small", small, "ours")]
    write_untouched(folder / "references.parquet", [*images, UntouchedImage("broken", b"?", "ours")])
    return folder


ODD = {
    Fault.NOT_FINITE: {"wrench": wrench(0, 0, np.nan, 0, 0, 0)},
    Fault.OUT_OF_RANGE: {"wrench": wrench(0, 0, -3, 0.5, 0, 0)},
    Fault.PULLING: {"wrench": wrench(0, 0, 3, 0, 0, 0)},
    Fault.UNSYNCHRONISED: {"gap_ms": -35.0},
    Fault.WRONG_SIZE: {"reference": "small"},
    Fault.NO_REFERENCE: {"reference": "unheard of"},
    Fault.UNREADABLE: {"image": b"\x89PNG\r\n\x1a\n"},
    Fault.NOT_DARKER: {"image": png(grey(touched(SKIN, 0.0, 77)))},
    Fault.UNFELT: {"wrench": wrench(0, 0.01, 0, 0, 0, 0)},
}


@pytest.mark.parametrize("fault", ODD, ids=str)
def test_each_fault_is_found_alone(tmp_path: Path, fault: Fault) -> None:
    rows = [row("a", 1), row("b", 2), replace(row("odd", 3), **ODD[fault]), row("d", 4)]
    found = check_folder(data_set(tmp_path, *rows))
    assert listed(found) == {(fault.value, "odd")}
    assert (found.pairs, found.without_fault, found.counts) == (4, 3, {fault.value: 1})
    assert any(MEANINGS[fault] in line for line in found.lines())


@pytest.mark.parametrize("reference", [None, "broken"])
def test_a_reference_that_cannot_be_read_is_none(tmp_path: Path, reference: str | None) -> None:
    found = check_folder(data_set(tmp_path, row("a", 1), replace(row("odd", 3), reference=reference)))
    assert listed(found) == {("no reference", "odd")}


def test_what_came_before_is_found_across_files(tmp_path: Path) -> None:
    rows = [row("a", 1), row("b", 2), row("a", 3), replace(row("e", 4), image=row("b", 2).image)]
    found = check_folder(data_set(tmp_path, *rows))
    assert listed(found) == {("duplicate id", "a"), ("duplicate image", "e")}
    says = {finding.id: finding.says for finding in found.listed}
    assert "row 0 of train-00000-of-00002.parquet" in says["a"]
    assert says["e"].startswith("b shows the same")


def test_limits_may_be_moved(tmp_path: Path) -> None:
    folder = data_set(tmp_path, row("a", 1), replace(row("late", 2), gap_ms=35.0))
    assert check_folder(folder, CheckSettings(gap_ms=50.0)).listed == []
    assert len(check_folder(folder, CheckSettings(largest=(6.0, 6.0, 2.0, 1.0, 1.0, 1.0))).listed) == 3


def test_the_twin_s_data_have_nothing_against_them(twins: Path) -> None:
    found = check_folder(twins)
    assert (found.pairs, found.listed) == (18, [])


def test_a_light_that_drifts_is_no_touch() -> None:
    skin = grey(SKIN)
    assert darkening(skin, skin) == 0
    assert darkening(skin - 9, skin) == pytest.approx(0, abs=1e-4)
    assert darkening(grey(touched(SKIN, 3.0)), skin) > 10


def test_a_report_is_read_as_it_was_written(tmp_path: Path) -> None:
    rows = [replace(row(str(seed), seed), wrench=wrench(0, 0, np.inf, 0, 0, 0)) for seed in (1, 2)]
    found = check_folder(data_set(tmp_path, *rows))
    write_report(tmp_path / "check.json", found)
    assert read_report(tmp_path / "check.json") == found
    with pytest.raises(NothingUsable, match=r"2 not finite.*mend the sources"):
        require_usable(found, tmp_path / "check.json")
    with pytest.raises(FindingsListed, match="--drop"):
        require_nothing_listed(found, tmp_path / "check.json")

"""What is wrong with a pair is found and named; what is right is left in peace."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from built_sets import listed
from little_sources import grey, touched, untouched

from ninedtact.capture.strict_image_reading import encode_png
from ninedtact_train.dataset.checks import check_dataset, local_darkening_levels
from ninedtact_train.dataset.fault_report import PairFault, read_quality_report, write_quality_report
from ninedtact_train.dataset.parquet_files import write_pair_file, write_reference_images_file
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage

SKIN = untouched()
PRESSED = np.array([0.2, -0.1, -3.0, 0.01, 0.01, 0.001], np.float32)


def row(name: str, seed: int, load_n: float = 3.0) -> DatasetRow:
    """A good one."""
    image = encode_png(grey(touched(SKIN, load_n, seed)))
    return DatasetRow(name, image, "skin", PRESSED, "cup", "c1", seed, 1000 * seed, "ours", "rule", "test", 0.5, 1.0)


def wrench(*six: float) -> np.ndarray:
    return np.array(six, np.float32)


def data_set(folder: Path, *rows: DatasetRow) -> Path:
    (folder / "data").mkdir(parents=True)
    half = -(-len(rows) // 2)
    write_pair_file(folder / "data" / "train-00000-of-00002.parquet", rows[:half])
    write_pair_file(folder / "data" / "train-00001-of-00002.parquet", rows[half:])
    small = encode_png(cv2.resize(grey(SKIN), (24, 18)))
    images = [ReferenceImage("skin", encode_png(grey(SKIN)), "ours"), ReferenceImage("small", small, "ours")]
    write_reference_images_file(folder / "references.parquet", [*images, ReferenceImage("broken", b"?", "ours")])
    return folder


ODD = [
    (PairFault.NOT_FINITE, {"wrench": wrench(0, 0, np.nan, 0, 0, 0)}),
    (PairFault.OUT_OF_RANGE, {"wrench": wrench(0, 0, -3, 0.5, 0, 0)}),
    (PairFault.PULLING, {"wrench": wrench(0, 0, 3, 0, 0, 0)}),
    (PairFault.UNSYNCHRONISED, {"wrench_delay_ms": -35.0}),
    (PairFault.WRONG_SIZE, {"reference_id": "small"}),
    *((PairFault.NO_REFERENCE, {"reference_id": name}) for name in ("unheard of", "broken", None)),
    (PairFault.UNREADABLE, {"image": b"\x89PNG\r\n\x1a\n"}),
    (PairFault.NO_LIGHT, {"image": encode_png(np.full_like(grey(SKIN), 255))}),
    (PairFault.NO_DARKENING, {"image": encode_png(grey(touched(SKIN, 0.0, 77)))}),
    (PairFault.NO_MEASURED_FORCE, {"wrench": wrench(0, 0.01, 0, 0, 0, 0)}),
]


@pytest.mark.parametrize(("fault", "change"), ODD, ids=str)
def test_each_fault_is_found_alone(tmp_path: Path, fault: PairFault, change: dict[str, Any]) -> None:
    rows = [row("a", 1), row("b", 2), replace(row("odd", 3), **change), row("d", 4)]
    found = check_dataset(data_set(tmp_path, *rows))
    assert listed(found) == {(fault.value, "odd")}
    assert (found.pairs, found.without_fault, found.counts) == (4, 3, {fault.value: 1})
    assert any(fault.meaning in line for line in found.summary_lines())


def test_what_came_before_is_found_across_files(tmp_path: Path) -> None:
    rows = [row("a", 1), row("b", 2), row("a", 3), replace(row("e", 4), image=row("b", 2).image)]
    found = check_dataset(data_set(tmp_path, *rows))
    assert listed(found) == {("duplicate id", "a"), ("duplicate image", "e")}
    says = {finding.id: finding.message for finding in found.findings}
    assert "row 0 of train-00000-of-00002.parquet" in says["a"]
    assert says["e"].startswith("b has the same image")
    write_quality_report(tmp_path / "check.json", found)
    assert read_quality_report(tmp_path / "check.json") == found


def test_a_light_that_drifts_is_no_touch() -> None:
    skin = grey(SKIN)
    assert local_darkening_levels(skin, skin) == 0
    assert local_darkening_levels(skin - 9, skin) == pytest.approx(0, abs=1e-4)
    assert local_darkening_levels(grey(touched(SKIN, 3.0)), skin) > 10

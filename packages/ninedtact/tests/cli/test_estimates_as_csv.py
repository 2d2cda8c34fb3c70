"""The table of `estimate --out`."""

import csv
from pathlib import Path

import pytest

from ninedtact.cli.estimate import COLUMNS, _write_csv


@pytest.mark.parametrize("name", ["=1+1.png", "+1.png", "-1.png", "@a.png", " =1.png", "\t=1.png", "\x1b[31m=1.png"])
def test_a_name_is_no_formula_and_no_control_character_for_who_opens_the_table(name: str, tmp_path: Path) -> None:
    row = {"image": name, "time_ns": 0, "touching": True, **dict.fromkeys(COLUMNS, -1.0), "warnings": []}
    _write_csv(tmp_path / "out.csv", [row])
    with (tmp_path / "out.csv").open(encoding="utf-8", newline="") as file:
        written = next(csv.DictReader(file))
    assert (
        not written["image"].lstrip().startswith(("=", "+", "-", "@"))
        and written["image"].replace("\t", "").isprintable()
    )
    assert written[COLUMNS[0]] == "-1.0"

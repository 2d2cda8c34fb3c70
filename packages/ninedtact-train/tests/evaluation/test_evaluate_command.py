"""`ninedtact evaluate`: the published row from the published predictions, the report, and what it says of bad files."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ninedtact.cli import main
from ninedtact_train.evaluation import WrenchPredictions
from ninedtact_train.evaluation.evaluation import PUBLISHED_SCORES, PUBLISHED_SCORES_AT_SKIN
from ninedtact_train.evaluation.predictions import read_predictions, write_predictions

AT_SKIN = ("--predictions-about-mm", "0", "0", "-35", "--about-mm", "0", "0", "0")
PLACES = {"mae": (4, 5), "std": (4, 5), "rmse": (4, 5), "r2": (3, 3), "slope": (3, 3), "skill": (3, 3)}
"""Decimals of forces and torques in what was published."""


def told(capsys: pytest.CaptureFixture[str], *options: str) -> dict:
    assert main(["evaluate", *options, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def drawn(pairs: int = 60, seed: int = 0) -> WrenchPredictions:
    draw = np.random.default_rng(seed)
    truth = np.array([1, 1, 3, 0.03, 0.03, 0.004]) * draw.normal(size=(pairs, 6)) - [0, 0, 6, 0, 0, 0]
    truth[:3] = 0
    predicted = truth + 0.1 * draw.normal(size=(pairs, 6)) * [1, 1, 1, 0.03, 0.03, 0.004]
    names = [f"gear_{number:02d}" for number in draw.integers(0, 40, pairs)]
    return WrenchPredictions(
        truth, predicted, np.full((pairs, 6), 0.1), objects=names, sensors=["a", "b"] * (pairs // 2)
    )


@pytest.mark.parametrize(("where", "published"), [((), PUBLISHED_SCORES), (AT_SKIN, PUBLISHED_SCORES_AT_SKIN)])
def test_the_published_predictions_give_the_published_row(real_data, capsys, where, published) -> None:
    found = told(capsys, "--predictions", str(real_data / "wrenches_10000.csv"), *where)
    for figure, (of_force, of_torque) in PLACES.items():
        places = [of_force] * 3 + [of_torque] * 3
        rounded = [round(value, at) for value, at in zip(found[figure], places, strict=True)]
        assert rounded == list(getattr(published, figure)), figure
        assert found["published"][figure] == list(getattr(published, figure))
    assert (found["pairs"], len(found["by_object"]), found["coverage"]) == (10_000, 175, {})
    assert found["mean_mae"]["force_n"] == pytest.approx(0.307, abs=5e-4)
    light = found["by_load"]["below 1 N"]
    assert light["mae"][2] == pytest.approx(0.436, abs=5e-4) and light["bias"][2] == pytest.approx(-0.355, abs=5e-4)


def test_a_person_reads_the_row_beside_the_published_one(real_data, capsys) -> None:
    assert main(["evaluate", "--predictions", str(real_data / "wrenches_10000.csv")]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^skill +0\.475 +0\.484 +0\.862 +0\.691 +0\.718 +0\.636$", out, re.M)
    assert re.search(r"^  published +0\.475 +0\.484 +0\.862 +0\.691 +0\.718 +0\.636$", out, re.M)
    assert re.search(r"^MAE +0\.2956 +0\.3483 +0\.2778 +8\.99 +7\.84 +1\.23 +0\.3073 +6\.02$", out, re.M)


def test_the_report_is_one_page_with_every_figure_in_it(tmp_path: Path, capsys) -> None:
    write_predictions(tmp_path / "some.csv", drawn())
    found = told(capsys, "--predictions", str(tmp_path / "some.csv"), "--out", str(tmp_path / "out"))
    names = {
        "scatter.png",
        "load.png",
        "coverage.png",
        "objects.png",
        "sensors.png",
        "evaluation.json",
        "evaluation.html",
    }
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    for path in (tmp_path / "out").glob("*.png"):
        image = cv2.imread(str(path))
        assert image.shape[1] > 600 and image.std() > 10
    page = (tmp_path / "out" / "evaluation.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 5 and "://" not in page and "<script" not in page
    assert f"{found['skill'][2]:.3f}" in page and "60 pairs" in page and "gear_" in page
    kept = json.loads((tmp_path / "out" / "evaluation.json").read_text(encoding="utf-8"))
    assert kept == {name: value for name, value in found.items() if name != "files"}
    assert set(found["coverage"]) == {"50", "90"} and found["no_contact"]["pairs"] == 3


six_columns = arrays(float, (4, 6), elements=st.floats(-100, 100))


claimed_errors = arrays(float, (4, 6), elements=st.floats(0) | st.just(float("nan")))


@given(six_columns, six_columns, st.none() | claimed_errors, st.booleans())
def test_predictions_are_read_as_they_were_written(tmp_path_factory, truth, predicted, error, named) -> None:
    path = tmp_path_factory.getbasetemp() / "round.csv"
    names = ['a, "b"', "ç", "3", "x"] if named else None
    write_predictions(path, WrenchPredictions(truth, predicted, error, objects=names))
    back = read_predictions(path)
    assert (back.truth == truth).all() and (back.predicted == predicted).all()
    assert back.std is None if error is None else np.array_equal(back.std, error, equal_nan=True)
    assert (None if back.objects is None else [*back.objects]) == names


def replaced(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new)


def scaled(columns: slice, factor: float) -> Callable[[str], str]:
    """Some columns of a file that has no names in it, in another unit."""

    def change(text: str) -> str:
        header, *rows = text.splitlines()
        cells = [row.split(",") for row in rows]
        for row in cells:
            row[columns] = [str(factor * float(cell)) for cell in row[columns]]
        return "\n".join([header, *map(",".join, cells)])

    return change


def normalised(text: str) -> str:
    header, *rows = text.splitlines()
    return "\n".join([header, *(",".join([*row.split(",")[:6], *["0.5"] * 6]) for row in rows)])


FILES: dict[str, tuple[Callable[[str], str], str]] = {
    "empty": (lambda text: "", "got: Empty CSV file"),
    "header alone": (lambda text: text.splitlines()[0], "CSV"),
    "one row": (lambda text: "\n".join(text.splitlines()[:2]), "at least 2 pairs to evaluate, got 1"),
    "no prediction of Tz": (replaced("pTz", "tz"), r"got no pTz .*the columns there: Fx_N"),
    "other separator": (replaced(",", ";"), "separated by commas, got no Fx_N, Fy_N"),
    "a column twice": (replaced("pTz", "pTy"), "got no pTz"),
    "forces in mN": (scaled(slice(0, 3), 1000), "got true forces of .*as of mN"),
    "torques in N·mm": (scaled(slice(3, 6), 1000), "got true torques .*as of N·mm"),
    "predicted torques in N·mm": (scaled(slice(9, 12), 1000), "got predicted torques .*as of N·mm"),
    "normalised": (normalised, "between 0 and 1, as the original's network gives them"),
}
CELLS = {
    "nan": "expected finite numbers, got nan as truth Fy of pair 2 ",
    "inf": "expected finite numbers, got inf as truth Fy of pair 2 ",
    "": "column #1: Row #3: CSV conversion error to double: invalid value ''; ",
    "heavy": "column #1: Row #3: CSV conversion error to double: invalid value 'heavy'; ",
    "1,2": "Row #3: Expected 12 columns, got 13: ",
}


def refusal(path: Path, capsys) -> str:
    assert main(["evaluate", "--predictions", str(path)]) == 1
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and said.err.startswith("ninedtact: expected ")
    return said.err


@pytest.mark.parametrize("case", FILES)
def test_a_bad_file_is_refused_in_one_sentence(tmp_path: Path, capsys, case: str) -> None:
    change, words = FILES[case]
    path = tmp_path / "some.csv"
    write_predictions(path, WrenchPredictions(drawn().truth, drawn().predicted))
    path.write_text(change(path.read_text()))
    assert re.search(words, refusal(path, capsys))


@pytest.mark.parametrize("cell", CELLS)
def test_a_bad_cell_is_named_by_row_and_column(tmp_path: Path, capsys, cell: str) -> None:
    path = tmp_path / "some.csv"
    write_predictions(path, WrenchPredictions(drawn().truth, drawn().predicted))
    rows = path.read_text().splitlines()
    rows[2] = re.sub(r"^([^,]+),[^,]+", rf"\1,{cell}", rows[2])
    path.write_text("\n".join(rows))
    assert CELLS[cell] in refusal(path, capsys)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (
            ["--predictions", "some.csv", "--force", "model.onnx", "--every", "3"],
            "--predictions, got --force and --every",
        ),
        (["--data", "pairs", "--distribution", "laplace"], "--data, got --distribution"),
    ],
)
def test_options_without_effect_are_refused(options: list[str], named: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *options]) == 1
    assert f"expected options that have an effect with {named}; drop" in capsys.readouterr().err

"""ninedtact dataset build, check and show, as a person types them."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from built_sets import rows_in
from little_sources import LittleTree, little_tree

from ninedtact.cli import main
from ninedtact_train.dataset.preview_image import render_preview


def told(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    code = main(["dataset", *map(str, words)])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_build_check_and_show(tree: LittleTree, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    tree.put_wrench("1", "2", np.array([0, 0, 3.0, 0, 0, 0]))
    (tree.root / "wrench/1/2_norm.npy").unlink()
    code, said, _ = told(
        capsys, "build", f"lab={tree.root}", "--out", out, "--workers", 1, "--licence", "mit", "--json"
    )
    built = json.loads(said)
    assert (code, built["pairs"], built["objects"], built["faults"]) == (0, 6, 2, {"pulling": 1})
    code, said, _ = told(capsys, "check", out, "--workers", 1)
    assert code == 0
    assert "1 pulling: F_z is above zero" in said
    assert json.loads((out / "check.json").read_text())["findings"][0]["id"] == "lab/1/2"
    code, said, _ = told(capsys, "show", out, "--pairs", 4)
    assert code == 0
    assert "6 pairs" in said
    assert "3 lab/1, 3 lab/2" in said
    assert cv2.imread(str(out / "preview.png")) is not None


def test_strict_is_an_exit_code_and_drop_a_remedy(
    tree: LittleTree, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tree.root / "wrench/1/2.npy").unlink()
    tree.put_wrench("1", "3", np.array([0, 0, 3.0, 0, 0, 0]))
    (tree.root / "wrench/1/3_norm.npy").unlink()
    code, _, error = told(capsys, "build", tree.root, "--out", tmp_path / "a", "--workers", 1, "--strict", "--json")
    assert code == 1
    assert error.strip().endswith("report.json lists them, --drop leaves them out")
    assert len(rows_in(tmp_path / "a")) == 5
    assert told(capsys, "check", tmp_path / "a", "--workers", 1, "--strict")[0] == 1
    words = ("build", tmp_path / "a", "--out", tmp_path / "b", "--workers", 1, "--drop", "--json")
    assert told(capsys, *words)[0] == 0
    assert told(capsys, "check", tmp_path / "b", "--workers", 1, "--strict", "--json")[0] == 0
    assert len(rows_in(tmp_path / "b")) == 4


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("build", "nowhere", "--out", "out"), "nothing there"),
        (("build", "--out", "out"), "at least one source"),
        (("build", "data", "--out", "out"), "none of them"),
        (("build", "a=.", "a=.", "--out", "out"), "more than once"),
        (("build", "a/b=.", "--out", "out"), "without slashes"),
        (("build", ".", "--out", "out", "--axes", "+x,+x,+x"), "each letter once"),
        (("build", ".", "--out", "out", "--axes", "+y,-x,+z", "--sensor", "."), "got --axes and --sensor"),
        (("build", ".", "--out", "out", "--licence", "do as you like"), "mit or cc-by-nc-4.0"),
        (("check", "nowhere"), "a data set"),
        (("show", "nowhere"), "a data set"),
    ],
)
def test_bad_words_are_one_sentence(
    words: tuple[str, ...],
    says: str,
    twins: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(twins, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    code, _, error = told(capsys, *words)
    assert code == 1
    assert error.startswith("ninedtact: expected ")
    assert says in error
    assert error.count("\n") == 1


def test_ctrl_c_says_that_it_goes_on(
    tree: LittleTree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ninedtact_train.dataset.build._make_part", interrupted)
    code, _, error = told(capsys, "build", tree.root, "--out", tmp_path / "out", "--workers", 1, "--json")
    assert code == 1
    assert "continue where it stopped" in error


def test_a_sheet_shows_what_is_darker_in_red(tmp_path: Path) -> None:
    """Heavier presses come later and are redder; nothing is blue but white words."""
    from built_sets import built_from

    tree = little_tree(tmp_path / "Dataset", objects=1, pairs=3)
    built_from(tmp_path / "out", tree.root)
    sheet = cv2.imdecode(np.frombuffer(render_preview(tmp_path / "out", 3), np.uint8), cv2.IMREAD_COLOR).astype(int)
    red = sheet[..., 2] - sheet[..., 0]  # text and margin are grey
    tiles = np.split(red[:, : red.shape[1] // 3 * 3], 3, axis=1)
    reds = [tile.mean() for tile in tiles]
    assert reds == sorted(reds) and reds[0] > 1 and tiles[0].max() > 100

"""Force episodes of the Heterogeneous Tactile Transformer: labels without tare, RGB, one file after the other."""

import re
from pathlib import Path

import numpy as np
import pytest
from built_sets import built_from, decoded, listed, references_in, rows_in
from little_sources import grey, little_episode, untouched

from ninedtact_train.dataset.sources.source import SourceConventions


def test_images_forces_and_references_are_the_stored_ones(tmp_path: Path) -> None:
    arrays = little_episode(tmp_path / "force" / "p3_static" / "0_press_10.npz")
    built = built_from(
        tmp_path / "out", f"htt={tmp_path / 'force'}", conventions=SourceConventions(sensor_name="9dtact_nus")
    )
    assert built.report.findings == []
    rows = rows_in(tmp_path / "out")
    assert [row["id"] for row in rows] == [f"htt/p3_static/0_press_10/{step:05d}" for step in range(5)]
    assert np.array([row["wrench"] for row in rows]) == pytest.approx(arrays["6d_force"] - 1.5, abs=1e-6)
    for row, image in zip(rows, arrays["tactile_img"], strict=True):
        assert np.array_equal(decoded(row["image"]), grey(image[..., ::-1]))
        assert (row["object"], row["contact_id"]) == ("htt/probe_3", "htt/p3_static/0_press_10")
        assert (row["sensor"], row["time_ns"], row["mm_per_px"]) == ("9dtact_nus", None, None)
    assert [row["kind"] for row in rows] == ["light_touch", *["stream"] * 4]
    (reference,) = references_in(tmp_path / "out").values()
    assert np.array_equal(reference, grey(untouched(0, 24, 24)))
    card = (tmp_path / "out" / "README.md").read_text()
    assert "CC BY-NC" in card
    assert "5 pairs of all kinds, N and" in card


def test_axes_that_are_turned_are_told_and_may_be_stated(tmp_path: Path) -> None:
    loads = np.linspace(0.1, 4, 5)
    turned = np.stack([0 * loads, 0.1 * loads, loads, *[0 * loads] * 3], axis=1)
    little_episode(tmp_path / "e.npz", **{"6d_force": turned, "ref_force": None})
    built = built_from(tmp_path / "as_is", tmp_path / "e.npz")
    assert built.report.counts == {"pulling": 4}
    stated = built_from(tmp_path / "stated", tmp_path / "e.npz", conventions=SourceConventions(axes="+y,+x,-z"))
    assert stated.report.counts == {}
    assert rows_in(tmp_path / "stated")[-1]["wrench"][:3] == pytest.approx([0.4, 0, -4])


def damage(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-400])


def scramble(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[200:300] = bytes(100)
    path.write_bytes(bytes(content))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"6d_force": np.zeros((4, 6))}, r"6d_force of shape \(5, 6\)"),
        ({"6d_force": np.array([[None] * 6] * 5)}, "Object arrays"),
        ({"6d_force": None}, "the arrays tactile_img"),
        ({"tactile_img": np.zeros((5, 24, 24), np.uint8)}, "8-bit images"),
        ({"tactile_img": np.zeros((5, 24, 24, 3), np.float32)}, "8-bit images"),
        ({"tactile_img": np.zeros((5, 0, 24, 3), np.uint8)}, "8-bit images"),
        ({"ref_frame": np.zeros((24, 24), np.uint8)}, "one RGB image"),
        ({"ref_frame": np.zeros((0, 24, 3))}, "one RGB image"),
        ({"ref_force": np.zeros(3)}, "six numbers"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else value,
)
def test_what_is_no_episode_is_listed_and_the_others_are_read(
    tmp_path: Path, changes: dict[str, object], says: str
) -> None:
    little_episode(tmp_path / "in" / "good.npz", seed=1)
    little_episode(tmp_path / "in" / "odd.npz", **changes)
    built = built_from(tmp_path / "out", tmp_path / "in")
    assert len(rows_in(tmp_path / "out")) == 5
    (finding,) = built.report.findings
    assert (finding.fault.value, finding.id) == ("unreadable", "in/odd")
    assert re.search(says, finding.message)


@pytest.mark.parametrize("harm", [damage, scramble])
def test_a_damaged_file_is_listed(tmp_path: Path, harm: object) -> None:
    little_episode(tmp_path / "in" / "good.npz", seed=1)
    little_episode(tmp_path / "in" / "odd.npz")
    harm(tmp_path / "in" / "odd.npz")  # type: ignore[operator]
    built = built_from(tmp_path / "out", tmp_path / "in")
    assert ("unreadable", "in/odd") in listed(built.report)
    assert len(rows_in(tmp_path / "out")) >= 5

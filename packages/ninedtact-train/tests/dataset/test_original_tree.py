"""The original project's Dataset folder: what it says is what is stored, and nothing of it goes unlisted."""

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from built_sets import built_from, decoded, listed, references_in, rows_in, sources_at
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from little_sources import LittleTree, grey, mixed_of, touched, untouched, wrench_about_sensor

from ninedtact.errors import DatasetError, InputError, NinedtactError
from ninedtact_train.dataset.fault_report import PairFinding
from ninedtact_train.dataset.schema import DatasetRow
from ninedtact_train.dataset.sources.source import SourceConventions


def test_images_references_and_wrenches_are_the_stored_ones(tree: LittleTree, tmp_path: Path) -> None:
    built = built_from(tmp_path / "out", tree.root)
    assert built.report.findings == []
    rows = rows_in(tmp_path / "out")
    assert [row["id"] for row in rows] == [f"Dataset/{thing}/{number}" for thing in (1, 2) for number in (1, 2, 3)]
    (reference,) = references_in(tmp_path / "out").values()
    assert np.array_equal(reference, grey(tree.skin))
    for row in rows:
        thing, number = (int(part) for part in row["id"].split("/")[1:])
        image = touched(tree.skin, 1.5 + number, 10 * thing + number)
        assert np.array_equal(decoded(row["image"]), grey(image))
        assert row["object"] == row["contact_id"] == f"Dataset/{thing}"
        assert (row["kind"], row["sensor"], row["step"], row["time_ns"]) == ("rule", "Dataset", number, None)
        # Torques are moved from the force sensor to the skin.
        force, torque = np.split(np.load(tree.root / "wrench" / f"{thing}" / f"{number}.npy"), 2)
        assert row["wrench"][:3] == pytest.approx(force, rel=1e-6)
        assert row["wrench"][3:] == pytest.approx(torque - np.cross([0, 0, 0.035], force), abs=1e-8)


@pytest.mark.parametrize("axes", ["x,y", "", "xyz", "x,y,z,z", "*x,y,z", "x,y,"])
def test_axes_that_are_none_are_refused(axes: str) -> None:
    with pytest.raises(InputError, match="each letter once"):
        SourceConventions(axes=axes)


def test_a_mixed_image_alone_holds_image_and_reference_even_where_it_wrapped(tmp_path: Path) -> None:
    """Three times a darkening of more than 85 levels begins again at zero; nothing is lost by it."""
    tree = LittleTree(tmp_path / "in" / "Dataset", untouched())
    image = touched(tree.skin, 9.0, 1)
    assert (grey(tree.skin).astype(int) - grey(image)).max() > 85
    tree.put_image("mixed_image", "1", "1", mixed_of(image, tree.skin))
    tree.put_wrench("1", "1", wrench_about_sensor(9.0))
    assert built_from(tmp_path / "out", tmp_path / "in").report.findings == []
    (row,) = rows_in(tmp_path / "out")
    assert np.array_equal(decoded(row["image"]), grey(image))


def test_images_alone_have_no_reference_unless_one_is_named(tree: LittleTree, tmp_path: Path) -> None:
    (tree.root / "mixed_image").rename(tmp_path / "elsewhere")
    with pytest.raises(DatasetError, match="6 no reference"):
        built_from(tmp_path / "none", tree.root)
    named = tmp_path / "skin.png"
    cv2.imwrite(str(named), tree.skin)
    conventions = SourceConventions(reference=named, sensor_name="left finger")
    built = built_from(tmp_path / "out", tree.root, conventions=conventions)
    assert built.report.findings == []
    (reference,) = pq.read_table(tmp_path / "out" / "references.parquet").to_pylist()
    assert {reference["sensor"]} == set(built.statistics.sensors) == {"left finger"}
    assert (
        "  - images without a mixed_image have the reference image skin.png\n"
        in (tmp_path / "out" / "README.md").read_text()
    )


def test_what_is_missing_or_odd_is_listed(tree: LittleTree, tmp_path: Path) -> None:
    root = tree.root
    (root / "wrench/1/1.npy").unlink()
    (root / "image/1/2.png").unlink()
    (root / "mixed_image/1/2.png").unlink()
    (root / "image/1/3.png").write_bytes((root / "image/1/3.png").read_bytes()[:90])
    np.save(root / "wrench/2/1_norm.npy", np.full(6, 0.5))
    tree.put_image("image", "2", "2", touched(tree.skin, 2.0, 99))
    np.save(root / "wrench/2/3.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    (root / "wrench/2/notes.txt").write_text("ran out of glue")
    (root / "wrench/.DS_Store").write_bytes(b"mac")
    tree.add("2", "4", 3.0, 24)
    np.save(root / "wrench/2/4.npy", np.array([0, 0, np.nan, 0, 0, 0]))
    built = built_from(tmp_path / "out", root)
    assert listed(built.report) == {
        ("missing wrench", "Dataset/1/1"),
        ("missing image", "Dataset/1/2"),
        ("unreadable", "Dataset/1/3"),
        ("norm differs", "Dataset/2/1"),
        ("mixed image differs", "Dataset/2/2"),
        ("unreadable", "Dataset/2/3"),
        ("not finite", "Dataset/2/4"),
        ("unreadable", "Dataset/wrench/2/notes.txt"),
    }
    assert {row["id"] for row in rows_in(tmp_path / "out")} == {"Dataset/2/1", "Dataset/2/2", "Dataset/2/4"}


STEMS = st.sampled_from(["1", "2", "10", "007", "a b", "norm", "x_norm", "éß", "1.5", "-", "'", "1_norm_norm"])
FILES = st.tuples(
    st.sampled_from(["image", "mixed_image", "wrench"]),
    st.sampled_from(["1", "cup", "Ω", "a.b", "", "1/deep"]),
    STEMS,
    st.sampled_from([".png", ".npy", ".PNG", ".jpg", ".txt", "_norm.npy", ""]),
    st.sampled_from([b"", b"junk", b"good"]),
)


@given(st.lists(FILES, max_size=10))
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_every_file_ends_in_a_row_or_in_the_list(files: list[tuple[str, str, str, str, bytes]]) -> None:
    skin = untouched(rows=8, cols=8)
    contents = {
        ("image", b"good"): cv2.imencode(".png", touched(skin, 2.0))[1].tobytes(),
        ("mixed_image", b"good"): cv2.imencode(".png", mixed_of(touched(skin, 2.0), skin))[1].tobytes(),
    }
    with TemporaryDirectory() as folder:
        root = Path(folder) / "Dataset"
        for kind in ("image", "mixed_image", "wrench"):
            (root / kind).mkdir(parents=True)
        for kind, thing, stem, ending, content in files:
            path = root / kind / thing / f"{stem}{ending}"
            if path.is_dir() or any(parent.is_file() for parent in path.parents):
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(contents.get((kind, content), content))
            if kind == "wrench" and content == b"good":
                with path.open("wb") as file:
                    np.save(file, wrench_about_sensor(2.0))
        (source,) = sources_at(root)
        try:
            items = [item for part in source.parts() for item in source.items(part)]
        except NinedtactError as refusal:
            assert "expected" in str(refusal)
            return
        rows = {item.id for item in items if isinstance(item, DatasetRow)}
        left_out = {item.id for item in items if isinstance(item, PairFinding)}
        assert not rows & left_out
        for file in (path for path in root.rglob("*") if path.is_file() and not path.name.startswith(".")):
            kind, *middle, name = file.relative_to(root).parts
            stem = Path(name).stem.removesuffix("_norm") if kind == "wrench" else Path(name).stem
            own = "/".join(("Dataset", *middle, stem))
            as_stray = "/".join(("Dataset", kind, *middle, name))
            assert {own, as_stray} & (rows | left_out), file

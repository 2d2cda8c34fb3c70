"""The folder from which a print shop, a laser cutter and a board house work."""

import csv
import json
import math
import os
import re
from pathlib import Path

import cv2
import ezdxf
import numpy as np
import pytest
from build123d import import_step

from ninedtact.cli import main
from ninedtact.design import CameraGeometry, Gel, SensingArea, SensorDesign
from ninedtact.errors import OutputError
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.command import format_fabrication_warnings
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.design_folder import require_replaceable_parts_folder
from ninedtact_hardware.part_files import STL_HEADER_BYTES, STL_RECORD, part_to_dxf, part_to_stl
from ninedtact_hardware.sensor_assembly import PART_CATALOGUE

NET_AREA_MM2 = {"base_board": 2802.15, "first_mould": 2153.12, "second_mould": 2069.28, "acrylic_window": 196.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As the command writes it."""
    out = tmp_path_factory.mktemp("hardware") / "parts"
    assert main(["hardware", "export", "--out", str(out)]) == 0
    return out


def test_everything_is_there(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    found = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert sorted(manifest["files"]) == found
    for name, part in manifest["parts"].items():
        assert f"{part['method']}/{name}.step" in found and f"images/{name}.png" in found
        assert (f"printed/{name}.stl" in found) == (part["method"] == "printed")
        plate = f"cut/{name}_{part['box_mm'][2]:.2f}mm.dxf"
        assert (plate in found) == (part["method"] == "cut")
        assert (f"drawings/{name}.pdf" in found) == (part["method"] in ("printed", "cut"))
    assert {
        "bom.csv",
        "cut/README.txt",
        "printed/README.txt",
        "bom.html",
        "check.txt",
        "design.toml",
        "assembly/sensor.step",
    } <= set(found)
    assert any(name.startswith("led_board/") and name.endswith(".zip") for name in found)


def test_step_read_back_equals_the_model(folder: Path, default: BuildableDesign) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    assert len(import_step(folder / "assembly" / "sensor.step").solids()) == 21
    for name, told in manifest["parts"].items():
        read = import_step(folder / told["method"] / f"{name}.step")
        size = read.bounding_box().size
        assert len(read.solids()) == 1
        assert read.volume == pytest.approx(default.parts[name].volume_mm3, rel=1e-6)
        assert pytest.approx(default.parts[name].size_mm, abs=1e-4) == (size.X, size.Y, size.Z)
        assert told["volume_mm3"] == pytest.approx(read.volume, abs=1e-3)


@pytest.mark.parametrize("name", NET_AREA_MM2)
def test_dxf_is_closed_at_scale_and_without_duplicates(original: BuildableDesign, tmp_path: Path, name: str) -> None:
    path = tmp_path / "part.dxf"
    path.write_bytes(part_to_dxf(original.parts[name].solid))
    drawing = ezdxf.readfile(path)
    assert drawing.units == ezdxf.units.MM and not drawing.audit().errors
    entities = list(drawing.modelspace())
    assert {entity.dxftype() for entity in entities} <= {"LWPOLYLINE", "CIRCLE"}
    assert all(entity.closed for entity in entities if entity.dxftype() == "LWPOLYLINE")
    keys = [outline_key(entity) for entity in entities]
    assert len(keys) == len(set(keys))
    areas = [enclosed_mm2(entity) for entity in entities]
    assert max(areas) - (sum(areas) - max(areas)) == pytest.approx(NET_AREA_MM2[name], abs=0.01)
    assert [entity.dxf.layer for entity in entities].count("outside") == 1


def test_a_design_that_should_not_be_made_is_not_announced_as_one(
    original: BuildableDesign, default: BuildableDesign
) -> None:
    said = "\n".join(format_fabrication_warnings(original.to_json_dict()))
    assert "DO NOT MAKE" in said and "sensor_base and camera" in said
    large = BuildableDesign(HardwareDesign(SensorDesign(Gel(2.0), SensingArea(26, 18), CameraGeometry(15.0))))
    (said,) = format_fabrication_warnings({"interferences": [], "led_board_differences": large.led_board_differences})
    assert "NO LED BOARD TO ORDER" in said and "outline 30.00 / 21.00 mm" in said
    assert not [*format_fabrication_warnings(default.to_json_dict())]


@pytest.mark.parametrize("name", [name for name, (method, _) in PART_CATALOGUE.items() if method == "printed"])
def test_stl_is_watertight_and_as_large_as_the_solid(default: BuildableDesign, name: str) -> None:
    part = default.parts[name]
    corners = np.frombuffer(part_to_stl(part.solid), STL_RECORD, offset=STL_HEADER_BYTES)["corners"]
    _, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    sides = np.concatenate([number.reshape(-1, 3)[:, pair] for pair in ((0, 1), (1, 2), (2, 0))])
    assert (sides[:, 0] != sides[:, 1]).all(), "no triangle has two equal corners"
    _, shared = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    assert (shared == 2).all() and len(np.unique(sides, axis=0)) == len(sides), "two triangles, once in each direction"
    first, second, third = corners.astype(float).transpose(1, 0, 2)
    assert (first * np.cross(second, third)).sum() / 6 == pytest.approx(part.volume_mm3, rel=0.005)


def outline_key(entity: ezdxf.entities.DXFGraphic) -> tuple:
    if entity.dxftype() == "CIRCLE":
        return tuple(round(value, 3) for value in (*entity.dxf.center, entity.dxf.radius))
    return tuple(sorted((round(x, 3), round(y, 3)) for x, y in entity.get_points("xy")))


def enclosed_mm2(entity: ezdxf.entities.DXFGraphic) -> float:
    """Shoelace, and the segment of a circle over every bulged side."""
    if entity.dxftype() == "CIRCLE":
        return math.pi * entity.dxf.radius**2
    points = list(entity.get_points("xyb"))
    area = 0.0
    for (x, y, bulge), (to_x, to_y, _) in zip(points, [*points[1:], points[0]], strict=True):
        area += (x * to_y - y * to_x) / 2
        if bulge:
            angle = 4 * math.atan(bulge)
            radius = math.dist((x, y), (to_x, to_y)) / 2 / math.sin(angle / 2)
            area += radius**2 * (angle - math.sin(angle)) / 2
    return abs(area)


def test_drawings_and_images_open(folder: Path) -> None:
    for path in (folder / "images").glob("*.png"):
        image = cv2.imread(str(path))
        assert image.std() > 10 and (image[0, 0] == 255).all(), path.name
    for path in (folder / "drawings").glob("*.svg"):
        assert "mm" in path.read_text() and path.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    base = (folder / "drawings" / "sensor_base.svg").read_text()
    for text in ("sensor base", "32.50", "25.50", "4 x ⌀2.82", "base.pocket_wide_mm"):
        assert text in base


def test_the_bill_counts(folder: Path) -> None:
    rows = list(csv.DictReader((folder / "bom.csv").read_text().splitlines()))
    counts = {row["name"]: int(row["count"]) for row in rows}
    assert (counts["insert"], counts["screw"], counts["clamp screw and nut"]) == (8, 4, 8)
    page = (folder / "bom.html").read_text()
    assert "M3 x 30" in page and "http" not in page
    prices = [row["together_usd_estimated"] for row in rows]
    assert re.findall(r'<td class="number">[\d.]+</td><td class="number">([\d.]+)</td>', page) == prices
    assert re.findall(r'id="total">([\d.]+)<', page) == [
        f"{sum(round(100 * float(price)) for price in prices) / 100:.2f}"
    ]
    sources = re.findall(r'<img src="([^"]+)"', page)
    assert len(sources) == len(PART_CATALOGUE)
    for source in sources:
        assert cv2.imread(str(folder / source)) is not None, source


@pytest.mark.parametrize(
    "manifest", [None, '{"name": "another program\'s"}', '{"variant": "default", "files": ["mine.txt.bak"]}', "["]
)
def test_a_folder_with_anything_of_ones_own_is_left_alone(
    manifest: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "letters" / "src").mkdir(parents=True)
    (tmp_path / "letters" / "src" / "mine.txt").write_text("keep")
    if manifest is not None:
        (tmp_path / "letters" / "manifest.json").write_text(manifest)
    assert main(["hardware", "export", "--out", str(tmp_path / "letters")]) == 1
    assert "choose another name" in capsys.readouterr().err
    assert (tmp_path / "letters" / "src" / "mine.txt").read_text() == "keep"


def test_the_current_folder_is_refused_before_anything_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["hardware", "export", "--design", "missing.toml", "--out", "."]) == 1
    assert "in which this program runs" in capsys.readouterr().err


def test_an_older_export_may_be_replaced_but_no_pipe_and_no_link_of_ones_own(folder: Path, tmp_path: Path) -> None:
    require_replaceable_parts_folder(folder)
    assert not list(folder.parent.glob(".*partial"))
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "projects").symlink_to(tmp_path, target_is_directory=True)
    os.mkfifo(tmp_path / "manifest.json")  # which is not waited for
    for out, named in ((tmp_path, "manifest"), (tmp_path / "parts", "projects")):
        with pytest.raises(OutputError, match=named):
            require_replaceable_parts_folder(out)

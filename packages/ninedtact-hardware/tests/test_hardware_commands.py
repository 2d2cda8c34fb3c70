import json
import os
import re
from dataclasses import asdict, replace
from pathlib import Path
from threading import Thread

import pytest

from ninedtact.cli import main
from ninedtact.design import CameraGeometry, DesignImpossible, Gel, SensorDesign, shore_a_to_shear_modulus_mpa
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.command import format_bill_of_materials
from ninedtact_hardware.design import HardwareDesign, lens_view_radius_mm, original_hardware_design
from ninedtact_hardware.design_comparison import explore_designs
from ninedtact_hardware.design_file import read_hardware_design
from ninedtact_hardware.design_sweep import DesignSweep, change_design
from ninedtact_hardware.fabrication_guide import format_fabrication_guide, write_fabrication_guide
from ninedtact_hardware.materials import TRANSLUCENT_SILICONE, translucent_silicone_of_modulus
from ninedtact_hardware.part_dimensions import FastenerDimensions, WindowDimensions

DOCS = Path(__file__).parents[3] / "docs"


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict]:
    code = main(["hardware", *arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_check_names_the_broken_rule(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "thin.toml"
    path.write_text("[hardware.shell]\nwall_mm = 0.5\n")
    code, found = told(capsys, "check", "--design", str(path))
    assert code == 1 and found["broken"][0]["rule"] == "wall_too_thin"
    assert main(["hardware", "export", "--design", str(path), "--out", str(tmp_path / "parts")]) == 1
    assert "(rule wall_too_thin)" in capsys.readouterr().err and not (tmp_path / "parts").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[hardware.board]\nresistor_ohm = 3000\n", "leds_too_bright: expected a current in each LED of at most 60 mA"),
        ("[hardware.base]\npin_mm = 0.9\npin_round_mm = 0.5\n", "part_not_modelled: expected dimensions from which"),
        (
            '[hardware]\nvariant = "original"\n[hardware.board]\nlens_hole_mm = 10.4\n',
            "lens hole 10.40 mm instead of 10.20 mm; redraw led_board.kicad_pcb",
        ),
    ],
)
def test_check_says_what_to_change(text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A rule, a part that cannot be modelled, and an LED board that has to be redrawn; the design comes through a pipe."""
    pipe = tmp_path / "design.toml"
    os.mkfifo(pipe)
    writer = Thread(target=pipe.write_text, args=(text,))
    writer.start()
    assert main(["hardware", "check", "--design", str(pipe)]) == 1
    writer.join()
    assert words in capsys.readouterr().out


def test_bom(default: BuildableDesign, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = told(capsys, "bom")
    cents = {
        kind: sum(round(100 * item["count"] * item["each_usd"]) for item in found["items"] if item["kind"] == kind)
        for kind in ("sensor", "connection", "tool")
    }
    assert code == 0 and round(100 * found["sensor_usd_estimated"]) == cents["sensor"]
    assert round(100 * found["sensor_in_use_usd_estimated"]) == cents["sensor"] + cents["connection"]
    assert round(100 * found["total_usd_estimated"]) == sum(cents.values())
    assert [item["name"] for item in found["items"] if item["kind"] == "connection"] == [
        "light cable",
        "camera adapter",
    ]
    assert found["items"] == [{**asdict(item), "usd": item.usd} for item in default.bill]
    assert "the paper says about 15 $" in "\n".join(format_bill_of_materials(default.bill))


def test_bill_and_guide_name_what_the_design_asks_for(default: BuildableDesign) -> None:
    """The published camera, silicone and inserts belong to the published design alone."""
    usual = {item.name: item.what for item in default.bill}
    assert usual["camera"].startswith("Frank-S15-V1.0-160") and "(M2-3-5)" in usual["insert"]
    assert usual["translucent_gel"].startswith("Posilicone DRSGJ02 (Shore A 5), 1 : 1 by weight; mix")
    sensor = SensorDesign(Gel(shear_modulus_mpa=shore_a_to_shear_modulus_mpa(15)), camera=CameraGeometry(20.0, 120.0))
    fasteners = FastenerDimensions(insert_mm=(3.3, 4.0))
    other = BuildableDesign(replace(HardwareDesign(sensor), fasteners=fasteners))
    what = {item.name: item.what for item in other.bill}
    assert what["camera"].startswith("camera with a lens of 120°") and "(M2-3-5)" not in what["insert"]
    assert "of about Shore A 15 " in what["translucent_gel"] and "1 : 1" not in what["translucent_gel"]
    assert "of about Shore A 15 " in format_fabrication_guide(other)
    explored = change_design(HardwareDesign(), shore_a=5.0).sensor.gel.shear_modulus_mpa
    assert translucent_silicone_of_modulus(explored) == TRANSLUCENT_SILICONE
    assert "less than Shore A 1 " in translucent_silicone_of_modulus(0.003).product


def test_explore(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "explored"
    code, found = told(capsys, "explore", "--gel-mm", "1", "1.5", "4", "--shore-a", "5", "--out", str(out))
    assert code == 0
    refused, thin, thick = found["designs"]
    assert "mould_too_thin_for_the_screws" in refused["refusal"]
    assert thin["signal_per_n"] > thick["signal_per_n"] > 0
    assert thin["depth_noise_mm"] < thick["depth_noise_mm"]
    assert thin["depth_range_mm"] < thick["depth_range_mm"] and thin["depth_at_1n_mm"] < thick["depth_at_1n_mm"]
    assert json.loads((out / "explore.json").read_text())["designs"] == found["designs"]
    written = read_hardware_design(out / "design_02.toml", "default")
    assert written.sensor.gel.thickness_mm == 1.5


def test_a_comparison_leaves_no_design_of_an_earlier_one(tmp_path: Path) -> None:
    """Row 1 of the table is `design_01.toml`: a refused design must not have the file of another."""
    kept = {"design_notes.toml", "design_01.toml.orig", "mine.txt"}
    for name in (*kept, "design_01.toml", "design_02.toml", "design_101.toml"):
        (tmp_path / name).write_text("earlier")
    assert main(["hardware", "explore", "--gel-mm", "1", "--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == kept | {"explore.json"}


def test_a_value_that_no_sensor_has_is_refused_before_any_design_is_built() -> None:
    built: list[object] = []
    with pytest.raises(DesignImpossible, match=r"gel\.thickness_mm"):
        built.extend(explore_designs([*DesignSweep(gel_mm=(2.5, 40.0)).designs(HardwareDesign())]))
    assert not built


def test_a_wider_area_takes_a_taller_sensor() -> None:
    wide = change_design(HardwareDesign(), area_mm=(36.0, 27.0))
    assert wide.heights.top > HardwareDesign().heights.top and lens_view_radius_mm(wide) > 22.5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--area-mm", "wide"], "24x18"), (["--shore-a", "120"], "Shore A"), (["--gel-mm", *map(str, range(201))], "200")],
)
def test_explore_refuses_in_one_sentence(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hardware", "explore", *arguments]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "expected" in said and words in said


def test_the_guide_in_the_docs_is_that_of_the_default(default: BuildableDesign) -> None:
    """`ninedtact hardware guide --out docs` makes it again."""
    text = format_fabrication_guide(default)
    assert (DOCS / "fabrication.md").read_text(encoding="utf-8") == text
    for line in text.splitlines():
        if line.startswith("!["):
            assert (DOCS / line.split("(")[1].rstrip(")")).is_file()


def test_the_guide_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = told(capsys, "guide", "--variant", "original", "--out", str(tmp_path))
    assert code == 0 and len(found["files"]) == 13
    page = (tmp_path / "fabrication.md").read_text(encoding="utf-8")
    assert "original design" in page
    assert re.findall(r"\(images/(.*?)\)", page) == sorted(path.name for path in (tmp_path / "images").iterdir())


def test_an_interrupted_guide_leaves_an_earlier_one_whole(default: BuildableDesign, tmp_path: Path) -> None:
    """Text and images that belong to two designs would show steps of one sensor with the numbers of another."""
    images = tmp_path / "images"
    images.mkdir()
    (images / "fabrication_01_inserts.png").write_text("earlier")
    drawing = write_fabrication_guide(default, tmp_path)
    first = next(drawing)
    drawing.close()
    assert [*tmp_path.rglob("*.*")] == [first] and first.read_text() == "earlier"


def test_the_guide_names_the_command_that_writes_its_parts(default: BuildableDesign, tmp_path: Path) -> None:
    """Read back with the options that the page states, the design is that of the page."""
    own = BuildableDesign(replace(original_hardware_design(), window=WindowDimensions(thick_mm=2.5)))
    for sensor in (default, own):
        (options,) = re.findall(r"`ninedtact hardware export --out parts(.*?)`", format_fabrication_guide(sensor))
        stated = tmp_path / "your_design.toml"
        stated.write_text("[hardware.window]\nthick_mm = 2.5\n")
        given = dict(re.findall(r" --(\w+) (\S+)", options))
        path = stated if given.get("design") == stated.name else None
        assert read_hardware_design(path, given.get("variant", "default")) == sensor.design

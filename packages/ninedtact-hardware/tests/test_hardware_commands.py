import json
from dataclasses import asdict
from pathlib import Path

import pytest

from ninedtact.cli import main
from ninedtact.design import DesignImpossible
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.command import format_bill_of_materials
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.design_comparison import explore_designs
from ninedtact_hardware.design_file import read_hardware_design
from ninedtact_hardware.design_sweep import DesignSweep
from ninedtact_hardware.fabrication_guide import format_fabrication_guide, write_fabrication_guide

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
    """A rule, a part that cannot be modelled, and an LED board that has to be redrawn."""
    path = tmp_path / "design.toml"
    path.write_text(text)
    assert main(["hardware", "check", "--design", str(path)]) == 1
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


def test_a_value_that_no_sensor_has_is_refused_before_any_design_is_built() -> None:
    built: list[object] = []
    with pytest.raises(DesignImpossible, match=r"gel\.thickness_mm"):
        built.extend(explore_designs([*DesignSweep(gel_mm=(2.5, 40.0)).designs(HardwareDesign())]))
    assert not built


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


def test_an_interrupted_guide_leaves_an_earlier_one_whole(default: BuildableDesign, tmp_path: Path) -> None:
    """Text and images that belong to two designs would show steps of one sensor with the numbers of another."""
    images = tmp_path / "images"
    images.mkdir()
    (images / "fabrication_01_inserts.png").write_text("earlier")
    drawing = write_fabrication_guide(default, tmp_path)
    first = next(drawing)
    drawing.close()
    assert [*tmp_path.rglob("*.*")] == [first] and first.read_text() == "earlier"

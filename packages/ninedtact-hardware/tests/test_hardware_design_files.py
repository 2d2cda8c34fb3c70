from pathlib import Path

import pytest

from ninedtact.cli import main
from ninedtact.design import Gel, SensingArea, SensorDesign, read_design_file
from ninedtact.errors import FileFormatError
from ninedtact_hardware.buildability import find_broken_rules
from ninedtact_hardware.design import HardwareDesign, original_hardware_design
from ninedtact_hardware.design_file import hardware_design_to_toml, read_hardware_design

OURS = SensorDesign(gel=Gel(2.0), sensing_area=SensingArea(20, 15))


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "sensor.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("hardware", [HardwareDesign(OURS), original_hardware_design()], ids=["default", "original"])
def test_hardware_comes_back_too(tmp_path: Path, hardware: HardwareDesign) -> None:
    path = written(tmp_path, hardware_design_to_toml(hardware))
    assert read_hardware_design(path, hardware.variant) == hardware
    assert read_design_file(path) == hardware.sensor


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[hardware.lid]\nwall_mm = 2", "'lid'"),
        ("[hardware.shell]\nwal_mm = 2", "'wal_mm'"),
        ("[hardware]\nshell = 3", "tables"),
        ('[hardware.shell]\nwall_mm = "thick"', "wall_mm"),
        ("[hardware.shell]\nled_cavity_mm = 1.0", r"shell\.led_cavity_mm"),
    ],
)
def test_hardware_that_no_sensor_has_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(FileFormatError, match=words):
        read_hardware_design(written(tmp_path, text), "default")


def test_a_missing_file_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hardware", "check", "--design", "nowhere.toml"]) == 1
    assert capsys.readouterr().err.startswith("ninedtact: expected a design in TOML, got nowhere.toml")


def test_the_example_of_the_docs_can_be_built(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "hardware.md").read_text(encoding="utf-8")
    design = read_hardware_design(written(tmp_path, page.split("```toml\n")[1].split("```")[0]), "default")
    assert (design.shell.wall_mm, design.sensor.gel.thickness_mm) == (2.4, 2.0)
    assert find_broken_rules(design) == []

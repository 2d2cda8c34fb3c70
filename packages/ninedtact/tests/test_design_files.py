import json
import re
from pathlib import Path
from typing import Annotated, get_origin

import numpy as np
import pytest

from ninedtact.cli import main
from ninedtact.cli.calibrate import CalibrateCommand
from ninedtact.cli.demo import DemoCommand
from ninedtact.design import (
    Gel,
    SensingArea,
    SensorDesign,
    design_to_toml,
    read_design_file,
)
from ninedtact.errors import FileFormatError, InputError
from ninedtact.simulation.calibration_images import SimulatedCalibrationImages, simulate_calibration_images
from ninedtact.simulation.twin import default_twin, twin_from_design

OURS = SensorDesign(gel=Gel(2.0), sensing_area=SensingArea(20, 15))


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "sensor.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_design_comes_back_as_it_was_written(tmp_path: Path) -> None:
    assert read_design_file(written(tmp_path, design_to_toml(OURS))) == OURS
    assert read_design_file(written(tmp_path, "")) == SensorDesign()
    assert (
        read_design_file(written(tmp_path, "[gel]\nthickness_mm = 2\n[sensing_area]\nwidth_mm=20\nheight_mm=15"))
        == OURS
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gel = ", "TOML"),
        ("[gel]\nthicknes_mm = 2", "'thicknes_mm'"),
        ("[gell]\nthickness_mm = 2", "'gell'"),
        ('[gel]\nthickness_mm = "thick"', "thickness_mm"),
        ("[sensing_area]\nmargin_mm = [1.0]", "margin_mm"),
        ("gel = 3", "gel"),
    ],
)
def test_a_file_that_is_no_design_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(FileFormatError, match=words):
        read_design_file(written(tmp_path, text))


def positive_dimensions() -> list[str]:
    """Such as `gel.thickness_mm`."""
    parts = vars(SensorDesign()).items()
    hints = {f"{table}.{name}": hint for table, part in parts for name, hint in part.__annotations__.items()}
    bounds = {name: hint.__metadata__[0] for name, hint in hints.items() if get_origin(hint) is Annotated}
    return [name for name, bounds in bounds.items() if bounds.ge is not None and bounds.ge > 0]


@pytest.mark.parametrize("name", positive_dimensions())
@pytest.mark.parametrize("value", ["inf", "nan", "1e12", "1e-12"])
def test_dimensions_beyond_what_can_be_made_are_refused_by_name(tmp_path: Path, name: str, value: str) -> None:
    part, field = name.split(".")
    if field in ("rows", "cols", "raw_long_side_px"):
        value = {"inf": "1000000000000", "nan": "-1", "1e12": "100000", "1e-12": "0"}[value]
    with pytest.raises(FileFormatError, match=re.escape(name)):
        read_design_file(written(tmp_path, f"[{part}]\n{field} = {value}"))


def test_the_published_design_has_the_default_twin() -> None:
    ours, default = twin_from_design(SensorDesign()), default_twin()
    assert (ours.renderer.reference == default.renderer.reference).all()
    assert ours.renderer.light == default.renderer.light
    assert (ours.area_mm, ours.gel_mm, ours.name) == (default.area_mm, default.gel_mm, default.name)


def test_a_thin_gel_is_calibrated_by_presses_that_it_bears() -> None:
    thin = SensorDesign(gel=Gel(1.2))
    images = simulate_calibration_images(twin_from_design(thin), thin)
    darkest = [(after.astype(float) - before).min() for before, after in pressed(images)]
    assert max(darkest) < -10, "both presses are seen"


def pressed(images: SimulatedCalibrationImages) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(images.board_reference, images.board), (images.ball_reference, images.ball)]


@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_files_are_read_as_every_editor_saves_them(tmp_path: Path, mark: str, newline: str) -> None:
    path = tmp_path / "design.toml"
    path.write_bytes((mark + newline.join(("[gel]", "thickness_mm = 2.0", ""))).encode())
    assert read_design_file(path).gel.thickness_mm == 2.0


def test_a_press_of_a_designed_sensor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, design_to_toml(OURS))
    press = ["simulate", "press", "--object", "ball:4", "--depth-mm", "1", "--json", "--out", str(tmp_path / "press")]
    forces = []
    for options in ([], ["--design", str(path)]):
        assert main([*press, *options]) == 0
        forces.append(json.loads(capsys.readouterr().out)["wrench"]["force_n"][2])
    assert forces[1] < 1.1 * forces[0] < 0, "a thinner gel resists more"
    assert main([*press, "--design", str(path), "--sensor", "mine"]) == 1
    assert "--sensor or --design" in capsys.readouterr().err


def test_calibrate_and_demo_take_a_design(tmp_path: Path) -> None:
    path = written(tmp_path, design_to_toml(OURS) + "\n[hardware.shell]\nwall_mm = 2.4\n")
    assert CalibrateCommand(out=tmp_path, design_file=path).resolved_design == OURS
    assert CalibrateCommand(out=tmp_path, design_file=path, ball_radius_mm=3.0).resolved_design.ball.radius_mm == 3.0
    with pytest.raises(InputError, match="both"):
        _ = CalibrateCommand(out=tmp_path, design_file=path, design=SensorDesign(gel=Gel(3.0))).resolved_design
    assert DemoCommand(design_file=path).twin.gel.thickness_mm == OURS.gel.thickness_mm

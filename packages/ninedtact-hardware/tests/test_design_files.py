import json
import os
import re
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Annotated, get_origin

import numpy as np
import pytest

from ninedtact.cli import main
from ninedtact.cli.calibrate import CalibrateCommand
from ninedtact.cli.demo import Demo
from ninedtact.cli.shared_options import DesignGivenTwice
from ninedtact.design import (
    DesignFileUnreadable,
    DesignImpossible,
    Gel,
    SensingArea,
    SensorDesign,
    design_to_toml,
    read_design_file,
    shear_modulus_mpa_to_shore_a,
    shore_a_to_shear_modulus_mpa,
)
from ninedtact.simulation.calibration_images import SimulatedCalibrationImages, simulate_calibration_images
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.twin import brightness_model_for_design, default_twin, twin_from_design
from ninedtact_hardware.buildability import find_broken_rules, require_buildable_design
from ninedtact_hardware.design import (
    DesignVariant,
    default_hardware_design,
    hardware_design_of_variant,
    hardware_design_to_toml,
    original_hardware_design,
    read_hardware_design,
)
from ninedtact_hardware.led_board.board_outline_and_holes import LedBoardImpossible
from ninedtact_hardware.led_board.board_parameters import LedBoardDesign, led_board_for_design
from ninedtact_hardware.led_board.complete_layout import lay_out_board
from ninedtact_hardware.led_board.fabrication_files import format_fabrication_notes
from ninedtact_hardware.part_dimensions import FastenerDimensions, LedBoardDimensions

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
    "hardware", [default_hardware_design(OURS), original_hardware_design()], ids=["default", "original"]
)
def test_hardware_comes_back_too(tmp_path: Path, hardware: object) -> None:
    path = written(tmp_path, hardware_design_to_toml(hardware))
    assert read_hardware_design(path, hardware.variant) == hardware
    assert read_design_file(path) == hardware.sensor


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
    with pytest.raises(DesignFileUnreadable, match=words):
        read_design_file(written(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[hardware.lid]\nwall_mm = 2", "'lid'"),
        ("[hardware.shell]\nwal_mm = 2", "'wal_mm'"),
        ("[hardware]\nshell = 3", "tables"),
        ('[hardware.shell]\nwall_mm = "thick"', "wall_mm"),
    ],
)
def test_hardware_that_no_sensor_has_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(DesignFileUnreadable, match=words):
        read_hardware_design(written(tmp_path, text), "default")


def positive_dimensions() -> list[str]:
    """Such as `gel.thickness_mm`."""
    parts = vars(SensorDesign()).items()
    hints = {f"{table}.{name}": hint for table, part in parts for name, hint in part.__annotations__.items()}
    bounds = {name: hint.__metadata__[0] for name, hint in hints.items() if get_origin(hint) is Annotated}
    return [name for name, bounds in bounds.items() if bounds.least > 0]


def test_thirteen_dimensions_are_positive() -> None:
    assert len(positive_dimensions()) == 13


@pytest.mark.parametrize("name", positive_dimensions())
@pytest.mark.parametrize("value", ["inf", "nan", "1e12", "1e-12"])
def test_dimensions_beyond_what_can_be_made_are_refused_by_name(tmp_path: Path, name: str, value: str) -> None:
    part, field = name.split(".")
    if field in ("rows", "cols", "raw_long_side_px"):
        value = {"inf": "1000000000000", "nan": "-1", "1e12": "100000", "1e-12": "0"}[value]
    with pytest.raises(DesignImpossible, match=f"{re.escape(name)}|pin board of at least"):
        read_design_file(written(tmp_path, f"[{part}]\n{field} = {value}"))


def test_impossible_dimensions_are_refused_as_anywhere_else(tmp_path: Path) -> None:
    with pytest.raises(DesignImpossible, match=r"gel\.thickness_mm"):
        read_design_file(written(tmp_path, "[gel]\nthickness_mm = -1"))
    with pytest.raises(DesignImpossible, match=r"shell\.led_cavity_mm"):
        read_hardware_design(written(tmp_path, "[hardware.shell]\nled_cavity_mm = 1.0"), "default")


def test_a_missing_file_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hardware", "check", "--design", "nowhere.toml"]) == 1
    assert capsys.readouterr().err.startswith("ninedtact: expected a design in TOML, got nowhere.toml")


def test_hardness() -> None:
    """Gent 1958; the published gel's modulus is that of Shore A 5."""
    assert shore_a_to_shear_modulus_mpa(5) == pytest.approx(Gel().shear_modulus_mpa, rel=0.01)
    for shore_a in (1, 5, 33.3, 95):
        assert shear_modulus_mpa_to_shore_a(shore_a_to_shear_modulus_mpa(shore_a)) == pytest.approx(shore_a)
    with pytest.raises(DesignImpossible):
        shore_a_to_shear_modulus_mpa(100)


def test_the_published_design_has_the_default_twin() -> None:
    ours, default = twin_from_design(SensorDesign()), default_twin()
    assert (ours.renderer.reference == default.renderer.reference).all()
    assert ours.renderer.light == default.renderer.light
    assert (ours.area_mm, ours.gel_mm, ours.name) == (default.area_mm, default.gel_mm, default.name)


def test_a_thinner_gel_darkens_sooner_and_scatters_less() -> None:
    thin = brightness_model_for_design(SensorDesign(gel=Gel(1.5)))
    assert thin.darkening_per_mm > BrightnessModel().darkening_per_mm
    assert thin.point_spread_mm < BrightnessModel().point_spread_mm
    assert thin.brightness_change(np.array([-1.5])).item() > -1


def test_a_thin_gel_is_calibrated_by_presses_that_it_bears() -> None:
    thin = SensorDesign(gel=Gel(1.2))
    images = simulate_calibration_images(twin_from_design(thin), thin)
    darkest = [(after.astype(float) - before).min() for before, after in pressed(images)]
    assert max(darkest) < -10, "both presses are seen"


def pressed(images: SimulatedCalibrationImages) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(images.board_reference, images.board), (images.ball_reference, images.ball)]


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


def test_the_example_of_the_docs_can_be_built(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "hardware.md").read_text(encoding="utf-8")
    design = read_hardware_design(written(tmp_path, page.split("```toml\n")[1].split("```")[0]), "default")
    assert (design.shell.wall_mm, design.sensor.gel.thickness_mm) == (2.4, 2.0)
    assert find_broken_rules(design) == []


@pytest.mark.parametrize("variant", ["default", "original"])
def test_the_circuit_board_is_that_of_the_design(tmp_path: Path, variant: DesignVariant) -> None:
    for width, height in ((24, 18), (36, 27)):
        design = hardware_design_of_variant(SensorDesign(sensing_area=SensingArea(width, height)), variant)
        outline = led_board_for_design(design).outline
        assert (outline.width_mm, outline.height_mm) == pytest.approx(design.horizontal_dimensions.led_board)
        assert outline.lens_hole_mm == design.board.lens_hole_mm
        leds = led_board_for_design(design).leds.positions
        for ours, theirs, within_mm in (
            (design.horizontal_dimensions.mount_inserts, outline.bosses, 1e-9),
            (
                design.horizontal_dimensions.mount_inserts,
                LedBoardDesign.for_size(*design.horizontal_dimensions.led_board).outline.bosses,
                1e-9,
            ),
            (design.horizontal_dimensions.posts, outline.locating_holes, 1e-9),
            (design.horizontal_dimensions.shell_screws, outline.notches, 1e-9),
            (design.horizontal_dimensions.leds, leds, 0.15),
        ):
            assert np.abs(np.array(sorted(ours)) - np.array(sorted(theirs))).max() <= within_mm


@pytest.mark.parametrize("variant", ["default", "original"])
def test_the_circuit_board_takes_what_the_design_says_of_it(variant: DesignVariant) -> None:
    design = hardware_design_of_variant(SensorDesign(), variant)
    board = replace(
        design.board,
        thick_mm=1.0,
        led_inset_mm=(5.4, 3.1),
        driver_at_mm=(3.6, -2.7),
        usb_beyond_mm=0.2,
        led_mm=(3.5, 2.8, 0.7),
    )
    made = led_board_for_design(replace(design, board=board))
    assert made.outline.thickness_mm == 1.0
    assert np.array(made.leds.positions) == pytest.approx(
        np.array([*replace(design, board=board).horizontal_dimensions.leds])
    )
    assert (made.driver_x_mm, made.driver_inset_mm) == (3.6, 2.7)
    assert made.usb_inset_mm == pytest.approx(3.2 + 0.14)
    assert led_board_for_design(design).usb_inset_mm == pytest.approx(LedBoardDesign().usb_inset_mm)


def test_a_circuit_board_is_as_thick_as_its_shell_has_room_for() -> None:
    """On posts lower by 0.8 mm, a board of the usual thickness has its LEDs where the published one has."""
    design = default_hardware_design()
    base = replace(design.base, post_tall_mm=design.base.post_tall_mm - 0.8, boss_tall_mm=2.5)
    low = replace(design, base=base, fasteners=FastenerDimensions(insert_mm=(3.3, 4.0)))
    slot = replace(design.shell, slot_from_mm=0.7, slot_to_mm=4.2)
    thick = replace(low, board=replace(design.board, thick_mm=1.6), shell=slot)
    require_buildable_design(thick)
    made = led_board_for_design(thick)
    assert made.outline.thickness_mm == 1.6
    assert "Thickness: 1.6 mm.\n" in format_fabrication_notes(lay_out_board(made))
    thin = replace(thick, board=LedBoardDimensions())
    for each, words in ((thin, "not made"), (design, "against the shell")):
        notes = format_fabrication_notes(lay_out_board(led_board_for_design(each)))
        assert re.search(rf"Thickness: 0\.8 mm\. NOT the usual 1\.6 mm, .*{words}\.\n", notes)


@pytest.mark.parametrize("name", ["led_mm", "usb_mm", "driver_mm"])
def test_a_part_that_the_circuit_board_has_no_pads_for_is_refused(name: str) -> None:
    design = default_hardware_design()
    size = getattr(design.board, name)
    other = replace(design, board=replace(design.board, **{name: (size[0] - 0.2, *size[1:])}))
    with pytest.raises(LedBoardImpossible, match=rf"expected board\.{name} .*, got .*; "):
        led_board_for_design(other)


def test_calibrate_and_demo_take_a_design(tmp_path: Path) -> None:
    path = written(tmp_path, design_to_toml(OURS) + "\n[hardware.shell]\nwall_mm = 2.4\n")
    assert CalibrateCommand(out=tmp_path, design_file=path).resolved_design == OURS
    assert CalibrateCommand(out=tmp_path, design_file=path, ball_radius_mm=3.0).resolved_design.ball.radius_mm == 3.0
    with pytest.raises(DesignGivenTwice):
        _ = CalibrateCommand(out=tmp_path, design_file=path, design=SensorDesign(gel=Gel(3.0))).resolved_design
    assert Demo(design_file=path).twin.thickness_mm == OURS.gel.thickness_mm


def test_a_design_may_come_through_a_pipe(tmp_path: Path) -> None:
    """It is read once: a pipe has nothing to give a second time."""
    pipe = tmp_path / "design.toml"
    os.mkfifo(pipe)
    writer = Thread(target=pipe.write_text, args=("[gel]\nthickness_mm = 2.0\n[hardware.shell]\nwall_mm = 2.4\n",))
    writer.start()
    found = read_hardware_design(pipe, "default")
    writer.join()
    assert (found.sensor.gel.thickness_mm, found.shell.wall_mm) == (2.0, 2.4)

"""A sensor folder is written whole, read back the same, and refused in words when something is wrong with it."""

import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ninedtact.calibration.drift.diagnosis import diagnose_drift
from ninedtact.calibration.drift.measurement import load_calibrated_reference, measure_drift
from ninedtact.calibration.original_9dtact.import_export import export_original_calibration
from ninedtact.calibration.procedure import (
    Calibration,
    calibrate,
    repeat_calibration,
)
from ninedtact.calibration.save import (
    SensorFolderNotReplaceable,
    create_sensor_folder,
    require_replaceable_sensor_folder,
    save_sensor,
    to_sensor_toml,
)
from ninedtact.calibration.sensor_folder import SensorFolder, SensorFolderDamaged, load_sensor
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    GridTable,
    KnownLoadTable,
    LensCorrectionTable,
    PinMapTable,
)
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.capture.camera_delay import CameraDelay, write_camera_delay
from ninedtact.cli import main
from ninedtact.cli.calibrate import CalibrateCommand
from ninedtact.cli.original_calibration import ImportCalibrationCommand
from ninedtact.design import BallGauge, Gel, SensorDesign
from ninedtact.errors import CalibrationError, ForceEstimationError, InputError
from ninedtact.force.estimator_and_scale import ForceScale, NoForceEstimator, write_force_scale


@pytest.fixture
def folder(sensor_a: SensorFolder, tmp_path: Path) -> Path:
    return shutil.copytree(sensor_a.path, tmp_path / "sensor")


def test_what_is_read_is_what_was_written(calibrated_a: Calibration, tmp_path: Path) -> None:
    sensor = load_sensor(save_sensor(tmp_path / "sensor", calibrated_a).path)
    kept = msgspec.structs.replace(sensor.record, images={})
    assert kept == calibrated_a.record
    assert np.array_equal(sensor.rectification.source_px, calibrated_a.rectify.source_px)
    assert np.array_equal(sensor.stored_image("ball").image, calibrated_a.images.ball)


def test_the_papers_lens_is_read_back_too(calibrated_a: Calibration, tmp_path: Path) -> None:
    made = calibrate(calibrated_a.images, settings=CalibrationSettings(lens="paper", method="table"))
    sensor = load_sensor(save_sensor(tmp_path / "paper", made).path)
    assert np.array_equal(sensor.rectification.source_px, made.rectify.source_px)
    assert made.record.grid.mm_per_px == pytest.approx(0.0510150969, rel=2e-3)


@pytest.mark.usefixtures("without_type_checks")
@pytest.mark.parametrize("choice", [{"lens": "Paper"}, {"method": "phisics"}, {"camera_rotation_deg": 45}])
def test_a_choice_of_a_calibration_that_does_not_exist_is_refused(choice: dict[str, Any]) -> None:
    (name, value), *_ = choice.items()
    with pytest.raises(InputError, match=f"^expected {name} of CalibrationSettings to be one of .*, got {value!r}"):
        CalibrationSettings(**choice)


@pytest.mark.parametrize("version", [3, 99])
def test_another_format_is_refused(folder: Path, version: int) -> None:
    edit(folder, f"format = {SENSOR_FORMAT}", f"format = {version}")
    with pytest.raises(
        SensorFolderDamaged, match=f"in format {SENSOR_FORMAT}, got format {version} .*; calibrate the sensor again"
    ):
        load_sensor(folder)


def test_points_come_with_as_many_values_and_an_area_has_a_width_and_a_height() -> None:
    points = [(0.0, 1.0), (2.0, 3.0)]
    for make, name in ((lambda *lists: LensCorrectionTable(3.0, *lists), "weights_px"), (PinMapTable, "points_px")):
        make(points, points)
        with pytest.raises(ValueError, match=f"2 points_mm and 1 {name}"):
            make(points, points[:1])
    with pytest.raises(ValueError, match="without area"):
        GridTable(0.05, 480, 640, (-1.0, 2.0, 4.0, 4.0))


OUT_OF_BOUNDS = {
    r"depth.noise_mm = nan \(Expected `float` >= 0.0\)": ("noise_mm = 0.00", "noise_mm = nan #"),
    r"twin.fit.parameters.x_mm.std = -1 \(Expected `float` >= 0.0\)": ("\nstd = ", "\nstd = -1 #"),
    r"twin.gel.shear_modulus_mpa = 93 \(Expected `float` <= 3.0\)": (
        "[twin.gel]",
        "[twin.gel]\nshear_modulus_mpa = 93\n[unread]",
    ),
    r"grid.raw_rows = 48000000 \(Expected `int` <= 20000\)": ("raw_rows = 480", "raw_rows = 48000000"),
}
"""The sentence on each edit, and the edit."""


@pytest.mark.parametrize("sentence", OUT_OF_BOUNDS)
def test_a_number_beyond_its_bounds_is_refused_by_name_value_and_what_is_possible(sentence: str, folder: Path) -> None:
    edit(folder, *OUT_OF_BOUNDS[sentence])
    with pytest.raises(SensorFolderDamaged, match=sentence):
        load_sensor(folder)


@pytest.mark.parametrize("name", ["", "../../x", "a\\nb\\u0000", "n" * 101, "a\\u202Eb", "a\\u009B2J"])
def test_a_name_that_no_sensor_can_have_is_refused(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (folder / "sensor.toml").read_text()
    (folder / "sensor.toml").write_text(re.sub('^id = ".*"', lambda _: f'id = "{name}"', text, flags=re.MULTILINE))
    with pytest.raises(SensorFolderDamaged, match="expected a name of a sensor of 1 to 100 printable characters"):
        load_sensor(folder)
    if name:  # without a name it is that of the folder
        assert main(["calibrate", "--images=no", f"--out={folder.parent / 'new'}", f"--id={name[:1]}/"]) == 1
        assert main(["calibrate", "--images=no", f"--out={folder.parent}/caf\udce9"]) == 1
        assert capsys.readouterr().err.count("expected a name of a sensor") == 2


def test_an_edited_number_is_a_warning_of_every_reading(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record, written = folder / "sensor.toml", (folder / "sensor.toml").read_text()
    record.write_text("# a remark\n" + written.replace('id = "', 'id = "my ', 1))
    assert load_sensor(folder).notices == ()
    given = [*(f"--{name}={folder}/images/ball_reference.png" for name in ("reference",)), f"{folder}/images/ball.png"]
    for text, reason in (
        (written.replace("noise_mm = 0.00", "noise_mm = 0.01", 1), "its checksum is not that of its numbers"),
        ("\n".join(line for line in written.splitlines() if not line.startswith("checksum")), "it has no checksum;"),
    ):
        record.write_text(text)
        assert main(["estimate", f"--sensor={folder}", "--json", *given]) == 0
        printed = capsys.readouterr()
        assert f"sensor.toml was edited or damaged after the calibration: {reason}" in printed.err
        assert "calibration edited" in json.loads(printed.out)["wrenches"][0]["warnings"]


@pytest.mark.parametrize(
    "command",
    [
        "adapt {sensor} --reference=no.png --press no.png 100",
        "check {sensor} no.png",
        "collect {sensor} --source=no.mcap --force-torque=no.mcap --out={out}.mcap",
        "estimate {sensor} --reference=no.png no.png",
        "export-calibration {sensor} --out={out}",
        "live {sensor} --source=no.mcap",
        "reconstruct {sensor} --reference=no.png --out={out} no.png",
        "record {sensor} --source=no.mcap --out={out}.mcap",
        "simulate fit {sensor}",
        "simulate press {sensor} --object=no --depth-mm=1 --out={out}",
    ],
)
def test_every_command_with_a_sensor_says_that_it_was_edited(
    command: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What each command needs besides the sensor is missing, so that it ends there."""
    edit(folder, "noise_mm = 0.00", "noise_mm = 0.01")
    (folder / "images" / "ball.png").unlink()
    main(command.format(sensor=f"--sensor={folder}", out=tmp_path / "out").split())
    assert capsys.readouterr().err.count("sensor.toml was edited or damaged after the calibration") == 1


def test_a_pipe_in_place_of_a_file_is_refused_at_once(folder: Path) -> None:
    (folder / "images" / "ball.png").unlink()
    os.mkfifo(folder / "images" / "ball.png")
    with pytest.raises(SensorFolderDamaged, match="a pipe or a device"):
        load_sensor(folder).stored_image("ball")
    (folder / "sensor.toml").unlink()
    os.mkfifo(folder / "sensor.toml")
    with pytest.raises(SensorFolderDamaged, match="a pipe or a device"):
        load_sensor(folder)


DAMAGE = {
    "no record": lambda folder: (folder / "sensor.toml").unlink(),
    "not text": lambda folder: (folder / "sensor.toml").write_bytes(b"\xff\xfe\x00"),
    "cut": lambda folder: (folder / "sensor.toml").write_text((folder / "sensor.toml").read_text()[:700]),
    "a falling curve": lambda folder: edit(folder, "darkening = [\n        0.0,", "darkening = [\n        7.0,"),
}


def edit(folder: Path, old: str, new: str) -> None:
    text = (folder / "sensor.toml").read_text()
    changed = text.replace(old, new, 1)
    (folder / "sensor.toml").write_text(
        changed if changed != text else text.replace("darkening = [", "darkening = [9.0,")
    )


@pytest.mark.parametrize("how", DAMAGE)
def test_damage_is_said(how: str, folder: Path) -> None:
    DAMAGE[how](folder)
    with pytest.raises(SensorFolderDamaged, match="expected"):
        load_sensor(folder)


def test_a_changed_or_missing_image_is_said(folder: Path) -> None:
    image = folder / "images" / "ball.png"
    image.write_bytes(image.read_bytes() + b"x")
    with pytest.raises(SensorFolderDamaged, match="other content"):
        load_sensor(folder).stored_image("ball")
    image.unlink()
    with pytest.raises(SensorFolderDamaged, match="no such file"):
        load_sensor(folder).stored_image("ball")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
@given(st.data())
def test_any_damage_to_the_record_is_refused_or_harmless(calibrated_a: Calibration, tmp_path: Path, data) -> None:
    content = bytearray(to_sensor_toml(calibrated_a.record))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.integers(0, len(content)))] if data.draw(st.booleans()) else content
    (tmp_path / "sensor.toml").write_bytes(bytes(content))
    try:
        load_sensor(tmp_path)
    except SensorFolderDamaged as refusal:
        assert "expected" in str(refusal)


@pytest.mark.parametrize("beside", ["plan.txt", "sensor.toml"])
def test_something_else_is_never_overwritten(calibrated_a: Calibration, tmp_path: Path, beside: str) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / beside).write_text("")
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    with pytest.raises(SensorFolderNotReplaceable, match=r"chapter\.tex"):
        save_sensor(tmp_path / "thesis", calibrated_a)
    assert (tmp_path / "thesis" / "chapter.tex").read_text() == "years of work"


@pytest.mark.parametrize("kept", ["images/today.png", "images/second_press/ball.png", "original_9dtact/notes.txt"])
def test_files_of_the_user_in_the_folders_of_a_sensor_are_never_deleted(kept: str, folder: Path) -> None:
    require_replaceable_sensor_folder(folder)
    (folder / kept).parent.mkdir(parents=True, exist_ok=True)
    (folder / kept).write_text("mine")
    with pytest.raises(SensorFolderNotReplaceable, match=re.escape(kept)), create_sensor_folder(folder):
        pass
    assert (folder / kept).read_text() == "mine"


@pytest.mark.parametrize("place", [".", "../.."])
def test_the_working_directory_is_not_replaced(
    place: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "images" / "deeper").mkdir()
    monkeypatch.chdir(folder / "images" / "deeper" if place == "../.." else folder)
    assert main(["simulate", "fit", "--sensor", place]) == 1
    assert "run it from another folder" in capsys.readouterr().err
    assert load_sensor(folder).record.twin is not None


def test_an_older_calibration_survives_a_failed_one(folder: Path) -> None:
    before = (folder / "sensor.toml").read_bytes()
    with pytest.raises(KeyboardInterrupt), create_sensor_folder(folder) as partial:
        (partial / "sensor.toml").write_text("half of")
        raise KeyboardInterrupt
    assert (folder / "sensor.toml").read_bytes() == before
    assert [entry.name for entry in folder.parent.iterdir()] == [folder.name]


def calibrate_command(out: Path, images: Path, names: tuple[str, ...], **options: Any) -> int:
    """Run the command on some of the images of a folder, by the method that is done soonest unless `options` say another."""
    images_given = {name: (images / f"{name}.png",) for name in names}
    return CalibrateCommand(out, **images_given, **{"settings": CalibrationSettings(method="ratio"), **options}).run()


def test_a_board_alone_rectifies_and_a_ball_completes_it(
    twin_sensor: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images, out = twin_sensor.path / "images", tmp_path / "finger"
    assert calibrate_command(out, images, ("board_reference", "board")) == 0
    assert "No ball has been pressed" in (out / "certificate.html").read_text()
    assert "heights, force, 'ninedtact check' and the twin are missing" in capsys.readouterr().out
    alone, frame = load_sensor(out), twin_sensor.stored_image("ball")
    np.testing.assert_array_equal(alone.rectification(frame).grey, twin_sensor.rectification(frame).grey)
    advice = f"ninedtact calibrate --out {out} --ball-reference REFERENCE.png --ball BALL.png"
    for needs_depth in (
        lambda: alone.shape,
        lambda: load_calibrated_reference(alone),
        lambda: repeat_calibration(alone, "physics"),
    ):
        with pytest.raises(CalibrationError, match=advice):
            needs_depth()
    with pytest.raises(CalibrationError, match=advice):
        alone.twin()

    assert calibrate_command(out, images, ("ball_reference", "ball")) == 0
    whole = load_sensor(out)
    assert (whole.record.lens, whole.record.depth) == (twin_sensor.record.lens, twin_sensor.record.depth)
    assert whole.record.certificate == twin_sensor.record.certificate
    assert whole.id == "finger"

    with pytest.raises(InputError, match="choose another --out"):
        calibrate_command(out, images, ("board_reference", "board"))
    with pytest.raises(InputError, match="images of the ball alone"):
        calibrate_command(tmp_path / "new", images, ("ball_reference", "ball"))
    assert load_sensor(out).record == whole.record


def test_a_ball_alone_is_measured_with_the_radius_that_is_given(twin_sensor: SensorFolder, tmp_path: Path) -> None:
    images, out, ball = twin_sensor.path / "images", tmp_path / "finger", ("ball_reference", "ball")
    shutil.copytree(twin_sensor.path, out)
    design_file = tmp_path / "design.toml"
    design_file.write_text("[ball]\nradius_mm = 4.4\n")
    for options, radius_mm in (({"design_file": design_file}, 4.4), ({}, 4.4)):
        calibrate_command(out, images, ball, **options)
        record = load_sensor(out).record
        assert record.design.ball.radius_mm == radius_mm and record.certificate.ball.ball_radius_mm == radius_mm
    with pytest.raises(InputError):
        calibrate_command(out, images, ball, design=SensorDesign(ball=BallGauge(4.4), gel=Gel(thickness_mm=3.0)))


def test_a_calibration_says_which_later_measurements_it_removes(
    twin_sensor: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images, out, ball = twin_sensor.path / "images", tmp_path / "finger", ("ball_reference", "ball")
    shutil.copytree(twin_sensor.path, out)
    write_force_scale(out, NoForceEstimator(), ForceScale(1.2))
    write_camera_delay(out, CameraDelay(30.0, 1.0))
    known = KnownLoadTable(4, 0.05, 0.1, 0.02, 0.9, 0.05, 0.04)
    (out / "sensor.toml").write_bytes(to_sensor_toml(msgspec.structs.replace(twin_sensor.record, known_loads=known)))
    assert load_sensor(out).record.known_loads == known
    with pytest.raises(InputError):
        calibrate_command(out, images, ball, settings=CalibrationSettings(lens="paper"))
    assert "removed" not in capsys.readouterr().err and (out / "force.toml").is_file()
    calibrate_command(out, images, ball)
    said = capsys.readouterr().err
    assert f"({out / 'force.toml'}) was removed" in said and "run 'ninedtact adapt' again" in said
    assert f"({out / 'sensor.toml, known_loads'}) was removed" in said
    assert f"({out / 'camera.toml'}) was removed" in said and "run 'ninedtact camera-delay' again" in said
    assert not (out / "force.toml").exists() and not (out / "camera.toml").exists()


def test_images_of_a_ball_upgrade_an_imported_sensor(
    twin_sensor: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    original, images, out = tmp_path / "sensor_3", twin_sensor.path / "images", tmp_path / "finger"
    export_original_calibration(twin_sensor, original)
    ImportCalibrationCommand(original, out).run()
    upgrade = f"--from-import {out} --out {out} --ball-reference REFERENCE.png --ball BALL.png"
    said = capsys.readouterr().out
    assert "no force, no twin and no 'ninedtact check'" in said and upgrade in said
    imported, reference = load_sensor(out), twin_sensor.stored_image("ball_reference")
    for needs_ball in (imported.twin, lambda: load_calibrated_reference(imported), imported.estimator):
        with pytest.raises((CalibrationError, SensorFolderDamaged, ForceEstimationError), match=upgrade):
            needs_ball()

    ball, physics = ("ball_reference", "ball"), CalibrationSettings()
    assert calibrate_command(out, images, ball, from_import=out, settings=physics) == 0
    upgraded = load_sensor(out)
    assert upgraded.id == "sensor_3" and upgraded.record.grid == imported.record.grid
    np.testing.assert_array_equal(upgraded.rectification.source_px, imported.rectification.source_px)
    assert "imported from the original project and is used as it is" in (out / "certificate.html").read_text()
    certificate = upgraded.record.certificate
    assert certificate is not None and certificate.board is None and certificate.ball is not None
    assert certificate.ball.max_indentation_mm == pytest.approx(1.8, abs=0.1)  # the depth that was simulated
    shown = upgraded.twin().renderer(None, 0).astype(float)
    assert np.abs(shown - reference.image).mean() < 2
    findings = diagnose_drift(measure_drift(load_calibrated_reference(upgraded), reference.image))
    assert [finding.diagnosis for finding in findings] in ([], ["fine"])
    assert upgraded.estimator("physics").name

    with pytest.raises(InputError, match="beside --from-import"):
        calibrate_command(out, images, ("board_reference", "board"), from_import=out)


def test_images_of_half_a_press_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in ("--board", "--ball-reference"):
        assert main(["calibrate", f"--out={tmp_path / 'sensor'}", option, "image.png"]) == 1
        assert (
            f"or the two of one press, or --images alone, or --source alone, got {option};" in capsys.readouterr().err
        )

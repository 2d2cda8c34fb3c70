"""A calibration that failed its checks is saved, but never in the place of a better one."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import pytest

from ninedtact.calibration.procedure import Calibration
from ninedtact.calibration.save import (
    SensorFolderNotReplaceable,
    failed_calibration_notices,
    save_sensor,
    to_sensor_toml,
)
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder, load_sensor
from ninedtact.calibration.sensor_toml_schema import SENSOR_FORMAT, SensorTomlRecord
from ninedtact.cli import main


def as_failed(record: SensorTomlRecord) -> SensorTomlRecord:
    """The record as if the camera were too noisy to measure with."""
    certificate = record.certificate
    assert certificate is not None and certificate.ball is not None
    noisy = msgspec.structs.replace(certificate, ball=msgspec.structs.replace(certificate.ball, noise_mm=0.1))
    return msgspec.structs.replace(record, certificate=noisy)


@pytest.fixture
def failed(calibrated_twin: Calibration) -> Calibration:
    return replace(calibrated_twin, record=as_failed(calibrated_twin.record))


def keep_good(folder: Path) -> None:
    """Leave the calibrated sensor as it is."""


def make_failed(folder: Path) -> None:
    (folder / SENSOR_FILE).write_bytes(to_sensor_toml(as_failed(load_sensor(folder).record)))


def make_older_format(folder: Path) -> None:
    text = (folder / SENSOR_FILE).read_text()
    (folder / SENSOR_FILE).write_text(text.replace(f"format = {SENSOR_FORMAT}", "format = 3"))


@pytest.mark.parametrize(("make", "stays"), [(keep_good, True), (make_older_format, True), (make_failed, False)])
def test_a_failed_calibration_replaces_only_a_failed_one(
    make: Callable[[Path], None],
    stays: bool,
    twin_sensor: SensorFolder,
    calibrated_twin: Calibration,
    failed: Calibration,
    tmp_path: Path,
) -> None:
    out, beside = shutil.copytree(twin_sensor.path, tmp_path / "finger"), tmp_path / "finger_failed"
    make(out)
    before = (out / SENSOR_FILE).read_bytes()
    again = replace(failed, record=msgspec.structs.replace(failed.record, id="again"))
    for _ in range(2 if make is keep_good else 1):  # the second replaces the first
        assert save_sensor(out, again).path == (beside if stays else out)
    assert ((out / SENSOR_FILE).read_bytes() == before) is stays
    assert load_sensor(beside if stays else out).id == "again"
    assert {path.name for path in tmp_path.iterdir()} == ({"finger", "finger_failed"} if stays else {"finger"})
    if make is make_older_format:
        assert save_sensor(out, calibrated_twin).path == out  # a good one replaces any


def test_what_is_beside_the_sensor_is_kept_too(twin_sensor: SensorFolder, failed: Calibration, tmp_path: Path) -> None:
    for name in ("finger", "finger_failed"):
        shutil.copytree(twin_sensor.path, tmp_path / name)
    (tmp_path / "finger_failed_2").write_text("mine")
    assert save_sensor(tmp_path / "finger", failed).path == tmp_path / "finger_failed_3"
    assert load_sensor(tmp_path / "finger_failed").notices == ()
    assert (tmp_path / "finger_failed_2").read_text() == "mine"
    with pytest.raises(SensorFolderNotReplaceable):
        save_sensor(tmp_path / "finger_failed_2", failed)


def test_everyone_is_told_that_a_calibration_failed_and_which_sensor_stays(
    twin_sensor: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A glaring strip at the border makes the check of the light fail; the gel is stated half as thick as it is."""
    images, out = tmp_path / "images", tmp_path / "finger"
    shutil.copytree(twin_sensor.path / "images", images)
    for name in ("ball_reference", "ball"):
        image = cv2.imread(str(images / f"{name}.png"))
        image[:, :60] = 255
        cv2.imwrite(str(images / f"{name}.png"), image)
    shutil.copytree(twin_sensor.path, out)
    before = (out / SENSOR_FILE).read_bytes()
    command = ["calibrate", f"--images={images}", f"--out={out}", "--method=ratio", "--design.gel.thickness-mm=1.0"]
    assert main(command) == 1
    said, beside = capsys.readouterr(), load_sensor(Path(f"{out}_failed"))
    assert "Do not measure with this calibration" in said.out
    sentence = f"the new calibration failed its checks and is saved in {beside.path}; {out} keeps the older calibration"
    assert f"ninedtact: {sentence}\n" in said.err and (out / SENSOR_FILE).read_bytes() == before
    assert failed_calibration_notices(out, beside) == [sentence]
    assert failed_calibration_notices(beside.path, beside) == []
    certificate = beside.record.certificate
    assert certificate is not None and any("which is impossible" in each for each in certificate.warnings)
    main(["check", f"--sensor={beside.path}", str(twin_sensor.path / "images" / "ball_reference.png")])
    said_later = capsys.readouterr().err
    assert f"the calibration of {beside.path} failed its checks; do not measure with it" in said_later
    assert load_sensor(out).notices == ()

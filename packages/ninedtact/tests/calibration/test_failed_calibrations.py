"""A calibration that failed its checks is saved, but never in the place of a better one."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import pytest

from ninedtact.calibration.certificate import html_page
from ninedtact.calibration.procedure import Calibration
from ninedtact.calibration.save import SensorFolderNotReplaceable, save_sensor
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder, load_sensor
from ninedtact.cli import main
from ninedtact.studio.calibration_page import calibration_result_html
from ninedtact.studio.calibration_session import CalibrationPhase, CalibrationState


@pytest.fixture(autouse=True)
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody looks at the figures of these certificates, which take most of the time of saving."""
    names = (*html_page.BOARD_IMAGES, *html_page.BALL_IMAGES, "rest", "profile")
    monkeypatch.setattr(html_page, "_plot_certificate_images", lambda calibration: dict.fromkeys(names, b""))


@pytest.fixture
def failed(calibrated_a: Calibration) -> Calibration:
    """Sensor A as if its camera were too noisy to measure with."""
    certificate = calibrated_a.record.certificate
    assert certificate is not None and certificate.ball is not None
    noisy = msgspec.structs.replace(certificate, ball=msgspec.structs.replace(certificate.ball, noise_mm=0.1))
    return replace(calibrated_a, record=msgspec.structs.replace(calibrated_a.record, certificate=noisy))


def as_failed(folder: Path, good: Calibration, failed: Calibration) -> None:
    save_sensor(folder, failed)


def as_good(folder: Path, good: Calibration, failed: Calibration) -> None:
    save_sensor(folder, good)


def as_older_format(folder: Path, good: Calibration, failed: Calibration) -> None:
    save_sensor(folder, good)
    text = (folder / SENSOR_FILE).read_text()
    (folder / SENSOR_FILE).write_text(text.replace("format = 4", "format = 3"))


Make = Callable[[Path, Calibration, Calibration], None]


@pytest.mark.parametrize(("make", "stays"), [(as_good, True), (as_older_format, True), (as_failed, False)])
def test_a_failed_calibration_replaces_only_a_failed_one(
    make: Make, stays: bool, calibrated_a: Calibration, failed: Calibration, tmp_path: Path
) -> None:
    out, beside = tmp_path / "finger", tmp_path / "finger_failed"
    make(out, calibrated_a, failed)
    before = (out / SENSOR_FILE).read_bytes()
    again = replace(failed, record=msgspec.structs.replace(failed.record, id="again"))
    for _ in range(2):  # the second replaces the first
        assert save_sensor(out, again).path == (beside if stays else out)
    assert ((out / SENSOR_FILE).read_bytes() == before) is stays
    assert load_sensor(beside if stays else out).id == "again"
    assert {path.name for path in tmp_path.iterdir()} == ({"finger", "finger_failed"} if stays else {"finger"})
    assert save_sensor(out, calibrated_a).path == out  # a good one replaces any


def test_what_is_beside_the_sensor_is_kept_too(calibrated_a: Calibration, failed: Calibration, tmp_path: Path) -> None:
    out = tmp_path / "finger"
    save_sensor(out, calibrated_a)
    save_sensor(tmp_path / "finger_failed", calibrated_a)
    (tmp_path / "finger_failed_2").write_text("mine")
    assert save_sensor(out, failed).path == tmp_path / "finger_failed_3"
    assert (
        load_sensor(tmp_path / "finger_failed").notices == () and (tmp_path / "finger_failed_2").read_text() == "mine"
    )
    with pytest.raises(SensorFolderNotReplaceable):
        save_sensor(tmp_path / "finger_failed_2", failed)


def test_a_failed_calibration_and_the_sensor_that_stays_are_named(
    twin_sensor: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A glaring strip at the border makes the check of the light fail."""
    images, out = tmp_path / "images", tmp_path / "finger"
    shutil.copytree(twin_sensor.path / "images", images)
    for name in ("ball_reference", "ball"):
        image = cv2.imread(str(images / f"{name}.png"))
        image[:, :60] = 255
        cv2.imwrite(str(images / f"{name}.png"), image)
    command = ["calibrate", f"--images={images}", f"--out={out}", "--method=ratio", "--json"]
    assert main(command) == 1
    said = capsys.readouterr()
    assert (json.loads(said.out)["sensor"], said.err) == (str(out), "")  # a first one is saved where it was wanted

    shutil.rmtree(out)
    shutil.copytree(twin_sensor.path, out)
    before = (out / SENSOR_FILE).read_bytes()
    assert main(command) == 1
    said = capsys.readouterr()
    assert json.loads(said.out)["sensor"] == f"{out}_failed"
    sentence = f"the new calibration failed its checks and is saved in {out}_failed; {out} keeps the older calibration"
    assert said.err == f"ninedtact: {sentence}\n"
    assert (out / SENSOR_FILE).read_bytes() == before

    beside = load_sensor(Path(f"{out}_failed"))
    on_page = calibration_result_html(CalibrationState(source="sim", phase=CalibrationPhase.RESULT, result=beside), out)
    assert sentence in on_page and sentence not in calibration_result_html(
        CalibrationState(source="sim", phase=CalibrationPhase.RESULT, result=beside), beside.path
    )

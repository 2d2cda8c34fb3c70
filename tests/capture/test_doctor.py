"""The doctor finds cameras, tells their true rate, and is not upset by a machine that has none."""

import json
import tomllib
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from bench_camera import BenchCamera, BenchCapture
from hand_fed import HandFed
from mjpeg_camera import MjpegCamera
from packaging.requirements import Requirement

from ninedtact._version import installation_command
from ninedtact.capture.camera_check import (
    CameraCheck,
    FrameRateUnmeasurable,
    camera_settings_advice,
    check_camera,
    duplicate_frame_advice,
    measure_frame_rate,
)
from ninedtact.capture.frame_source import CameraLost, CameraNotFound, CameraSettings, SourceEnded, SourceUnknown
from ninedtact.capture.uvc_camera import CameraDevice, UvcCamera, list_cameras
from ninedtact.cli.doctor import EXTRAS, Doctor, camera_lines

ROOT = Path(__file__).parents[2]


def test_images_that_come_twice_are_told_from_the_true_rate() -> None:
    source = HandFed()
    for number in range(45):
        source.show(level=number // 2, stamp_ns=1_000_000_000 + number * 10_000_000)
    rate = measure_frame_rate(source, frames=40)
    assert rate.delivered_hz == pytest.approx(100)
    assert rate.true_hz == pytest.approx(50)
    assert rate.jitter_ms == pytest.approx(0, abs=1e-6)
    assert (rate.frames, rate.duplicates) == (40, 20)
    assert "20 of 40 images repeat" in duplicate_frame_advice(rate)[0]


def test_a_frozen_image_has_no_rate() -> None:
    source = HandFed()
    for number in range(10):
        source.show(stamp_ns=number)
    source.fail(SourceEnded("over"))
    with pytest.raises(FrameRateUnmeasurable, match=r"expected at least 3 different images .* got 1;"):
        measure_frame_rate(source)
    source.show()
    source.fail(SourceEnded("over"))
    assert "different images" in (check_camera(source).trouble or "")


def test_cameras_are_listed_by_number_with_their_names(tmp_path: Path) -> None:
    for number, name in ((10, "9DTact"), (2, "Laptop camera"), (0, None)):
        (tmp_path / f"video{number}").mkdir()
        if name is not None:
            (tmp_path / f"video{number}" / "name").write_text(name + "\n")
    assert list_cameras(tmp_path, Path("/nowhere")) == [
        CameraDevice("/nowhere/video0", "unnamed"),
        CameraDevice("/nowhere/video2", "Laptop camera"),
        CameraDevice("/nowhere/video10", "9DTact"),
    ]
    assert list_cameras(tmp_path / "not linux") == []


def usb_camera(bus: Path, number: int, port: str, serial: str | None) -> None:
    """A camera as the kernel lists it: its node points to a USB interface, inside the device with the serial number."""
    interface = bus / "devices" / port / f"{port}:1.0"
    interface.mkdir(parents=True)
    if serial is not None:
        (interface.parent / "serial").write_text(serial + "\n")
    node = bus / f"video{number}"
    node.mkdir()
    (node / "name").write_text("9DTact\n")
    (node / "device").symlink_to(interface)


def test_a_camera_is_found_by_its_port_or_serial_number_whatever_its_number(tmp_path: Path) -> None:
    opened = []

    def opener(device: int | str) -> BenchCapture:
        opened.append(device)
        return BenchCapture(BenchCamera())

    for boot, numbers in enumerate(((0, 2), (2, 0))):
        bus = tmp_path / str(boot)
        usb_camera(bus, numbers[0], "1-2", "A17")
        usb_camera(bus, numbers[1], "1-3.4", None)
        cameras = partial(list_cameras, bus, Path("/nowhere"))
        for address in ("usb:1-2", "usb:A17", "usb:1-3.4"):
            with UvcCamera(address, opener=opener, list_devices=cameras) as camera:
                assert camera.name == f"camera {address}"
    assert opened == [f"/nowhere/video{number}" for number in (0, 0, 2, 2, 2, 0)]
    with pytest.raises(
        CameraNotFound, match=r"at usb:9-9, got none; .*usb:1-3.4 \(9DTact\), usb:1-2 or usb:A17 \(9DTact\)"
    ):
        UvcCamera("usb:9-9", opener=opener, list_devices=cameras).open()
    usb_camera(bus, 4, "1-5", "A17")
    with pytest.raises(CameraNotFound, match="expected one camera at usb:A17, got 2"):
        UvcCamera("usb:A17", opener=opener, list_devices=cameras).open()


def test_a_camera_that_stops_is_not_called_unplugged_while_it_is_there() -> None:
    for device, said in (("/dev/null", "it is still plugged in"), ("/dev/video-not-there", "check that it is plugged")):
        bench = BenchCamera()
        with UvcCamera(device, opener=bench.open_capture) as camera:
            camera.read()
            bench.plugged_in = False
            with pytest.raises(CameraLost, match=said):
                camera.read()


def test_no_camera_is_an_answer(capsys: pytest.CaptureFixture[str]) -> None:
    assert Doctor().run() == 0
    words = capsys.readouterr().out
    assert "cameras" in words and "opencv" in words and "optional parts" in words
    assert Doctor(json=True).run() == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) == {"versions", "cameras", "extras"}
    assert {"ninedtact", "python", "opencv", "numpy"} <= set(report["versions"])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {extra["name"] for extra in report["extras"]} == set(project["optional-dependencies"]) - {"dev", "docs"}
    for extra in report["extras"]:
        assert extra["get_it"] == installation_command(extra["name"])
        assert extra["get_it"] == f"pip install -e '{ROOT}[{extra['name']}]'" and extra["what_for"]
        packages = {Requirement(text).name for text in project["optional-dependencies"][extra["name"]]}
        assert len(EXTRAS[extra["name"]][0]) == len(packages)


def test_a_stream_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    with MjpegCamera() as camera:
        assert Doctor(camera.url, json=True).run() == 0
        (found,) = json.loads(capsys.readouterr().out)["cameras"]
        assert found["size_px"] == [64, 48] and found["rate"]["true_hz"] > 1 and found["trouble"] is None
        assert Doctor(camera.url).run() == 0
        assert "64 x 48 pixels" in capsys.readouterr().out


def test_a_recording_is_named_as_one_and_a_wrong_source_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((6, 8, 3), np.uint8))
    assert Doctor(str(tmp_path)).run() == 0
    assert "8 x 6 pixels, a recording at 10 images per second" in capsys.readouterr().out
    (tmp_path / "a.png").unlink()
    assert Doctor(str(tmp_path), json=True).run() == 1
    assert "got none" in json.loads(capsys.readouterr().out)["cameras"][0]["trouble"]
    with pytest.raises(SourceUnknown, match="expected a camera"):
        Doctor("nonsense").run()


def test_a_camera_that_regulates_itself_is_pointed_out() -> None:
    regulated = CameraSettings(auto_exposure=True, auto_white_balance=True)
    assert len(camera_settings_advice(regulated)) == 2 and camera_settings_advice(CameraSettings()) == []
    lines = camera_lines(CameraCheck("camera 0", "9DTact", trouble="expected much, got little; wait"))
    assert lines == ["  camera 0 (9DTact)", "    expected much, got little; wait"]


def test_uneven_times_between_images_are_jitter() -> None:
    source = HandFed()
    for number in range(40):
        source.show(level=number, stamp_ns=1_000_000_000 + number * 10_000_000 + (number % 2) * 2_000_000)
    rate = measure_frame_rate(source, frames=35)
    assert rate.jitter_ms == pytest.approx(2.0, rel=0.01)  # 12 and 8 ms in turn
    assert rate.true_hz == pytest.approx(100, rel=0.01) and rate.duplicates == 0


def test_an_extra_is_installed_from_a_checkout_and_by_name_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    assert installation_command("train,datasets") == f"pip install -e '{ROOT}[train,datasets]'"
    monkeypatch.setattr("ninedtact._version._is_checkout", lambda folder: False)
    assert installation_command("train,datasets") == "pip install 'ninedtact[train,datasets]'"

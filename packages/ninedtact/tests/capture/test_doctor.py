"""The doctor finds cameras, tells their true rate, and is not upset by a machine that has none."""

import json
import os
import struct
import sys
import tomllib
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from bench_camera import BenchCamera, BenchCapture
from hand_fed import HandFed
from packaging.requirements import Requirement

from ninedtact._version import installation_command
from ninedtact.capture.camera_check import (
    CameraCheck,
    camera_settings_advice,
    check_camera,
    duplicate_frame_advice,
    measure_frame_rate,
)
from ninedtact.capture.frame_source import (
    FIXED_EXPOSURE,
    CameraLost,
    CameraSettings,
    ExposureWithLimits,
    SourceEnded,
    SourceNotOpen,
)
from ninedtact.capture.uvc_camera import CameraDevice, UvcCamera, list_cameras
from ninedtact.cli.doctor import EXTRAS, DoctorCommand, camera_lines
from ninedtact.errors import CameraError, InputError

ROOT = Path(__file__).parents[4]


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
    assert duplicate_frame_advice(replace(rate, duplicates=4)) == duplicate_frame_advice(None) == []
    assert "5 of 40 images" in duplicate_frame_advice(replace(rate, duplicates=5))[0]


def test_a_frozen_image_has_no_rate() -> None:
    source = HandFed()
    for number in range(10):
        source.show(stamp_ns=number)
    source.fail(SourceEnded("over"))
    with pytest.raises(CameraError, match=r"expected at least 3 different images .* in 5 s, got 1;"):
        measure_frame_rate(source)
    for number in range(10):
        source.show(min(number, 2), stamp_ns=number * 20_000_000)
    source.fail(SourceEnded("over"))
    rate = measure_frame_rate(source)  # ten images are too few to leave out the first five
    assert (rate.frames, rate.duplicates) == (10, 7) and rate.true_hz == rate.delivered_hz == pytest.approx(50)
    for number in range(11):
        source.show(number, stamp_ns=number * 20_000_000)
    source.fail(SourceEnded("over"))
    assert measure_frame_rate(source).frames == 6
    for number in range(65 + 66):
        source.show(number, stamp_ns=number * 20_000_000)
    assert measure_frame_rate(source).frames == 60
    rate = check_camera(source).rate  # after one image for the size
    assert rate is not None and rate.frames == 60
    assert isinstance(source.queue.get(), SourceNotOpen) and source.queue.empty()
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
    camera_behind(interface, bus, number)
    if serial is not None:
        (interface.parent / "serial").write_text(serial + "\n")


def camera_behind(interface: Path, bus: Path, number: int) -> None:
    """A camera as the kernel lists it: its node points to the interface that drives it."""
    interface.mkdir(parents=True)
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
        CameraError, match=r"at usb:9-9, got none; .*usb:1-3.4 \(9DTact\), usb:1-2 or usb:A17 \(9DTact\)"
    ):
        UvcCamera("usb:9-9", opener=opener, list_devices=cameras).open()
    with pytest.raises(CameraError, match=r"got none; .*\(this machine has none\)"):
        UvcCamera("usb:9-9", opener=opener, list_devices=list).open()
    usb_camera(bus, 4, "1-5", "A17")
    with pytest.raises(CameraError, match="expected one camera at usb:A17, got 2"):
        UvcCamera("usb:A17", opener=opener, list_devices=cameras).open()


def ioctl_number(direction: int, number: int, size: int) -> int:
    """_IOC of the kernel, include/uapi/asm-generic/ioctl.h, for Video4Linux; direction: 2 reads, 3 writes and reads."""
    return direction << 30 | size << 16 | ord("V") << 8 | number


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel of Linux is asked")
def test_the_kernel_is_asked_what_a_device_delivers_and_how_long_it_may_expose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The replies are laid out as struct v4l2_capability and v4l2_queryctrl of include/uapi/linux/videodev2.h."""
    # All together can capture and output; video0 itself captures, video1 delivers metadata, video2 captures in several planes.
    own_capabilities, lacking = {"video0": 0x0400_0001, "video1": 0x0480_0000, "video2": 0x0400_1000}, set()

    def ioctl(handle: int, request: int, reply: bytearray) -> None:
        name = Path(f"/proc/self/fd/{handle}").readlink().name
        assert (
            not os.get_blocking(handle) and len(reply) == request >> 16 & 0x3FFF
        )  # so much the kernel reads and writes
        if request == ioctl_number(2, 0, 104):
            struct.pack_into(
                "<16s32s32sIII", reply, 0, b"uvcvideo", b"9DTact", b"usb", 1, 0x8480_1003, own_capabilities[name]
            )
        elif (
            request == ioctl_number(3, 36, 68)
            and struct.unpack_from("<I", reply) == (0x009A_0902,)
            and name not in lacking
        ):
            struct.pack_into("<I32siiiiI", reply, 4, 1, b"Exposure Time, Absolute", 3, 2047, 1, 250, 0)
        else:
            raise OSError(25, "Inappropriate ioctl for device")

    monkeypatch.setattr("fcntl.ioctl", ioctl)
    for number in range(3):
        (tmp_path / "list" / f"video{number}").mkdir(parents=True)
        (tmp_path / f"video{number}").touch()
    found = [device.path for device in list_cameras(tmp_path / "list", tmp_path)]
    assert found == [str(tmp_path / "video0"), str(tmp_path / "video2")]
    with UvcCamera("/dev/null", FIXED_EXPOSURE, BenchCamera().open_capture) as camera:
        exposure = camera.exposure
        lacking.add("null")
        assert exposure == ExposureWithLimits(0.1, 0.3, 204.7) and camera.exposure == ExposureWithLimits(
            0.1, 0.1, 500.0
        )


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel of Linux is asked")
def test_modes_are_listed_and_what_the_camera_regulates_is_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """The replies are laid out as structs v4l2_fmtdesc, v4l2_frmsizeenum, v4l2_frmivalenum and v4l2_control."""
    on, stuck = {0x0098_0912: 1, 0x009A_0903: 1, 0x009A_090C: 0}, set()
    sizes = {b"YUYV": [(640, 480)], b"MJPG": [(640, 480), (1280, 800)]}

    def ioctl(handle: int, request: int, reply: bytearray) -> None:
        assert len(reply) == request >> 16 & 0x3FFF
        number, words = request & 0xFF, struct.unpack_from("<II", reply)
        if number == 0:
            struct.pack_into("<I", reply, 88, 0x0400_0001)
        elif number == 2 and words[1] == 1 and words[0] < 2:
            reply[44:48] = list(sizes)[words[0]]
        elif number == 74 and words[0] < len(sizes[bytes(reply[4:8])]):
            struct.pack_into("<III", reply, 8, 1, *sizes[bytes(reply[4:8])][words[0]])
        elif number == 75 and words[0] == 0:
            struct.pack_into("<III", reply, 16, 1, 1, 60 if reply[4:8] == b"MJPG" else 10)
        elif number == 27 and words[0] in on:
            struct.pack_into("<i", reply, 4, on[words[0]])
        elif number == 28 and words[0] in on and words[0] not in stuck:
            on[words[0]] = struct.unpack_from("<i", reply, 4)[0]
        else:
            raise OSError(22, "Invalid argument")

    monkeypatch.setattr("fcntl.ioctl", ioctl)
    check = check_camera(UvcCamera("/dev/null", CameraSettings(), BenchCamera().open_capture))
    assert "    MJPG: 640x480 at 60, 1280x800 at 60" in camera_lines(check) and len(check.modes) == 3
    assert any(on.values())
    with pytest.raises(CameraError, match=r"got 640x480; .* one that this one has \(640x480, 1280x800\)"):
        UvcCamera("/dev/null", CameraSettings(size_px=(853, 480)), BenchCamera().open_capture).open()
    with UvcCamera("/dev/null", FIXED_EXPOSURE, BenchCamera().open_capture):
        assert not any(on.values())
    on[0x0098_0912] = 1
    stuck.add(0x0098_0912)
    with pytest.raises(CameraError, match=r"switch automatic gain off, got still on.*--automatic"):
        UvcCamera("/dev/null", FIXED_EXPOSURE, BenchCamera().open_capture).open()


def test_why_a_camera_does_not_open_is_told(tmp_path: Path) -> None:
    absent, locked = BenchCamera(plugged_in=False), tmp_path / "locked"
    locked.touch(mode=0o000)
    permission = f"got no permission for {locked}; run `sudo usermod -aG video "
    for device, said in (
        (987, "got no device /dev/video987; plug it in, or name another \\(this machine has"),
        ("/dev/null", "got a refusal from /dev/null; close the other program"),
        (str(locked), permission if os.geteuid() else f"got a refusal from {locked}"),
    ):
        with pytest.raises(CameraError, match=f"expected camera {device} to open, {said}"):
            UvcCamera(device, opener=absent.open_capture).open()
    assert absent.held == 0


def test_a_camera_that_stops_is_not_called_unplugged_while_it_is_there() -> None:
    for device, said in (("/dev/null", "it is still plugged in"), ("/dev/video-not-there", "check that it is plugged")):
        bench = BenchCamera()
        with UvcCamera(device, opener=bench.open_capture) as camera:
            camera.read()
            bench.plugged_in = False
            with pytest.raises(CameraLost, match=said):
                camera.read()


def test_no_camera_is_an_answer(capsys: pytest.CaptureFixture[str]) -> None:
    assert DoctorCommand().run() == 0
    words = capsys.readouterr().out
    assert "cameras" in words and "opencv" in words and "optional parts" in words
    assert DoctorCommand(json=True).run() == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) == {"versions", "cameras", "extras"}
    assert {"ninedtact", "python", "opencv", "numpy"} <= set(report["versions"])
    project = tomllib.loads((ROOT / "packages/ninedtact/pyproject.toml").read_text())["project"]
    assert {extra["name"] for extra in report["extras"]} == set(project["optional-dependencies"]) - {"all"}
    for extra in report["extras"]:
        assert extra["get_it"] == installation_command(extra["name"])
        packages = {Requirement(text).name for text in project["optional-dependencies"][extra["name"]]}
        assert extra["what_for"] and len(EXTRAS[extra["name"]][0]) >= len(packages)


def test_a_recording_is_named_as_one_and_a_wrong_source_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((6, 8, 3), np.uint8))
    assert DoctorCommand(str(tmp_path)).run() == 0
    assert "8 x 6 pixels, a recording at 10 images per second" in capsys.readouterr().out
    (tmp_path / "a.png").unlink()
    assert DoctorCommand(str(tmp_path), json=True).run() == 1
    assert "got none" in json.loads(capsys.readouterr().out)["cameras"][0]["trouble"]
    with pytest.raises(InputError, match="expected a camera"):
        DoctorCommand("nonsense").run()


def test_a_damaged_file_is_named_as_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    video, folder = tmp_path / "press.avi", tmp_path / "images"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (64, 48))
    for level in range(30):
        writer.write(np.full((48, 64, 3), 5 * level, np.uint8))
    writer.release()
    assert DoctorCommand(str(video), json=True).run() == 0
    assert json.loads(capsys.readouterr().out)["cameras"][0]["trouble"] is None
    content = video.read_bytes()
    video.write_bytes(content[: len(content) // 2])
    assert DoctorCommand(str(video)).run() == 1
    said = capsys.readouterr().out
    assert "64 x 48 pixels, a recording at 30 images per second" in said
    assert f"expected every image of {video}, got a file that is cut or damaged: " in said
    folder.mkdir()
    for number in range(3):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((48, 64, 3), number, np.uint8))
    assert DoctorCommand(str(folder), json=True).run() == 0
    whole = (folder / "1.png").read_bytes()
    (folder / "1.png").write_bytes(whole[:-20])
    capsys.readouterr()
    assert DoctorCommand(str(folder), json=True).run() == 1
    assert "1.png" in json.loads(capsys.readouterr().out)["cameras"][0]["trouble"]


def test_a_camera_that_regulates_itself_is_pointed_out() -> None:
    for exposure, balance in product((True, False, None), repeat=2):
        advice = camera_settings_advice(CameraSettings(auto_exposure=exposure, auto_white_balance=balance))
        assert [any(word in line for line in advice) for word in ("exposure is on", "white balance is on")] == [
            exposure is True,
            balance is True,
        ]
    assert camera_settings_advice(None) == []
    assert "autofocus is on" in camera_settings_advice(CameraSettings(autofocus=True))[0]
    lines = camera_lines(CameraCheck("camera 0", "9DTact", trouble="expected much, got little; wait"))
    assert lines == ["  camera 0 (9DTact)", "    expected much, got little; wait"]

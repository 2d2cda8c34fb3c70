"""What a person does at the command line, from images to files, and what they read when something is wrong."""

import json
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from threadpoolctl import threadpool_info, threadpool_limits

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.cli import main

PRESSES = ("board_reference", "board", "ball_reference", "ball")


QUICKLY = ("--method", "ratio")
"""The method that is done soonest, where it is not the depth that is tested."""


def calibrate_options(images: Path, out: Path, **changed: Path) -> list[str]:
    options = ["calibrate", "--out", str(out)]
    for name in PRESSES:
        options += [f"--{name.replace('_', '-')}", str(changed.get(name, images / f"{name}.png"))]
    return options


@pytest.fixture(scope="module")
def sensor(sensor_a: SensorFolder) -> Path:
    return sensor_a.path


def test_calibrate_prints_its_certificate(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[int] = []

    def is_terminal() -> bool:
        threads.append(max(library["num_threads"] for library in threadpool_info()))
        return True

    monkeypatch.setattr("sys.stderr.isatty", is_terminal)
    with threadpool_limits(2):
        assert main([*calibrate_options(real_data / "sensor_a", tmp_path / "s"), *QUICKLY, "--json"]) == 0
    out, progress = capsys.readouterr()
    assert all(word in progress for word in ("pins of the board", "image of the ball", "certificate"))
    assert progress.endswith("\r") and not progress.rpartition("\n")[2].split("\r")[-2].strip(), "the line is removed"
    assert set(threads[:-2]) == {1}, "several threads would wait for each other while a sensor is calibrated"
    told = json.loads(out)
    assert told["board"]["pins_found"] == told["board"]["pins_expected"] == 63
    assert (
        told["board"]["leave_one_out_rms_mm"] <= 0.05
        and told["board"]["leave_one_out_rms_mm"] <= 0.8 * told["board"]["published_method_rms_mm"]
    )
    assert told["board"]["mm_per_px"] == pytest.approx(0.0515, abs=0.001)
    assert told["ball"]["method"] == "ratio" and told["ball"]["contact_radius_px"] == pytest.approx(67, abs=1)
    assert told["warnings"] == [] and {check["level"] for check in told["checks"]} == {told["result"]} == {"pass"}
    assert {entry.name for entry in (tmp_path / "s").iterdir()} == {"sensor.toml", "images", "certificate.html"}


def test_reconstruct_gives_a_ball_of_the_right_size(
    sensor: Path, real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = real_data / "sensor_a"
    options = ["--sensor", str(sensor), "--reference", str(images / "ball_reference.png"), "--out", str(tmp_path)]
    assert main(["reconstruct", *options, str(images / "ball.png"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["images"][0]
    assert told["max_indentation_mm"] == pytest.approx(2.15, abs=0.1)
    depth_mm = told["max_indentation_mm"]
    section_mm2 = np.pi * (2 * 4.0 * depth_mm - depth_mm**2)  # the skin leaves a ball before it is level
    assert told["contact_area_mm2"] == pytest.approx(0.9 * section_mm2, rel=0.05)
    assert all(Path(file).stat().st_size > 1000 for file in told["files"].values())
    points = np.asarray(trimesh.load(told["files"]["ply"]).vertices)
    assert sphere_radius(points[points[:, 2] < -0.4]) == pytest.approx(4.0, abs=0.15)


def test_reconstruct_writes_files_of_their_own_for_every_image_and_no_folder_on_a_full_disk(
    sensor: Path, real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ball, out, images = real_data / "sensor_a" / "ball.png", tmp_path / "new" / "out", []
    for name in ("x/a.png", "y/a.png", "z/a_1.png"):
        images.append(tmp_path / name)
        images[-1].parent.mkdir()
        shutil.copy(ball, images[-1])
    options = ["--sensor", str(sensor), "--reference", str(ball.with_name("ball_reference.png")), "--out", str(out)]
    command = ["reconstruct", *options, "--formats", "npy", "--no-drawings", "--json", "--", *map(str, images)]
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        assert main(command) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "expected to write" in refusal(capsys) and not out.parent.exists()
    assert main(command) == 0
    told = json.loads(capsys.readouterr().out)["images"]
    files = [Path(one["files"]["npy"]) for one in told]
    assert len(set(files)) == 3 and set(files) == set(out.iterdir()) and files[2].name == "a_1_height.npy"
    images[1].write_bytes(ball.read_bytes()[:-1000])
    assert main(command) == 1
    printed = capsys.readouterr()
    assert [one["image"] for one in json.loads(printed.out)["images"]] == [str(images[0])]
    assert "cut short" in printed.err and "(1 image was reconstructed before, 1 image was not read)" in printed.err


def sphere_radius(points: np.ndarray) -> float:
    """Least-squares sphere."""
    columns = np.column_stack([2 * points, np.ones(len(points))])
    *centre, offset = np.linalg.lstsq(columns, (points**2).sum(axis=1), rcond=None)[0]
    return float(np.sqrt(offset + np.dot(centre, centre)))


@pytest.fixture(scope="module")
def guided_recording(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with nine noisy frames of each step of a guided calibration."""
    folder = tmp_path_factory.mktemp("guided") / "frames"
    folder.mkdir()
    for number in range(9 * len(PRESSES)):
        image = cv2.imread(str(real_data / "sensor_a" / f"{PRESSES[number // 9]}.png"))
        noise = np.random.default_rng(number).normal(0, 0.4, image.shape)
        cv2.imwrite(str(folder / f"{number:03}.png"), np.clip(image + noise, 0, 255).round().astype(np.uint8))
    return folder


@pytest.fixture(scope="module")
def recording_without_ball(guided_recording: Path) -> Path:
    """The same without the frames of its last step."""
    folder = guided_recording.with_name("without_ball")
    folder.mkdir()
    for number in range(9 * (len(PRESSES) - 1)):
        shutil.copy(guided_recording / f"{number:03}.png", folder)
    return folder


def test_images_of_a_guided_calibration_that_fails_are_kept(
    guided_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The presses were work: what fails after them is repeated from their images."""
    out = tmp_path / "s"
    guided = ["calibrate", "--out", str(out), *QUICKLY, "--source", str(guided_recording)]
    (tmp_path / "s_images").mkdir()  # somebody else's
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (800_000, before[1]))  # room for an image, but not for the certificate
    try:
        assert main(guided) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept = tmp_path / "s_images_2"
    told = capsys.readouterr().err
    assert "Press the pin board" in told and "63 of 63 pins" in told
    said = told.strip().splitlines()
    assert f"the images are kept in {kept}; run the command with --images {kept}" in said[-2]
    assert "expected to write" in said[-1] and not out.exists()
    assert main([*guided[:-2], "--images", str(kept), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ball"] is not None


def test_the_board_of_a_guided_calibration_that_ends_too_soon_is_kept(
    recording_without_ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "--out", str(tmp_path / "s"), "--source", str(recording_without_ball)]) == 1
    assert "end of the recording" in refusal(capsys)
    assert {path.name for path in (tmp_path / "s_images").iterdir()} == {"board_reference.png", "board.png"}
    assert main(["calibrate", "--out", str(tmp_path / "s"), "--images", str(tmp_path / "s_images")]) == 0


def test_a_recording_that_ends_too_soon_is_said(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "--out", str(tmp_path / "s"), "--source", str(real_data / "sensor_a")]) == 1
    assert "end of the recording" in refusal(capsys)
    assert not (tmp_path / "s").exists()


def refusal(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error that says expected, got, do this."""
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("ninedtact: ") and ("got" in last or "found" in last)
    assert "Traceback" not in last
    return last


def write(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


BAD = {
    "missing": lambda good, here: here / "no such.png",
    "a folder": lambda good, here: here,
    "empty": lambda good, here: write(here / "x.png", b""),
    "truncated": lambda good, here: write(here / "x.png", good.read_bytes()[:20000]),
    "not an image": lambda good, here: write(here / "x.png", b"hello"),
    "wrong size": lambda good, here: painted(here, cv2.imread(str(good))[:400]),
    "16 bits": lambda good, here: painted(here, cv2.imread(str(good)).astype(np.uint16) * 200),
    "black": lambda good, here: painted(here, np.zeros((480, 640, 3), np.uint8)),
    "burnt": lambda good, here: painted(here, np.full((480, 640, 3), 255, np.uint8)),
}


def painted(here: Path, image: np.ndarray) -> Path:
    cv2.imwrite(str(here / "x.png"), image)
    return here / "x.png"


@pytest.mark.parametrize("which", ["board", "ball_reference"])
@pytest.mark.parametrize("how", BAD)
def test_a_bad_image_is_one_sentence(
    how: str, which: str, real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = BAD[how](real_data / "sensor_a" / f"{which}.png", tmp_path)
    assert main(calibrate_options(real_data / "sensor_a", tmp_path / "out", **{which: bad})) == 1
    refusal(capsys)
    assert not (tmp_path / "out").exists()


def test_swapped_images_are_named(real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = real_data / "sensor_a"
    swapped = {"board": images / "board_reference.png", "board_reference": images / "board.png"}
    assert main(calibrate_options(images, tmp_path / "out", **swapped)) == 1
    assert "swapped" in refusal(capsys)
    assert (tmp_path / "out_board_not_found.png").stat().st_size > 1000


def test_a_folder_that_may_not_be_written(real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("in the way")
    assert main([*calibrate_options(real_data / "sensor_a", tmp_path / "file" / "sensor"), *QUICKLY]) == 1
    refusal(capsys)


def test_wrong_use_is_exit_code_two() -> None:
    with pytest.raises(SystemExit) as left:
        main(["calibrate", "--no-such-option"])
    assert left.value.code == 2


@pytest.mark.parametrize("after_s", [0.0, 0.7, 1.5])
def test_ctrl_c_leaves_nothing_half_written(after_s: float, real_data: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ninedtact", *calibrate_options(real_data / "sensor_a", tmp_path / "s")]
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    wait_until_at_work(running)
    time.sleep(after_s)
    running.send_signal(signal.SIGINT)
    error = running.communicate(timeout=60)[1]
    if running.returncode == 0:
        pytest.skip("it was done before the interruption")
    assert running.returncode == 1 and "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def wait_until_at_work(running: subprocess.Popen[str]) -> None:
    """Past the start of the interpreter: OpenCV is loaded when images are read."""
    for _ in range(600):
        if "cv2" in Path(f"/proc/{running.pid}/maps").read_text():
            return
        time.sleep(0.05)
    pytest.fail("the command never began to work")

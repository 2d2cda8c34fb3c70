"""What a person does to read forces: estimate from images, weigh a few presses, estimate again."""

import csv
import json
import shutil
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ninedtact.calibration.force_calibration import STANDARD_GRAVITY, KnownLoadCalibration
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.calibration.sensor_with_other_base import load_on_calibration_ball_n
from ninedtact.cli import main
from ninedtact.cli.calibration_page import simulated_loaded_camera
from ninedtact.mechanics.indenter import Ball
from ninedtact.simulation.calibration_camera import SimulatedCalibrationCamera
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import default_twin
from ninedtact.studio.force_calibration_page import ball_press_under_load
from ninedtact.studio.force_calibration_session import USUAL_LOADS_G, ForceCalibrationPhase, ForceCalibrationSession
from ninedtact.studio.guided_session import SwitchableCamera

DEPTHS_MM = (0.4, 0.7, 1.0, 2.0)


@pytest.fixture(scope="module")
def desk(physical_sensor: SensorFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated sensor, an image of its untouched skin, four of a ball pressed on it, and what they weigh."""
    desk, twin = tmp_path_factory.mktemp("desk"), default_twin()
    shutil.copytree(physical_sensor.path, desk / "sensor")
    cv2.imwrite(str(desk / "reference.png"), twin.renderer(None, 50))
    contacts = [
        ScriptedPress(depth, at_mm=(1.0, -1.0), drag_mm=(0.3, 0.0)).simulate(twin, Ball(5.0)) for depth in DEPTHS_MM
    ]
    for number, contact in enumerate(contacts):
        cv2.imwrite(str(desk / f"press_{number}.png"), twin.renderer(contact, 60 + number))
    np.save(desk / "wrenches.npy", [contact.wrench().six for contact in contacts])
    return desk


def asked(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict:
    assert main([str(word) for word in (*words, "--json")]) == 0
    return json.loads(capsys.readouterr().out)


def presses(desk: Path) -> list[Path]:
    return [desk / f"press_{number}.png" for number in range(len(DEPTHS_MM))]


def estimated(
    desk: Path, capsys: pytest.CaptureFixture[str], *more: str | Path, sensor: Path | None = None
) -> np.ndarray:
    found = asked(
        capsys,
        "estimate",
        "--sensor",
        sensor or desk / "sensor",
        "--reference",
        desk / "reference.png",
        *more,
        *presses(desk),
    )
    names = ("Fx_N", "Fy_N", "Fz_N", "Tx_Nm", "Ty_Nm", "Tz_Nm")
    return np.array([[row[name] for name in names] for row in found["wrenches"]])


def test_presses_are_read_in_newtons_and_weighing_them_makes_them_better(
    desk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true = np.load(desk / "wrenches.npy")
    before = estimated(desk, capsys, "--out", tmp_path / "wrenches.csv")
    assert before[:, 2] == pytest.approx(true[:, 2], rel=0.25)
    assert (before[:, 0] > 0).all() and before[:, 0] == pytest.approx(true[:, 0], rel=0.3, abs=0.1)
    with (tmp_path / "wrenches.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["Fz_N"]) for row in rows] == pytest.approx(before[:, 2].tolist())
    stiff = 1.3  # as if the gel were stiffer than designed: the scale would show more
    grams = -true[:, 2] * stiff / STANDARD_GRAVITY * 1e3
    weighed = [
        word for path, each in zip(presses(desk), grams, strict=True) for word in ("--press", path, f"{each:.1f}")
    ]
    sensor = shutil.copytree(desk / "sensor", tmp_path / "sensor")
    (sensor / "force.toml").write_text("[network]\nfactor = 1.1\n")
    adapt = ("adapt", "--sensor", sensor, "--reference", desk / "reference.png", *weighed)
    told = asked(capsys, *adapt)
    assert told["left_out"] < 0.5 * told["unadapted"] and len(told["presses"]) == len(DEPTHS_MM)
    assert not any(press["warnings"] for press in told["presses"]), "half the gel deep is in range"
    assert not (sensor / "force.toml").exists(), "its factors belonged to the gel before"
    folder, twin = load_sensor(sensor), default_twin()
    known, gel = folder.record.known_loads, folder.gel
    assert known is not None and not folder.is_edited and folder.twin().gel == gel
    assert abs(np.log(gel.shear_modulus_mpa / stiff / twin.gel.shear_modulus_mpa)) < 2 * known.modulus_std
    off = gel.gel_to_base_modulus_ratio - twin.gel.gel_to_base_modulus_ratio
    assert abs(off) < 2 * known.modulus_ratio_std < 2 * known.calibrated_modulus_ratio_std
    after = estimated(desk, capsys, sensor=sensor)
    assert after[:, 2] == pytest.approx(stiff * true[:, 2], rel=0.12)
    assert main([*map(str, adapt)]) == 0  # starts from the image of the ball, not from the gel that was found
    assert load_sensor(sensor).gel.shear_modulus_mpa == pytest.approx(told["shear_modulus_mpa"], rel=0.05)
    *lines, errors, _ = capsys.readouterr().out.splitlines()
    assert float(errors.split()[4].strip("%")) / 100 == pytest.approx(told["unadapted"], abs=0.03)
    assert all(line.endswith("σ") for line in lines[:4]), "nothing to warn of"


def test_the_ball_of_the_calibration_itself_can_be_weighed(
    desk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sensor = shutil.copytree(desk / "sensor", tmp_path / "sensor")
    assumed_n = load_on_calibration_ball_n(load_sensor(sensor))
    grams = 1.15 * assumed_n / STANDARD_GRAVITY * 1e3
    assert "Not calibrated with known loads" in (sensor / "certificate.html").read_text()
    told = asked(capsys, "adapt", "--sensor", sensor, "--ball-grams", f"{grams:.0f}")
    certificate = (sensor / "certificate.html").read_text()
    assert (
        f"Calibrated with one known load: all forces like these share an error of ± {told['error']:.0%}." in certificate
    )
    assert certificate.count('<section id="force">') == 1 and "Not calibrated with known loads" not in certificate
    assert told["unadapted"] == pytest.approx(np.log(1.15), abs=0.01) and told["left_out"] is None
    found_n = load_on_calibration_ball_n(load_sensor(sensor))
    assert found_n == pytest.approx(1.15 * assumed_n, rel=0.03)


def test_known_loads_on_the_twin_find_how_stiff_its_gel_is(desk: Path, tmp_path: Path) -> None:
    folder = load_sensor(shutil.copytree(desk / "sensor", tmp_path / "s"))
    camera, stiffness = simulated_loaded_camera(folder)
    session = ForceCalibrationSession(
        SwitchableCamera(lambda address: camera, "sim"),
        folder.path,
        KnownLoadCalibration(folder),
        on_load=lambda grams: camera.offer(ball_press_under_load(grams)),
        hold_s=0.1,
    )
    with session:
        session.start()
        give_up_at = time.monotonic() + 120
        while session.state.phase is not ForceCalibrationPhase.COMPLETE:
            assert time.monotonic() < give_up_at
            time.sleep(0.05)
        session.save()
    found, known = load_sensor(folder.path), load_sensor(folder.path).record.known_loads
    assert [press.grams for press in session.state.presses] == list(USUAL_LOADS_G) and known is not None
    # The stiffness is another at every run.
    ratio = found.gel.shear_modulus_mpa / folder.gel.shear_modulus_mpa
    assert abs(np.log(ratio / stiffness)) < 2 * known.modulus_std and known.error < 0.08


@pytest.mark.parametrize("stiffness", [1.2358])
def test_loads_whose_solution_misses_its_tolerance_by_a_hair_are_pressed(desk: Path, stiffness: float) -> None:
    folder = load_sensor(desk / "sensor")
    gel = replace(folder.gel, shear_modulus_mpa=folder.gel.shear_modulus_mpa * stiffness)
    twin = replace(folder.twin(), gel=gel)
    with SimulatedCalibrationCamera(twin, folder.record.design) as camera:
        camera.hold(ball_press_under_load(100.0))
        camera.read()
        assert camera.refusal == ""


def test_a_video_that_is_cut_short_is_estimated_as_far_as_it_goes_and_is_an_error(
    desk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video = tmp_path / "presses.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    for press in 2 * presses(desk):
        writer.write(cv2.imread(str(press)))
    writer.release()
    video.write_bytes(video.read_bytes()[: int(0.6 * video.stat().st_size)])
    options = ["--sensor", desk / "sensor", "--reference", desk / "reference.png"]
    assert main([str(word) for word in ("estimate", *options, video, "--json")]) == 1
    printed = capsys.readouterr()
    rows = json.loads(printed.out)["wrenches"]
    assert [row["image"] for row in rows] == ["0", "1", "2", "3"] and rows[3]["Fz_N"] < rows[0]["Fz_N"] < 0
    assert "4 are whole, 4 are missing or damaged; use" in printed.err
    assert "(4 images were estimated before)" in printed.err


def test_separate_images_do_not_depend_on_their_order(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    order = [2, 0, 3, 1]
    shuffled = [presses(desk)[number] for number in order]
    found = asked(capsys, "estimate", "--sensor", desk / "sensor", "--reference", desk / "reference.png", *shuffled)
    names = ("Fx_N", "Fy_N", "Fz_N", "Tx_Nm", "Ty_Nm", "Tz_Nm")
    wrenches = np.array([[row[name] for name in names] for row in found["wrenches"]])
    np.testing.assert_array_equal(wrenches, estimated(desk, capsys)[order])


def test_untouched_skin_is_zero_exactly_about_any_point(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = asked(
        capsys, "estimate", "--sensor", desk / "sensor", "--reference", desk / "reference.png", "--about-mm", "0", "0", "-35",
        desk / "reference.png",
    )  # fmt: skip
    (row,) = found["wrenches"]
    assert not row["touching"] and not any(row[name] for name in ("Fx_N", "Fy_N", "Fz_N", "Tx_Nm", "Ty_Nm", "Tz_Nm"))


def test_other_light_and_dirt_on_untouched_skin_are_named_and_are_no_contact(
    desk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    untouched = cv2.imread(str(desk / "reference.png"))
    brighter, dirty = cv2.convertScaleAbs(untouched, alpha=1.05), untouched.copy()
    cv2.circle(dirty, (250, 200), 8, (80, 80, 80), cv2.FILLED)
    for name, image in (("brighter", brighter), ("dirty", dirty)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    images = [tmp_path / "brighter.png", tmp_path / "dirty.png"]
    words = ("estimate", "--sensor", desk / "sensor", "--reference", desk / "reference.png", *images)
    rows = asked(capsys, *words)["wrenches"]
    assert [row["warnings"] for row in rows] == [["light changed"], ["dirt in view"]]
    assert not any(row["touching"] or row["Fz_N"] for row in rows)


def test_a_torque_is_told_about_the_point_that_was_asked_for(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at_skin, below = estimated(desk, capsys), estimated(desk, capsys, "--about-mm", "0", "0", "-35")
    assert below[:, 4] == pytest.approx(at_skin[:, 4] + 0.035 * at_skin[:, 0])


@pytest.mark.parametrize("coordinate", ["nan", "inf", "1e300"])
def test_a_point_of_torques_that_is_nowhere_is_refused(coordinate: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["estimate", "--sensor", "my_sensor", "--reference", "reference.png", "press.png"]
    assert main([*words, "--about-mm", coordinate, "0", "-35"]) == 1
    assert "expected --about-mm from -1e+06 to 1e+06, got" in capsys.readouterr().err


def test_an_image_that_is_not_estimated_is_null_in_json_and_says_so_in_text(
    desk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video = cv2.VideoWriter(str(tmp_path / "dark.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 30.0, (640, 480))
    for image in (cv2.imread(str(desk / "reference.png")), cv2.imread(str(presses(desk)[0])), np.zeros((480, 640, 3))):
        video.write(np.asarray(image, np.uint8))
    video.release()
    words = ["estimate", "--sensor", desk / "sensor", "--reference", desk / "reference.png", tmp_path / "dark.avi"]
    assert main([*map(str, words), "--json"]) == 0
    found = json.loads(capsys.readouterr().out, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    untouched, press, dark = found["wrenches"]
    errors = ("eFx", "eFy", "eFz", "eTx", "eTy", "eTz")
    assert [dark[name] for name in errors] == [None] * 6 and dark["warnings"] == ["image dark"]
    assert not any(row[name] is None for row in (untouched, press) for name in errors)
    assert main([*map(str, words)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "0: nothing touches" and lines[2] == "2: not estimated  (image dark)"
    assert "not estimated" not in lines[1] and "inf" not in "".join(lines)


OF_SENSOR = "--sensor sensor --reference reference.png"
REFUSED = {
    "estimate --sensor sensor press_0.png": "--reference",
    f"estimate {OF_SENSOR}": "name them after the options",
    f"estimate {OF_SENSOR} press_0.png sensor": "once for each",
    f"estimate {OF_SENSOR} lost.png": "lost.png",
    "estimate --reference reference.png press_0.png": "--sensor",
    f"estimate {OF_SENSOR} --force magic press_0.png": "physics",
    f"estimate {OF_SENSOR} --force lost.onnx press_0.png": "lost",
    f"adapt {OF_SENSOR} --press press_1.png 100000": "press_1.png with a weight near the estimated",
    "adapt --sensor sensor --ball-grams 1000000": "the ball of the calibration with a weight near the estimated",
    "adapt --sensor sensor --ball-grams -4": "a load on the ball of the calibration above zero",
    f"adapt {OF_SENSOR} --press reference.png 300": "reference.png to show a press",
    f"adapt {OF_SENSOR} --press press_1.png 200 --press ./press_1.png 800": "got press_1.png with 200 g and with 800 g",
    f"adapt {OF_SENSOR} --press press_1.png -3": "above zero",
    f"adapt {OF_SENSOR} --force none --press a.png 3": "none",
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_is_refused_in_one_sentence(
    desk: Path, words: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    assert main(words.split()) == 1
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith("ninedtact: ") and "expected" in sentence and REFUSED[words] in sentence
    assert not (desk / "sensor" / "force.toml").exists()

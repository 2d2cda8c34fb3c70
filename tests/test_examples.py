"""The examples are the manual, so they run: each as a person starts it, in a process of its own, on real images."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

import ninedtact
from ninedtact.calibration.sensor_folder import SensorFolder

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name: str, real_data: Path, *options: str | Path) -> str:
    """What an example prints; it must end well, and say nothing on standard error."""
    command = [sys.executable, str(EXAMPLES / name), *map(str, options)]
    environment = {**os.environ, "NINEDTACT_REAL_DATA": str(real_data), "PYTHONIOENCODING": "utf-8"}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, encoding="utf-8", timeout=240)
    assert (ran.returncode, ran.stderr) == (0, "")
    return ran.stdout


def number(pattern: str, text: str) -> float:
    """The number that the pattern captures."""
    found = re.search(pattern, text)
    assert found is not None, f"expected {pattern!r} in {text!r}"
    return float(found[1])


@pytest.fixture(scope="module")
def calibrated(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The sensor folder of the first example, and what it printed."""
    folder = tmp_path_factory.mktemp("examples") / "sensor"
    return folder, run("01_calibrate.py", real_data, "--out", folder)


def test_every_example_has_a_test() -> None:
    here = Path(__file__).read_text(encoding="utf-8")
    assert [path.name for path in EXAMPLES.glob("*.py") if f'"{path.name}"' not in here] == []


def test_calibrate(calibrated: tuple[Path, str]) -> None:
    folder, said = calibrated
    assert said.startswith("63 pins") and number(r"predicted to ([\d.]+) mm", said) <= 0.05
    assert {path.name for path in folder.iterdir()} == {"sensor.toml", "images", "certificate.html"}


def test_reconstruct(calibrated: tuple[Path, str], real_data: Path, tmp_path: Path) -> None:
    said = run("02_reconstruct.py", real_data, "--sensor", calibrated[0], "--out", tmp_path)
    deepest_mm = number(r"maximum indentation ([\d.]+) mm", said)
    assert deepest_mm == pytest.approx(2.15, abs=0.12)
    assert np.load(tmp_path / "height.npy").min() == pytest.approx(-deepest_mm, abs=0.01)  # the mean over a patch
    assert cv2.imread(str(tmp_path / "height_shaded.png")).shape[2] == 3


def test_sensor_loop(calibrated: tuple[Path, str], real_data: Path) -> None:
    *readings, end = run("03_sensor_loop.py", real_data, "--sensor", calibrated[0]).splitlines()
    assert len(readings) == len(list((real_data / "sensor_a").glob("*.png"))) and "over" in end
    assert number(r"image 0: ([\d.]+) mm deep", readings[0]) == pytest.approx(2.15, abs=0.12)
    assert number(r"([\d.]+) mm² touched", readings[1]) == 0


def test_export_mesh(calibrated: tuple[Path, str], real_data: Path, tmp_path: Path) -> None:
    said = run("04_export_mesh.py", real_data, "--sensor", calibrated[0], "--out", tmp_path)
    assert number(r"radius ([\d.]+) mm", said) == pytest.approx(4.0, abs=0.15)
    for ending in ("ply", "stl", "obj"):
        low, high = trimesh.load(tmp_path / f"press.{ending}").bounds
        assert low[2] == pytest.approx(-2.15, abs=0.12) and high[0] - low[0] == pytest.approx(23.7, abs=0.5)


def test_objects(real_data: Path, tmp_path: Path) -> None:
    said = run("05_objects.py", real_data, "--out", tmp_path, "--columns", "2", "gear_07", "ball:4", "key_01")
    assert number(r"(\d+) objects", said) == 3
    sheet = cv2.imread(str(tmp_path / "objects.png"))
    assert sheet.shape[0] == sheet.shape[1] and sheet.std() > 20


def test_press_a_twin(real_data: Path) -> None:
    *steps, end = run("06_press_a_twin.py", real_data, "--object", "cylinder:3,8").splitlines()
    loads = [-number(r", ([+-][\d.]+)\) N", step) for step in steps]
    twists = [number(r"twist ([+-][\d.]+)", step) for step in steps]
    assert max(loads) > 4 and abs(loads[0]) < 0.2 and max(twists) > 2
    assert "nothing touches" in end


def test_estimate_force(real_data: Path, physical_sensor: SensorFolder) -> None:
    """With a sensor that was calibrated as the example does it; the tour calibrates a twin too."""
    said = run("07_estimate_force.py", real_data, "--sensor", physical_sensor.path).splitlines()
    read, exact = (
        np.array([[float(value) for value in re.findall(pattern, line)] for line in said])
        for pattern in (r"[xyz] ([+-][\d.]+)", r"\(([+-][\d.]+)\)")
    )
    assert np.abs(exact[:, 2]).max() > 2 and not read[0].any()
    np.testing.assert_allclose(read, exact, atol=0.35 * np.abs(exact).max())


def test_a_finger_in_mujoco_grips_by_its_image(real_data: Path, tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")
    *table, load, friction, warnings = run("08_mujoco_grip.py", real_data, "--sensor", tmp_path / "twin").splitlines()
    assert [row.split()[0] for row in table[1:]] == ["grips"] + 11 * ["slides"]
    for row in table[2:]:
        by_image, gel, scene = (float(row.split()[column]) for column in (3, 6, 7))
        assert by_image == pytest.approx(2.0, abs=0.1)
        assert gel == pytest.approx(scene, abs=0.02)
    assert abs(number(r"MuJoCo's ([+-][\d.]+)", load)) < 0.2
    assert abs(number(r"MuJoCo's ([+-][\d.]+)", friction)) < 0.1
    assert warnings.endswith(": none")


def test_a_grip_that_tightens_before_slip_holds(real_data: Path, physical_sensor: SensorFolder) -> None:
    said = run("09_grip_before_slip.py", real_data, "--sensor", physical_sensor.path)
    assert number(r"not tightened: slid in (\d+)", said) > 10
    assert number(r"\ntightened: slid in (\d+)", said) == 0


@pytest.mark.parametrize("screw", ["cross_02", "cross_03"])
def test_three_turns_of_a_screw_are_counted(screw: str, real_data: Path, physical_sensor: SensorFolder) -> None:
    said = run("10_count_turns.py", real_data, "--sensor", physical_sensor.path, "--screw", screw)
    assert number(r"grip 9: ([\d.]+)°", said) == pytest.approx(1080, abs=3)
    assert number(r"([\d.]+) turns", said) == pytest.approx(3, abs=0.009)


@pytest.mark.interop
def test_a_policy_learns_to_insert_a_peg(real_data: Path) -> None:
    """It starts and ends; docs/simulators.md says what a longer training teaches."""
    pytest.importorskip("stable_baselines3", reason="the extra 'reinforcement' is not installed")
    options = ("--steps", "128", "--envs", "2", "--episodes", "1", "--pitch-mm", "0.7")
    touch, blind = run("11_learn_peg_insertion.py", real_data, *options).splitlines()
    assert number(r"with touch: (\d+) environment steps", touch) == 128 and number(r", (\d+) per s", blind) > 10


def test_the_tour_runs_with_the_public_names_and_its_page_is_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES.parent / "scripts"))
    from run_tour import NOTEBOOK, PAGE, to_page

    kept = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert to_page(kept)[0] == PAGE.read_text(encoding="utf-8"), "run scripts/run_tour.py"
    code = "".join("".join(cell["source"]) + "\n" for cell in kept["cells"] if cell["cell_type"] == "code")
    assert set(re.findall(r"ninedtact\.(\w+)", code)) - {"simulation"} <= set(ninedtact.__all__)
    run_there = [sys.executable, str(EXAMPLES.parent / "scripts" / "run_tour.py"), str(tmp_path / "run.ipynb")]
    subprocess.run(run_there, check=True, timeout=240)
    page, figures = to_page(json.loads((tmp_path / "run.ipynb").read_text(encoding="utf-8")))
    assert number(r"to ([\d.]+) mm \(RMS\)", page) < 0.03
    assert round(abs(number(r"maximum indentation ([\d.]+) mm", page) - 1.8), 2) <= 0.03, "which is printed to 0.01 mm"
    assert number(r"Fz (-?[\d.]+) N\n", page) < 0.3 and len(figures) == 3

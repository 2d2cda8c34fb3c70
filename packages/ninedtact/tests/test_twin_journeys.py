"""What a person does without a sensor: press a twin at the command line, calibrate one, watch the demo."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.cli import main
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.shape.export import read_height_png
from ninedtact.shape.surface import contact_mask, max_indentation_mm, summarise_shape
from ninedtact.simulation.ground_truth import true_height_map_like, true_pressure_map_mpa
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press_sequence import ObjectTrajectory
from ninedtact.simulation.trajectory import ScriptedPress, press_trajectory
from ninedtact.simulation.twin import default_twin

DRAGGED = "--object ball:4 --depth-mm 1.2 --drag-mm 0.5 -0.2 --twist-deg 10 --tilt-deg 1 0 --at-mm 1 1"


def told_by_press(out: Path, capsys: pytest.CaptureFixture[str], *options: str) -> dict:
    assert main(["simulate", "press", *options, "--out", str(out), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_press_leaves_images_heights_tractions_and_a_wrench(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = told_by_press(tmp_path, capsys, *DRAGGED.split())
    force, torque = np.array(told["wrench"]["force_n"]), np.array(told["wrench"]["torque_nm"])
    assert force[2] < -4 and force[0] > 0.3 > 0 > force[1] and torque.shape == (3,)
    assert told["pose"]["depth_mm"] == pytest.approx(1.2) and told["wrench"]["about_mm"] == [0, 0, 0]
    height, pressure, shear = (np.load(tmp_path / f"{name}.npy") for name in ("height", "pressure", "shear"))
    assert height.shape == pressure.shape == (345, 460) and shear.shape == (345, 460, 2)
    assert height.min() == pytest.approx(-told["max_indentation_mm"], abs=0.02)
    cell_mm2 = told["mm_per_px"] ** 2
    assert -pressure.sum() * cell_mm2 == pytest.approx(force[2], rel=0.02)
    np.testing.assert_allclose(read_height_png(tmp_path / "height.png").z_mm, height, atol=6e-4)
    pressed, reference = (read_image(tmp_path / f"{name}.png") for name in ("image", "reference"))
    assert pressed.shape == reference.shape == (480, 640, 3)
    assert (pressed.astype(int) - reference).min() < -15
    assert cv2.imread(str(tmp_path / "figure.png")).shape[1] > 1500
    assert json.loads((tmp_path / "wrench.json").read_text())["wrench"] == told["wrench"]
    assert set(told["files"]) == {path.name for path in tmp_path.iterdir()}
    told_by_press(tmp_path / "again", capsys, *DRAGGED.split())
    for file in ("height.npy", "pressure.npy", "shear.npy", "image.png", "reference.png"):
        assert (tmp_path / "again" / file).read_bytes() == (tmp_path / file).read_bytes(), file


def test_a_press_to_a_load_and_with_a_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = tmp_path / "part.stl"
    trimesh.creation.capsule(height=6, radius=3).apply_transform(
        trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
    ).export(mesh)
    told = told_by_press(tmp_path / "out", capsys, "--object", str(mesh), "--load-n", "5")
    assert told["wrench"]["force_n"][2] == pytest.approx(-5, rel=1e-2) and 0.3 < told["pose"]["depth_mm"] < 1.5


BAD = {
    "--object bal --depth-mm 1": "got 'bal'; give one of these",
    "--object no.stl --depth-mm 1": "which is not there; check the path",
    "--object empty.stl --depth-mm 1": "expected triangles in empty, 1 to 5000000 of them, got 0",
    "--object inches.stl --depth-mm 1": "give unit in",
    "--object punch:18 --depth-mm 0.5": "take a smaller object",
    "--object ball:4 --depth-mm 1 --at-mm 20 0": "press nearer to the centre",
    "--object ball:4 --depth-mm 3.2": "the gel allows, 3.125 mm, got 3.2",
    "--object ball:4 --load-n -3": "--load-n above 0 and of at most 1e+09, got -3",
    "--object ball:4 --depth-mm -1": "--depth-mm above 0 and of at most 1e+09, got -1",
    "--object ball:4 --depth-mm nan": "--depth-mm above 0 and of at most 1e+09, got nan",
    "--object ball:4 --depth-mm 1 --seed -1": "expected --seed of at least 0, got -1",
    "--object ball:4": "expected a depth or a load, got neither",
    "--object ball:4 --depth-mm 1 --load-n 3": "expected a depth or a load, got both",
    "--object ball:4 --depth-mm 1 --tilt-deg 80 0": "turn the object itself",
    "--object ball:4 --depth-mm 1 --sensor nowhere": "expected a sensor folder",
    "--object ball:0 --depth-mm 1": "with numbers above zero",
}


@pytest.mark.parametrize("options", BAD)
def test_a_bad_press_is_one_sentence(
    options: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.stl").write_bytes(b"")
    trimesh.creation.box((0.4, 0.3, 0.2)).export("inches.stl")
    assert main(["simulate", "press", *options.split(), "--out", "out"]) == 1
    (said,) = capsys.readouterr().err.strip().splitlines()
    assert said.startswith("ninedtact: expected") and BAD[options] in said
    assert not Path("out").exists()


def test_what_can_be_pressed_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "objects"]) == 0
    assert "ball:RADIUS" in (said := capsys.readouterr().out) and "gear" in said
    assert main(["simulate", "objects", "--json"]) == 0
    assert "gear" in json.loads(capsys.readouterr().out)["generated"]["machine parts"]


@pytest.mark.parametrize("at_mm", [(0.0, 0.0), (4.0, -3.0)])
def test_a_calibrated_twin_sees_how_deep_it_is_pressed(twin_sensor: SensorFolder, at_mm: tuple[float, float]) -> None:
    twin, shape = default_twin(), twin_sensor.shape
    contact = ScriptedPress(1.3, at_mm=at_mm, drag_mm=(0.3, 0.1)).simulate(twin, Ball(5.0))
    reader = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(10, 20)))
    seen = reader(shape.rectify(Frame(twin.renderer(contact, 5))))
    true = true_height_map_like(contact, seen, twin.renderer.light.inverse_distance_per_mm)
    error = (seen.z_mm - true.z_mm)[true.z_mm < -0.1]
    # By the rule of the ball's edge, which reads deep; the demo's twin is calibrated by physics.
    assert seen.z_mm.min() == pytest.approx(true.z_mm.min(), abs=0.3)
    assert -0.35 < error.mean() < 0
    deepest = [np.unravel_index(height.z_mm.argmin(), height.z_mm.shape) for height in (seen, true)]
    assert np.abs(np.subtract(*deepest)).max() * seen.mm_per_px < 0.5


PRESSES_N = {"ball:8": 6, "cylinder:3,11": 6, "punch:3,0.3": 6, "ring_02": 6, "key_01": 8, "gear_07": 6, "star_04": 8}


@pytest.mark.parametrize("name", PRESSES_N)
def test_objects_of_all_shapes_are_read_as_deep_as_they_are(physical_sensor: SensorFolder, name: str) -> None:
    twin, shape, press = physical_sensor.twin(), physical_sensor.shape, None
    for part in (0.5, 1.0):
        press = twin.press(press, indenter_from_name(name), Pose(0.0, 0.0, 0.1), part * PRESSES_N[name])
    contact = press.corrected
    reader = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(10, 20)))
    seen = reader(shape.rectify(Frame(twin.renderer(contact, 5))))
    true = true_height_map_like(contact, seen, twin.renderer.light.inverse_distance_per_mm)
    assert true.z_mm.min() >= contact.height_mm.min() - 1e-5, "the refined skin is nowhere deeper than the solved one"
    deepest_mm, true_mm = max_indentation_mm(seen), max_indentation_mm(true)
    # The ring is read 16 µm too shallow, the others to 15 µm or 5 %.
    assert deepest_mm == pytest.approx(true_mm, abs=max(0.05 * true_mm, 0.018))
    assert abs(deepest_mm - true_mm) < 2 * reader.max_indentation_error_mm(seen)
    assert np.abs(seen.z_mm - true.z_mm)[true.z_mm < -0.05].mean() < 0.035


TOUCHED = {"ball:4": (1.2, 0.93), "punch:3,0.3": (0.8, 1.23), "key_01": (0.5, 1.40)}
"""Depth in mm of presses, and the ratio of their measured area of contact to the true one: edges are rounded by the gel."""


@pytest.mark.parametrize("name", TOUCHED)
def test_a_drag_changes_neither_the_area_nor_the_outline_of_what_touches(
    physical_sensor: SensorFolder, name: str
) -> None:
    twin, shape, (depth_mm, ratio) = physical_sensor.twin(), physical_sensor.shape, TOUCHED[name]
    reader = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(10, 20)))
    areas_mm2 = []
    for drag_mm in ((0.0, 0.0), (2.0, 1.0), (0.0, -1.5)):
        press = ScriptedPress(depth_mm, drag_mm=drag_mm)
        contact = press.simulate(twin, indenter_from_name(name))
        height = reader(shape.rectify(Frame(twin.renderer(contact, 5))))
        touched = contact_mask(height)
        areas_mm2.append(summarise_shape(height, touched=touched).contact_area_mm2)
        pressure_mpa = true_pressure_map_mpa(contact, height.z_mm.shape, height.mm_per_px)
        assert float(cv2.distanceTransform((pressure_mpa <= 0).astype(np.uint8), cv2.DIST_L2, 5)[touched].max()) < (
            0.8 / height.mm_per_px
        ), "nothing is touched beside the object"
    true_mm2 = (np.asarray(contact.pressure_mpa) > 0).sum() * contact.skin.grid.cell_area_mm2
    assert areas_mm2[0] == pytest.approx(ratio * true_mm2, rel=0.05)
    assert areas_mm2 == pytest.approx([areas_mm2[0]] * 3, rel=0.05)


def one_short_act() -> list[ObjectTrajectory]:
    return [ObjectTrajectory(Ball(4.0), press_trajectory(Pose(0.0, 0.0, 1.2), (0.6, 0.0), 0.2, pause_s=0.3, speed=2.0))]


def test_the_demo_ends_by_itself_without_a_terminal_and_leaves_its_sensor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ninedtact.simulation.simulated_sources.demo_press_sequence", one_short_act)
    assert main(["demo", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "in a browser" in said and "stopped after" in said
    assert "without a terminal the demo ends after one round" in said
    assert [path.name for path in tmp_path.iterdir()] == ["sensor"]


@pytest.mark.parametrize(
    ("option", "said"), [(("--rounds", "0"), "--rounds of at least 1, got 0"), (("--display-hz", "0"), "--display-hz")]
)
def test_a_demo_of_nothing_is_refused(
    option: tuple[str, str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--out", str(tmp_path / "demo"), *option]) == 1
    assert said in capsys.readouterr().err and not (tmp_path / "demo").exists()

"""An object followed: over key frames, through a lost contact, and never from one object to another; and the command."""

import csv
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_registration import ball, bumpy, seen_height, star

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.cli import main
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import EstimateWarning, HeightMap
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.tracking import ObjectTracker, RigidMotion, TrackState


@dataclass
class Seen:
    """What a tracker needs of a reading."""

    height: HeightMap
    is_touching: bool = True
    image_warnings: tuple[EstimateWarning, ...] = ()
    warnings: tuple[EstimateWarning, ...] = field(default=())
    least_mm: float = 0.03

    @property
    def contact(self) -> np.ndarray:
        return (self.height.z_mm < -self.least_mm) & self.is_touching


def turned_by(yaw_rad: float, x_mm: float = 0.0) -> RigidMotion:
    return RigidMotion().perturbed(np.zeros(3), np.array([x_mm, 0, 0, 0, 0, yaw_rad]))


@pytest.mark.usefixtures("without_type_checks")
def test_a_whole_turn_is_followed_over_key_frames_with_errors_that_grow_and_cover() -> None:
    tracker, std = ObjectTracker(), []
    for step in range(37):
        true = turned_by(np.radians(10 * step))
        found = tracker.update(Seen(seen_height(bumpy, true, 0.002, step)))  # type: ignore[arg-type]
        assert found.state == TrackState.TRACKED and found.path == 1
        error = found.motion.difference(true, np.zeros(3))
        assert np.abs(error[5]) <= 3 * found.std[5] + 1e-6
        std.append(found.std[5])
    assert np.degrees(abs(error[5])) < 1.0
    assert std[-1] > std[1]


@pytest.mark.usefixtures("without_type_checks")
def test_an_object_that_comes_back_is_recognised_and_another_one_is_not() -> None:
    tracker = ObjectTracker()
    free = Seen(seen_height(bumpy, RigidMotion()), is_touching=False)
    first, gone = (tracker.update(one) for one in (Seen(seen_height(bumpy, RigidMotion())), free))  # type: ignore[arg-type]
    assert first.path == 1 and gone.state == TrackState.NO_CONTACT and np.isnan(gone.moved_mm).all()
    back = tracker.update(Seen(seen_height(bumpy, turned_by(0.1, 0.6))))  # type: ignore[arg-type]
    assert back.path == 1
    assert back.position_mm == pytest.approx(turned_by(0.1, 0.6)(first.position_mm), abs=0.02)
    tracker.update(free)  # type: ignore[arg-type]
    other = tracker.update(Seen(seen_height(ball, RigidMotion())))  # type: ignore[arg-type]
    assert other.path == 2 and other.state == TrackState.TRACKED


@pytest.mark.usefixtures("without_type_checks")
def test_a_star_is_followed_for_half_a_turn_but_not_known_by_which_ray_it_comes_back() -> None:
    tracker = ObjectTracker()
    for step in range(19):
        true = turned_by(np.radians(10 * step))
        found = tracker.update(Seen(seen_height(star, true, 0.002, step), least_mm=0.4))  # type: ignore[arg-type]
        assert found.state == TrackState.TRACKED and found.path == 1
    error = found.motion.difference(true, np.zeros(3))
    assert np.degrees(abs(error[5])) < 1 and np.degrees(found.std[5]) < 5
    tracker.update(Seen(seen_height(star, RigidMotion()), is_touching=False))  # type: ignore[arg-type]
    back = [tracker.update(Seen(seen_height(star, turned_by(angle)), least_mm=0.4)) for angle in (0.0, 0.1)]  # type: ignore[arg-type]
    assert [one.path for one in back] == [2, 2] and back[1].motion.yaw_rad == pytest.approx(0.1, abs=0.02)


@pytest.mark.usefixtures("without_type_checks")
def test_what_cannot_be_followed_is_lost_with_its_reason() -> None:
    tracker = ObjectTracker()
    tracker.update(Seen(seen_height(bumpy, RigidMotion())))  # type: ignore[arg-type]
    changed = tracker.update(Seen(seen_height(ball, RigidMotion())))  # type: ignore[arg-type]
    assert changed.state == TrackState.LOST and "surface" in changed.reason
    dark = Seen(seen_height(bumpy, RigidMotion()), image_warnings=(EstimateWarning.IMAGE_DARK,))
    assert tracker.update(dark).reason == "image dark"  # type: ignore[arg-type]


def skin_under_ball_and_bar(with_bar: bool, deep_mm: float) -> HeightMap:
    """The skin under a ball with a bar beside it, which is 0.5 mm less deep."""

    def underside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        bar = -0.5 / (1 + np.exp((4.5 - x) / 0.1)) if with_bar else np.zeros_like(x)
        return np.minimum(np.minimum(ball(x, y), bar) + 1 - deep_mm, 0)

    return seen_height(underside, RigidMotion())


@pytest.mark.usefixtures("without_type_checks")
@pytest.mark.parametrize(
    ("had_bar", "deep_mm", "state"), [(False, 1.0, TrackState.LOST), (True, 0.5, TrackState.TRACKED)]
)
def test_what_would_have_been_inside_the_gel_is_another_object_and_what_was_above_it_is_the_same(
    had_bar: bool, deep_mm: float, state: TrackState
) -> None:
    tracker = ObjectTracker()
    tracker.update(Seen(skin_under_ball_and_bar(had_bar, deep_mm)))  # type: ignore[arg-type]
    found = tracker.update(Seen(skin_under_ball_and_bar(True, 1.0)))  # type: ignore[arg-type]
    assert found.state == state and ("inside the gel" in found.reason) == (state == TrackState.LOST)


@pytest.fixture(scope="module")
def pressed_key(physical_sensor: SensorFolder, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Pose]:
    """A reference image, and a folder of images of a key that is pressed on the twin, dragged and turned; and its last pose."""
    folder = tmp_path_factory.mktemp("key")
    (folder / "images").mkdir()
    twin, key, last = physical_sensor.twin(), indenter_from_name("key_05"), None
    cv2.imwrite(str(folder / "reference.png"), twin.renderer(None, 99))
    poses = [Pose(0.3 + 0.1 * step, -0.4 + 0.05 * step, 0.6, np.radians(3.0 * step)) for step in range(6)]
    for number, pose in enumerate(poses):
        last = twin.press(last, key, pose)
        cv2.imwrite(str(folder / "images" / f"{number:02}.png"), twin.renderer(last.corrected, number))
    return folder / "reference.png", folder / "images", poses[-1]


def test_the_command_writes_the_path_of_a_key(
    pressed_key: tuple[Path, Path, Pose],
    physical_sensor: SensorFolder,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    reference, images, last = pressed_key
    out = tmp_path / "path.csv"
    words = ["--sensor", physical_sensor.path, "--reference", reference, "--out", out]
    assert main(["track", str(images), *map(str, words)]) == 0
    assert "6 images, 6 with an object that was followed" in capsys.readouterr().out
    rows = list(csv.DictReader(out.open()))
    assert [row["state"] for row in rows] == ["tracked"] * 6 and rows[0]["key_frame"] == "True"
    end = {name: float(text) for name, text in rows[-1].items() if name.endswith(("mm", "deg", "mm_std", "deg_std"))}
    assert end["rz_deg"] == pytest.approx(np.degrees(last.twist_rad), abs=1.0)
    assert end["rz_deg_std"] < 1.0 and end["x_mm_std"] < 0.06


def test_the_command_writes_the_slip_of_a_ball(
    physical_sensor: SensorFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "images").mkdir()
    twin, ball, last = replace(physical_sensor.twin(), friction=0.5), indenter_from_name("ball:4"), None
    cv2.imwrite(str(tmp_path / "reference.png"), twin.renderer(None, 99))
    depths_mm, drags_mm = np.minimum(0.2 * np.arange(1, 41), 0.8), np.maximum(0.1 * (np.arange(40) - 9), 0)
    true = []
    for number, (depth_mm, drag_mm) in enumerate(zip(depths_mm.tolist(), drags_mm.tolist(), strict=True)):
        last = twin.press(last, ball, Pose(drag_mm - 1.5, 0.3, depth_mm))
        true.append(1 - (last.slip_share or 0))
        cv2.imwrite(str(tmp_path / "images" / f"{number:02}.png"), twin.renderer(last.corrected, number))
    out, reference = tmp_path / "path.csv", tmp_path / "reference.png"
    words = ["--sensor", physical_sensor.path, "--reference", reference, "--out", out]
    assert main(["track", str(tmp_path / "images"), *map(str, words)]) == 0
    said = capsys.readouterr().out
    assert "slip is gross in" in said and "friction coefficient 0." in said
    rows = list(csv.DictReader(out.open()))
    assert {row["touching"] for row in rows} == {"True"} and {row["contacts"] for row in rows} == {"1"}
    slips, slides_from = [row["slip"] for row in rows], int(np.argmin(np.array(true) > 0.02))
    assert slips[:11] == ["static"] * 11 and "incipient" in slips[11:slides_from]
    assert abs(slips.index("gross") - slides_from) <= 2 and set(slips[slides_from + 2 :]) == {"gross"}
    end = {name: float(text) for name, text in rows[-1].items() if name.startswith(("friction", "slip_speed", "p_"))}
    assert end["friction"] == pytest.approx(0.5, rel=0.1) and abs(end["friction"] - 0.5) < 2 * end["friction_std"]
    rate_hz = 1 / (float(rows[1]["time_s"]) - float(rows[0]["time_s"]))
    assert end["slip_speed_mm_s"] == pytest.approx(0.1 * rate_hz, rel=0.3)
    assert 0 <= end["p_incipient"] <= 1 - end["p_gross"] + 1e-6
    out.unlink()
    assert main(["track", str(tmp_path / "images"), *map(str, words), "--force", "none"]) == 0
    assert {row["slip"] for row in csv.DictReader(out.open())} == {"unknown"}


def test_a_track_that_cannot_be_written_is_one_sentence(
    pressed_key: tuple[Path, Path, Pose], physical_sensor: SensorFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    reference, images, _ = pressed_key
    words = ["--sensor", physical_sensor.path, "--reference", reference, "--out", "/no/such/folder/path.csv"]
    assert main(["track", str(images), *map(str, words)]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_what_was_followed_before_a_damaged_image_is_kept(
    pressed_key: tuple[Path, Path, Pose],
    physical_sensor: SensorFolder,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    reference, images, _ = pressed_key
    damaged = Path(shutil.copytree(images, tmp_path / "images"))
    content = (damaged / "03.png").read_bytes()
    (damaged / "03.png").write_bytes(content[: len(content) // 2])
    out = tmp_path / "path.csv"
    words = ["--sensor", physical_sensor.path, "--reference", reference, "--out", out]
    assert main(["track", str(damaged), *map(str, words)]) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "03.png" in said[0] and "3 images were followed before" in said[0]
    rows = list(csv.DictReader(out.open()))
    assert len(rows) == 3 and not any("nan" in text.lower() for row in rows for text in row.values())

"""Rectified images of a sensor without a calibration: the command on a folder and a video, what it refuses, and what
it says it cannot know.
"""

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ninedtact.calibration.nominal_shape import nominal_shape
from ninedtact.capture.source_from_address import camera_or_file_source
from ninedtact.cli import main
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reference_frames import choose_reference_frames, read_reference_frames
from ninedtact.simulation.gel_brightness import synthetic_reference_image
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.twin import default_twin
from ninedtact.steady_light import SteadyLight, common_factor, measure_light

COLS, ROWS, VIEW_MM, HZ = 80, 60, 22.0, 30.0
FREE, DOWN, HELD, DRAGGED = 10, 12, 8, 30
STEP_MM = 0.08
"""Movement of the drag in each image."""


@dataclass(frozen=True)
class Drag:
    """Images of a ball that comes down, rests, and is dragged until it slides; and the truth."""

    images: list[np.ndarray]
    x_mm: np.ndarray
    slipping: np.ndarray
    """Share of the contact that slips; not a number without contact."""


@pytest.fixture(scope="module")
def drag() -> Drag:
    x, y = np.meshgrid(*((np.arange(side) - (side - 1) / 2) * VIEW_MM / COLS for side in (COLS, ROWS)))
    pixel_map = PixelToSkinMap(np.stack([x, y], axis=-1).astype(np.float32))
    usual = default_twin()
    renderer = Renderer(
        pixel_map, synthetic_reference_image(pixel_map), usual.renderer.light, CameraNoise(0.7, (ROWS, COLS))
    )
    twin = replace(usual, renderer=renderer, friction=0.4, pitch_mm=0.4)
    depth_mm = np.concatenate([np.full(FREE, -0.2), np.linspace(0.05, 0.7, DOWN), np.full(HELD + DRAGGED, 0.7)])
    x_mm = np.concatenate([np.zeros(FREE + DOWN + HELD), STEP_MM * np.arange(1, DRAGGED + 1)]) - 1.0
    last, images, slipping = None, [], []
    for number, (at_mm, deep_mm) in enumerate(zip(x_mm.tolist(), depth_mm.tolist(), strict=True)):
        last = twin.press(last, indenter_from_name("ball:4"), Pose(at_mm, 0.3, deep_mm))
        images.append(renderer(last.corrected, number))
        slipping.append(last.slip_share if last.touches else np.nan)
    return Drag(images, x_mm, np.array(slipping, float))


def save(images: list[np.ndarray], path: Path) -> Path:
    """Write images as a video, or as a folder of PNG files where the path has no suffix."""
    if path.suffix:
        rows, cols = images[0].shape[:2]
        video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), HZ, (cols, rows))
        for image in images:
            video.write(image)
        video.release()
        return path
    path.mkdir()
    for number, image in enumerate(images):
        cv2.imwrite(str(path / f"{number}.png"), image)
    return path


def track(source: Path, *options: str) -> list[dict[str, str]]:
    """Return the rows that the command writes; it must succeed."""
    out = source.with_name("path.csv")
    assert main(["track", str(source), "--rectified", "--out", str(out), *options]) == 0
    with out.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def require_truth(rows: list[dict[str, str]], drag: Drag, least_gross: float = 0.85) -> None:
    """Require the order of states, and the displacement, of the whole drag."""
    assert all(row["slip"] == "static" and row["touching"] == "False" for row in rows[:FREE])
    held = rows[FREE + DOWN : FREE + DOWN + HELD]
    assert {row["slip"] for row in held} == {"static"}
    slides = np.flatnonzero(drag.slipping == 1.0)
    slides = slides[slides >= FREE + DOWN + HELD]
    assert len(slides) > DRAGGED / 2
    assert np.mean([rows[number]["slip"] == "gross" for number in slides]) >= least_gross
    moved_mm = float(rows[-1]["x_mm"]) - float(held[-1]["x_mm"])
    assert abs(moved_mm - STEP_MM * DRAGGED) < 0.25
    assert float(held[0]["x_mm_std"]) < 0.3 and float(rows[-1]["yaw_deg_std"]) > 45
    assert float(held[-1]["normal"]) > 0.2 and float(rows[-1]["shear_x"]) > 0.02


@pytest.mark.parametrize("name", ["images", "drag.avi"])
def test_motion_and_slip_of_a_folder_and_of_a_video(
    name: str, drag: Drag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = track(save(drag.images, tmp_path / name), "--rate-hz", f"{HZ:g}", "--mm-per-px", f"{VIEW_MM / COLS}")
    require_truth(rows, drag)
    assert [float(row["time_s"]) for row in rows] == pytest.approx(np.arange(len(rows)) / HZ, abs=1e-5)
    printed = capsys.readouterr()
    assert "gross in " in printed.out and "unknown scale" in printed.err and "22.0 mm wide" in printed.err


def test_black_borders_corners_grey_files_and_repeated_images_change_little(drag: Drag, tmp_path: Path) -> None:
    corner = np.ones((ROWS, COLS), np.uint8)
    corner[:8, :8] = corner[-8:, -8:] = 0
    images = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) * corner for image in drag.images for _ in range(2)]
    bordered = [cv2.copyMakeBorder(image, 6, 10, 12, 8, cv2.BORDER_CONSTANT, value=0) for image in images]
    scale = f"{VIEW_MM / COLS}"
    rows = track(save(bordered, tmp_path / "images"), "--reference-frames", "0:20", "--mm-per-px", scale)
    first, again = rows[::2], rows[1::2]
    require_truth(first, drag)
    same = "slip", "x_mm", "normal"
    assert all(one[name] == other[name] for one, other in zip(first, again, strict=True) for name in same)


def test_a_sequence_that_begins_pressed_takes_its_last_images_as_the_reference_and_says_so(
    drag: Drag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    backwards = drag.images[FREE + DOWN :] + drag.images[:FREE]
    rows = track(save(backwards, tmp_path / "images"))
    assert f"images {HELD + DRAGGED}:{len(backwards)} are taken to show no contact" in capsys.readouterr().err
    assert all(row["touching"] == "True" for row in rows[: HELD + DRAGGED])
    assert {row["slip"] for row in rows[HELD + DRAGGED :]} == {"static"}


def test_reference_images_end_before_a_wide_contact_that_is_hardly_above_their_noise() -> None:
    rng, untouched = np.random.default_rng(0), 7
    dent = 1.2 * np.sin(np.linspace(0, 2 * np.pi, COLS))[None, :, None]
    images = [120 + rng.normal(0, 1.0, (ROWS, COLS, 3)) - (at >= untouched) * dent for at in range(10)]
    frames = [Frame(np.rint(image).astype(np.uint8), 0, at) for at, image in enumerate(images)]
    assert choose_reference_frames(frames, frames[untouched:]) == tuple(frames[: untouched - 1])


def test_a_contact_is_told_from_free_skin_between_black_borders() -> None:
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(COLS) - COLS / 2, np.arange(ROWS) - ROWS / 2)
    dent = 0.06 * np.exp(-(x**2 + y**2) / 200)
    images = [120 * (1 - dent * (at >= 10)) + rng.normal(0, 1, dent.shape) for at in range(20)]
    grey = [np.pad(np.rint(image).astype(np.uint8), ((0, 0), (8, 8))) for image in images]
    frames = [Frame(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), 0, at) for at, image in enumerate(grey)]
    free, pressed = frames[:10], frames[10:]
    assert choose_reference_frames(free, pressed)[0] is free[0] and choose_reference_frames(pressed, free)[0] is free[0]


def test_the_images_of_a_lamp_that_flickers_have_one_brightness_without_contact(drag: Drag, tmp_path: Path) -> None:
    light = 1 + np.random.default_rng(3).normal(0, 0.015, len(drag.images))
    images = [np.asarray(np.rint(image * factor), np.uint8) for image, factor in zip(drag.images, light, strict=True)]
    source = camera_or_file_source(str(save(images, tmp_path / "images")))
    with source:
        flickering = list(source)
    references = read_reference_frames(source, (0, FREE))
    with SteadyLight(source, measure_light(references)) as steadied:
        steady = list(steadied)
    levels = [np.array([frame.image.mean() for frame in frames[:FREE]]) for frames in (flickering, steady)]
    before, after = (float(level.std() / level.mean()) for level in levels)
    assert len(steady) == len(images) and before > 0.01 and after < 0.001


def test_the_common_factor_of_images_is_that_of_skin_beside_all_contacts() -> None:
    rng = np.random.default_rng(0)
    factor, ratio = 1 + rng.normal(0, 0.02, 40), np.ones((40, 200))
    ratio[10:, :120] += np.linspace(0, 0.1, 30)[:, None] * rng.uniform(-1, 1, 120)
    ratio += rng.normal(0, 1e-3, ratio.shape)
    assert common_factor(ratio * factor[:, None]) == pytest.approx(factor, abs=6e-4)


def test_displacement_is_uncertain_from_where_the_contact_leaves_the_view(drag: Drag, tmp_path: Path) -> None:
    rows = track(
        save([image[:, :46] for image in drag.images], tmp_path / "images"), "--mm-per-px", f"{VIEW_MM / COLS}"
    )
    assert float(rows[FREE + DOWN]["x_mm_std"]) < 0.3 and float(rows[-1]["x_mm_std"]) > 1


def test_an_object_that_jumps_is_followed_anew(drag: Drag, tmp_path: Path) -> None:
    after = [np.ascontiguousarray(image[:, ::-1]) for image in drag.images[-6:]]
    rows = track(
        save(drag.images + after, tmp_path / "images"), "--rate-hz", f"{HZ:g}", "--mm-per-px", f"{VIEW_MM / COLS}"
    )
    before, jumped, anew = rows[-7], rows[-6], rows[-5]
    assert float(before["x_mm"]) > 2 and before["slip"] == "gross"
    assert (
        jumped["state"] == "lost"
        and jumped["reason"].startswith("the contact ")
        and not jumped["slip"] + jumped["x_mm"]
    )
    assert anew["state"] == "tracked" and float(anew["x_mm"]) == 0 and anew["slip"] == "static"


def test_a_jump_of_light_is_a_reason_and_no_path_and_no_contact_is_no_slip(drag: Drag, tmp_path: Path) -> None:
    dark = [np.asarray(image * 0.3, np.uint8) for image in drag.images[:5]]
    rows = track(save(drag.images[:FREE] + dark, tmp_path / "images"))
    assert all(row["state"] == "no contact" and row["slip"] == "static" and not row["x_mm"] for row in rows[:FREE])
    assert all(row["state"] == "lost" and row["reason"] and not row["slip"] for row in rows[FREE:])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--reference-frames", "5:2"], "FIRST:END"),
        (["--reference-frames", "90:100"], "4 images"),
        (["--mm-per-px", "30"], "4 to 200 mm wide"),
        (["--mm-per-px", "nan"], "--mm-per-px to be a number, got nan"),
        (["--rate-hz", "0"], "--rate-hz above 0"),
        (["--sensor", "somewhere"], "--sensor or --rectified"),
        (["--force", "none"], "--force or --rectified"),
        (["--reference", "{folder}/0.png", "--reference-frames", "0:2"], "drop one"),
        (["--reference", "{other}/0.png"], "80 x 60"),
    ],
)
def test_impossible_options_get_one_sentence(
    options: list[str], words: str, drag: Drag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = save(drag.images[:4], tmp_path / "images")
    other = save([np.full((30, 40, 3), 90, np.uint8)], tmp_path / "other")
    given = [option.format(folder=folder, other=other) for option in options]
    assert main(["track", str(folder), "--rectified", *given]) == 1
    said = capsys.readouterr().err.strip()
    assert words in said and len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("size", "level", "words"), [((24, 32), 120, "40x30"), ((30, 200), 120, "40x30"), ((60, 80), 3, "lit reference")]
)
def test_images_that_show_nothing_get_one_sentence(
    size: tuple[int, int], level: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = save([np.full((*size, 3), level, np.uint8)] * 3, tmp_path / "images")
    assert main(["track", str(folder), "--rectified"]) == 1
    said = capsys.readouterr().err.strip()
    assert words in said and len(said.splitlines()) == 1


@pytest.mark.parametrize("source", ["sim", "press.mcap", "0", "http://localhost:9/video"])
def test_only_files_are_rectified_and_the_options_belong_together(
    source: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["track", source, "--rectified"]) == 1
    assert main(["track", source, "--mm-per-px", "0.3"]) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2 and "a video or a folder" in said[0] and "--rectified" in said[1]


def test_the_nominal_shape_shows_the_whole_view_at_the_stated_scale() -> None:
    grey = np.full((48, 90), 100, np.float32)
    grey[:, :10] = 0
    usual, given = nominal_shape(grey), nominal_shape(grey, 0.2)
    rows, cols = usual.rectify.source_px.shape[:2]
    assert cols * usual.rectify.mm_per_px == pytest.approx(24, abs=0.05)
    assert cols * given.rectify.mm_per_px == pytest.approx(16) and rows / cols == pytest.approx(48 / 80, abs=2e-3)
    assert given.rectify.source_px[..., 0].min() >= 9 and np.all(given.rectify.resample(grey) > 95)

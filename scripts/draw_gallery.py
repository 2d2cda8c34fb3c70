"""Draw the pictures of docs/gallery.md into docs/images, but that of the live page, which scripts/draw_page_images.py takes.

.venv/bin/python scripts/draw_gallery.py --real ../shared/real/sensor_a

The folder holds the four images of a real sensor from which it is calibrated (README.md). Without it the pictures of the real
sensor and its twin are left as they are.
"""

import shlex
import shutil
import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path

import cv2
import numpy as np

import ninedtact
from ninedtact import CalibrationImages, Frame, HeightMap, ScriptedPress, SensorFolder, Twin
from ninedtact.cli import main as run_ninedtact
from ninedtact.shape.coloured_height_map import fit_colour_scale, shade_heights
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.design_file import read_hardware_design
from ninedtact_hardware.part_and_assembly_images import render_exploded_view

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
OBJECTS = (
    *("ball:4", "gear_07", "key_01", "coin_03", "spring_01", "screw_02"),
    *("fingerprint_01", "letter_04", "snowflake_01", "braille_01", "honeycomb_01", "leaf_01"),
)
LOAD_N, COLUMNS, TILE_PX, GAP_PX, LABEL_PX = 12.0, 6, (240, 180), 6, 22
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 88]
FIGURE_SCALE = 0.6
"""Size of the figure of a press on the page, as a part of what the command draws."""
DRAWN = {
    "twin": ("gallery_objects.jpg",),
    "hardware": ("hardware_exploded.png",),
    "real": ("ball_shaded.png", "twin_press.png"),
}
"""The pictures by what they show; those of a real sensor need its images."""
GEAR = "simulate press --object gear_07 --depth-mm 0.6 --drag-mm 0.6 -0.3 --twist-deg 8"
"""The press of the page's figure."""


def press(twin: Twin, folder: SensorFolder, name: str) -> tuple[np.ndarray, HeightMap]:
    """Return the camera image of an object pressed with `LOAD_N`, and the heights measured in it."""
    contact = ScriptedPress(load_n=LOAD_N).simulate(twin, ninedtact.indenter_from_name(name))
    image, untouched = twin.renderer(contact), Frame(twin.renderer(None, 1))
    reader = folder.shape.depth_reader(untouched)
    return image, reader(folder.shape.rectify(Frame(image)))


def draw_tile(name: str, image: np.ndarray, height: HeightMap) -> np.ndarray:
    """Return camera image and heights below each other, with the name above them."""
    label = np.full((LABEL_PX, TILE_PX[0], 3), 255, np.uint8)
    cv2.putText(label, name, (2, LABEL_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (60, 60, 60), 1, cv2.LINE_AA)
    shaded = shade_heights(height, fit_colour_scale(height))
    parts = [cv2.resize(part, TILE_PX, interpolation=cv2.INTER_AREA) for part in (image, shaded)]
    return np.pad(np.vstack([label, *parts]), ((0, GAP_PX), (0, GAP_PX), (0, 0)), constant_values=255)


def draw_twelve_objects() -> None:
    """Calibrate the twin, press all objects and write their pictures."""
    twin = ninedtact.default_twin()
    images = CalibrationImages(**vars(simulate_calibration_images(twin, frames=4)))
    with tempfile.TemporaryDirectory() as temporary:
        folder = ninedtact.save_sensor(Path(temporary) / "twin", ninedtact.calibrate(images))
        pressed = {name: press(twin, folder, name) for name in OBJECTS}
    tiles = [draw_tile(name, *seen) for name, seen in pressed.items()]
    rows = [np.hstack(tiles[start : start + COLUMNS]) for start in range(0, len(tiles), COLUMNS)]
    cv2.imwrite(str(IMAGES / DRAWN["twin"][0]), np.vstack(rows), JPEG)


def draw_hardware() -> None:
    """Write the exploded view of the published design, as `ninedtact hardware export` does."""
    sensor = BuildableDesign(read_hardware_design(None, "default"))
    cv2.imwrite(str(IMAGES / DRAWN["hardware"][0]), render_exploded_view(sensor.bodies))


def draw_real_sensor(real: Path) -> None:
    """Calibrate a real sensor, reconstruct its ball, press a gear on its twin, and write both pictures."""
    ball, figure = DRAWN["real"]
    with tempfile.TemporaryDirectory() as temporary:
        sensor, out = Path(temporary) / "sensor", Path(temporary) / "out"
        names = ("board-reference", "board", "ball-reference", "ball")
        images = [word for name in names for word in (f"--{name}", str(real / f"{name.replace('-', '_')}.png"))]
        reference = ["--reference", str(real / "ball_reference.png")]
        run("calibrate", "--out", str(sensor), *images)
        run("reconstruct", "--sensor", str(sensor), "--out", str(out), *reference, str(real / "ball.png"))
        run(*shlex.split(GEAR), "--sensor", str(sensor), "--out", str(out / "press"))
        shutil.copyfile(out / "ball_shaded.png", IMAGES / ball)
        drawn = cv2.imread(str(out / "press" / "figure.png"), cv2.IMREAD_COLOR)
        small = cv2.resize(drawn, None, fx=FIGURE_SCALE, fy=FIGURE_SCALE, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(IMAGES / figure), small)


def run(*arguments: str) -> None:
    """Run a command of the program; exits where it fails."""
    if run_ninedtact(arguments) != 0:
        sys.exit(f"expected ninedtact {' '.join(arguments)} to succeed, got an error; it is printed above")


def main() -> None:
    """Write all pictures for which there are images."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--real", type=Path, help="folder with the four images of a real sensor")
    real = parser.parse_args().real
    draw_twelve_objects()
    draw_hardware()
    if real is not None:
        draw_real_sensor(real)
    left = "" if real is not None else f"; without --real these are as they were: {', '.join(DRAWN['real'])}"
    print(f"wrote the pictures of the gallery into {IMAGES}{left}")


if __name__ == "__main__":
    main()

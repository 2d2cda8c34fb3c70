"""Draw the pictures of docs/gallery.md into docs/images, but that of the live page, which scripts/draw_page_images.py takes.

Those of a real ball (README.md, docs/accuracy.md) carry their figures in the PNG, and their captions are written from them.

.venv/bin/python scripts/draw_gallery.py --real ../shared/real/sensor_a

The folder holds the four images of a real sensor from which it is calibrated (README.md). Without it the pictures of the real
sensor and its twin are left as they are.
"""

import json
import re
import shlex
import sys
import tempfile
import textwrap
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import ninedtact
from ninedtact import CalibrationImages, Frame, HeightMap, ScriptedPress, SensorFolder, Twin
from ninedtact.cli import main as run_ninedtact
from ninedtact.shape.coloured_height_map import fit_colour_scale, shade_heights
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.design_file import read_hardware_design
from ninedtact_hardware.part_and_assembly_images import render_exploded_view

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
OBJECTS = (
    *("ball:4", "gear_07", "key_01", "coin_03", "spring_01", "screw_02"),
    *("fingerprint_01", "letter_04", "snowflake_01", "braille_01", "honeycomb_01", "leaf_01"),
)
LOAD_N, COLUMNS, TILE_PX, GAP_PX, LABEL_PX = 12.0, 6, (240, 180), 6, 22
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 88]
LINE_WIDTH = 128
FIGURE_SCALE = 0.6
"""Size of the figure of a press on the page, as a part of what the command draws."""
DRAWN = {
    "twin": ("gallery_objects.jpg",),
    "hardware": ("hardware_exploded.png",),
    "real": ("ball_shaded.png", "twin_press.png"),
}
"""The pictures by what they show; those of a real sensor need its images."""
CAPTIONED = {"ball_shaded.png": ROOT / "README.md", "ball_colour.png": ROOT / "docs" / "accuracy.md"}
"""Pages in which a picture of the real ball has a caption with its figures, between two markers."""
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
    (ball, colours), figure = CAPTIONED, DRAWN["real"][1]
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary)
        physics = reconstruct_ball(real, "physics", out)
        ratio = reconstruct_ball(real, "ratio", out)
        run(*shlex.split(GEAR), "--sensor", str(out / "physics"), "--out", str(out / "press"))
        save_with_caption(out / "physics_ball" / "ball_shaded.png", ball, {"physics": ball_figures(physics)})
        both = {"physics": ball_figures(physics), "ratio": ball_figures(ratio)}
        save_with_caption(out / "ratio_ball" / "ball_colour.png", colours, both)
        drawn = cv2.imread(str(out / "press" / "figure.png"), cv2.IMREAD_COLOR)
        small = cv2.resize(drawn, None, fx=FIGURE_SCALE, fy=FIGURE_SCALE, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(IMAGES / figure), small)


def reconstruct_ball(real: Path, method: str, out: Path) -> HeightMap:
    """Calibrate a real sensor into a folder named by the method, and return the heights of its ball."""
    names = ("board-reference", "board", "ball-reference", "ball")
    images = [word for name in names for word in (f"--{name}", str(real / f"{name.replace('-', '_')}.png"))]
    reference = ["--reference", str(real / "ball_reference.png")]
    run("calibrate", "--out", str(out / method), "--method", method, *images)
    results = str(out / f"{method}_ball")
    run("reconstruct", "--sensor", str(out / method), "--out", results, *reference, str(real / "ball.png"))
    return ninedtact.read_height_png(out / f"{method}_ball" / "ball_height.png")


def ball_figures(height: HeightMap) -> dict[str, Any]:
    """Return what captions say of a press: maximum indentation and bulge, means of the corners (2 x 2 mm), share below -0.1 mm."""
    side, seen = round(2 / height.mm_per_px), height.z_mm[np.isfinite(height.z_mm)]
    corners = [
        height.z_mm[rows, cols]
        for rows in (slice(side), slice(-side, None))
        for cols in (slice(side), slice(-side, None))
    ]
    means = [float(np.nanmean(corner)) for corner in corners]
    shape = ninedtact.summarise_shape(height)
    return {
        "indentation_mm": f"{shape.max_indentation_mm:.2f}",
        "bulge_mm": f"{shape.max_bulge_mm:.2f}",
        "corners_mm": " to ".join(f"{value:.2f}".replace("-", "−") for value in (max(means), min(means))),
        "below_percent": f"{100 * float(np.mean(seen < -0.1)):.0f}",
    }


def caption(picture: str, figures: dict[str, dict[str, Any]]) -> str:
    """Return the text below a picture of the real ball."""
    if picture == "ball_shaded.png":
        text = (
            "*A ball of radius 4 mm, pressed by hand into a real sensor, reconstructed from one image of the press and one "
            "reference image without contact: {indentation_mm} mm deep, with the displaced gel bulging up to {bulge_mm} mm around "
            "it (`make real`). Blue is indented, red bulges; shaded as if lit from the upper left.*"
        ).format(**figures["physics"])
    else:
        said = (
            "the ball is {indentation_mm} mm deep, the mean heights of the corners (2 × 2 mm) are {corners_mm} mm, and "
            "{below_percent} % of the view, contact included, is below −0.1 mm"
        )
        text = (
            "*Sensor A by `ratio`: `ninedtact calibrate --method ratio` with its four images, then `ninedtact reconstruct` with "
            f"`ball.png`. By `ratio` {said.format(**figures['ratio'])}. By `physics` {said.format(**figures['physics'])}.*"
        )
    return textwrap.fill(text, LINE_WIDTH, break_on_hyphens=False)


def save_with_caption(drawn: Path, picture: str, figures: dict[str, dict[str, Any]]) -> None:
    """Save a picture with its figures as text in the PNG, and write its caption into the page that shows it."""
    text = PngInfo()
    text.add_text("figures", json.dumps(figures))
    Image.open(drawn).save(IMAGES / picture, pnginfo=text, optimize=True)
    page = CAPTIONED[picture]
    begin, _, end = caption_of_page(picture)
    page.write_text(begin + caption(picture, figures) + end, encoding="utf-8")


def caption_of_page(picture: str) -> tuple[str, str, str]:
    """Return what a page has before the caption of a picture, the caption between its two markers, and the rest."""
    found = re.search(
        rf"(.*<!-- caption of {picture} -->\n)(.*?)(\n<!-- end -->.*)",
        CAPTIONED[picture].read_text(encoding="utf-8"),
        re.DOTALL,
    )
    if found is None:
        sys.exit(f"expected the markers of the caption of {picture} in {CAPTIONED[picture]}, got none")
    return found[1], found[2], found[3]


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

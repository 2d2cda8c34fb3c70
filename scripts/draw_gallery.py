"""Draw the pictures of docs/gallery.md into docs/images: objects pressed into the twin, as the camera sees them and as measured.

.venv/bin/python scripts/draw_gallery.py
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np

import ninedtact
from ninedtact import CalibrationImages, Frame, HeightMap, ScriptedPress, SensorFolder, Twin
from ninedtact.shape.coloured_height_map import colourise_heights, fit_colour_scale
from ninedtact.simulation.calibration_images import simulate_calibration_images

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
OBJECTS = (
    *("ball:4", "gear_07", "key_01", "coin_03", "spring_01", "screw_02"),
    *("fingerprint_01", "letter_04", "snowflake_01", "braille_01", "honeycomb_01", "leaf_01"),
)
RELIEFS = ("gear_07", "snowflake_01")
LOAD_N, COLUMNS, TILE_PX, GAP_PX, LABEL_PX = 12.0, 6, (240, 180), 6, 22
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 88]


def press(twin: Twin, folder: SensorFolder, name: str) -> tuple[np.ndarray, HeightMap]:
    """Return the camera image of an object pressed with `LOAD_N`, and the heights measured in it."""
    contact = ScriptedPress(load_n=LOAD_N).simulate(twin, ninedtact.indenter_from_name(name))
    image, untouched = twin.renderer(contact), Frame(twin.renderer(None, 1))
    reader = folder.shape.depth_reader(untouched)
    return image, reader(folder.shape.rectify(Frame(image)))


def shade(height: HeightMap) -> np.ndarray:
    """Return heights as a BGR image, in the colours of the live page and lit from the upper left."""
    coloured = colourise_heights(height, fit_colour_scale(height)).astype(float)
    down, along = np.gradient(height.z_mm, height.mm_per_px)
    light = (1 + 0.9 * (along + down)) / np.sqrt(1 + along**2 + down**2)
    return np.clip(coloured * np.clip(light, 0.45, 1.25)[..., None], 0, 255).astype(np.uint8)


def draw_tile(name: str, image: np.ndarray, height: HeightMap) -> np.ndarray:
    """Return camera image and heights below each other, with the name above them."""
    label = np.full((LABEL_PX, TILE_PX[0], 3), 255, np.uint8)
    cv2.putText(label, name, (2, LABEL_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (60, 60, 60), 1, cv2.LINE_AA)
    parts = [cv2.resize(part, TILE_PX, interpolation=cv2.INTER_AREA) for part in (image, shade(height))]
    return np.pad(np.vstack([label, *parts]), ((0, GAP_PX), (0, GAP_PX), (0, 0)), constant_values=255)


def main() -> None:
    """Calibrate the twin, press all objects and write the pictures."""
    twin = ninedtact.default_twin()
    images = CalibrationImages(**vars(simulate_calibration_images(twin, frames=4)))
    with tempfile.TemporaryDirectory() as temporary:
        folder = ninedtact.save_sensor(Path(temporary) / "twin", ninedtact.calibrate(images))
        pressed = {name: press(twin, folder, name) for name in OBJECTS}
    tiles = [draw_tile(name, *seen) for name, seen in pressed.items()]
    rows = [np.hstack(tiles[start : start + COLUMNS]) for start in range(0, len(tiles), COLUMNS)]
    cv2.imwrite(str(IMAGES / "gallery_objects.jpg"), np.vstack(rows), JPEG)
    for name in RELIEFS:
        relief = cv2.imdecode(
            np.frombuffer(ninedtact.render_relief(pressed[name][1], name), np.uint8), cv2.IMREAD_COLOR
        )
        cv2.imwrite(str(IMAGES / f"gallery_{name.partition('_')[0]}.jpg"), relief, JPEG)
    print(f"wrote the pictures of the gallery into {IMAGES}")


if __name__ == "__main__":
    main()

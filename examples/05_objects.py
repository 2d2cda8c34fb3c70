"""What can press the skin: generated objects from simple to complex, drawn on one sheet as their undersides are shaped."""

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

from ninedtact.mechanics.indenter import NO_OBJECT_MM, Indenter
from ninedtact.simulation.objects.catalogue import FAMILIES, indenter_from_name

RESULTS = Path(tempfile.gettempdir()) / "ninedtact_examples"

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("objects", nargs="*", help="as gear_07, ball:4, part.stl@in; default: the second of each family")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--columns", type=int, default=12)
parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the image")
options = parser.parse_args()

TILE_PX, TILE_MM = 112, 20.5
axis_mm = (np.arange(TILE_PX) - (TILE_PX - 1) / 2) * TILE_MM / TILE_PX
x_mm, y_mm = np.meshgrid(axis_mm, axis_mm)


def tile(pressed: Indenter) -> np.ndarray:
    """The underside, lit from the upper left; the lower a place, the brighter."""
    height_mm = pressed.underside_mm(x_mm, y_mm)
    there = height_mm < NO_OBJECT_MM / 2
    shown = np.clip(np.where(there, height_mm, 5), 0, 5)
    down, along = np.gradient(shown, TILE_MM / TILE_PX)
    light = (0.8 + 0.45 * (along + down)) / np.sqrt(1 + along**2 + down**2)
    grey = np.where(there, 255 * np.clip(0.2 + 0.7 * light - 0.08 * shown, 0.1, 1), 28)
    image = cv2.cvtColor(grey.astype(np.uint8), cv2.COLOR_GRAY2BGR)
    name = pressed.name[:20]
    return cv2.putText(image, name, (4, TILE_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.34, (120, 220, 255), 1, cv2.LINE_AA)


pressed = [
    indenter_from_name(name, options.seed) for name in options.objects or [f"{family}_02" for family in FAMILIES]
]
tiles = [tile(each) for each in pressed]
tiles += [np.full_like(tiles[0], 28)] * (-len(tiles) % options.columns)
rows = [np.hstack(tiles[start : start + options.columns]) for start in range(0, len(tiles), options.columns)]

options.out.mkdir(parents=True, exist_ok=True)
cv2.imwrite(str(options.out / "objects.png"), np.vstack(rows))
print(f"{len(pressed)} objects, each on {TILE_MM:g} x {TILE_MM:g} mm, in {options.out / 'objects.png'}")

"""A press → points with normals and meshes that other tools open, and a first measurement: the radius of a ball."""

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from ninedtact import Frame, export_shape, load_sensor, point_cloud, read_image

REAL = Path(os.environ.get("NINEDTACT_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "real"))
RESULTS = Path(tempfile.gettempdir()) / "ninedtact_examples"

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--sensor", type=Path, default=RESULTS / "sensor", help="what 01_calibrate.py wrote")
parser.add_argument("--reference", type=Path, default=REAL / "sensor_a" / "ball_reference.png")
parser.add_argument("--press", type=Path, default=REAL / "sensor_a" / "ball.png")
parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the results")
options = parser.parse_args()

shape = load_sensor(options.sensor).shape
reader = shape.depth_reader(Frame(read_image(options.reference)))
height = reader(shape.rectify(Frame(read_image(options.press))))

options.out.mkdir(parents=True, exist_ok=True)
for ending in ("ply", "stl", "obj"):  # the .ply has normals, the others only triangles
    export_shape(height, options.out / f"press.{ending}", every=3)  # each third row and column

points_mm = point_cloud(height).points_mm  # sensor frame: z outward, zero at the untouched skin
deep = points_mm[points_mm[:, 2] < -0.4].astype(float)
*centre_mm, offset = np.linalg.lstsq(np.c_[2 * deep, np.ones(len(deep))], (deep**2).sum(axis=1), rcond=None)[0]
print(
    f"{len(points_mm)} points; a ball of radius {np.sqrt(offset + np.dot(centre_mm, centre_mm)):.2f} mm fits the contact"
)

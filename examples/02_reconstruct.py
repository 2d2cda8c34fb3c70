"""An untouched and a pressed image of a calibrated sensor → the height of the skin in mm, measured and drawn."""

import argparse
import os
import tempfile
from pathlib import Path

from ninedtact import Frame, export_shape, load_sensor, read_image, summarise_shape
from ninedtact.shape.coloured_height_map import render_relief

REAL = Path(os.environ.get("NINEDTACT_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "real"))
RESULTS = Path(tempfile.gettempdir()) / "ninedtact_examples"

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--sensor", type=Path, default=RESULTS / "sensor", help="what 01_calibrate.py wrote")
parser.add_argument("--reference", type=Path, default=REAL / "sensor_a" / "ball_reference.png")
parser.add_argument("--press", type=Path, default=REAL / "sensor_a" / "ball.png")
parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the results")
options = parser.parse_args()

shape = load_sensor(options.sensor).shape
reader = shape.depth_reader(Frame(read_image(options.reference)))  # bound to the untouched skin of this session
height = reader(shape.rectify(Frame(read_image(options.press))))  # z_mm: negative where indented

measured = summarise_shape(height)
print(f"{height.z_mm.shape} heights, one every {height.mm_per_px:.4f} mm")
print(f"maximum indentation {measured.max_indentation_mm:.3f} mm, contact {measured.contact_area_mm2:.1f} mm²")
if measured.contact_centre_mm is not None:  # None where nothing touches
    print("centre at x {:.2f}, y {:.2f} mm".format(*measured.contact_centre_mm))

options.out.mkdir(parents=True, exist_ok=True)
export_shape(height, options.out / "height.npy")
(options.out / "height_shaded.png").write_bytes(render_relief(height))

"""The loop of a robot's controller: a reading for every image of a camera, or of a recording that stands in for it."""

import argparse
import os
import tempfile
from pathlib import Path

from ninedtact import Frame, ReferenceImages, Sensor, load_sensor, read_image, source_for, summarise_shape

REAL = Path(os.environ.get("NINEDTACT_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "real"))
RESULTS = Path(tempfile.gettempdir()) / "ninedtact_examples"

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--sensor", type=Path, default=RESULTS / "sensor", help="what 01_calibrate.py wrote")
parser.add_argument("--source", default=str(REAL / "sensor_a"), help="0, /dev/video0, URL, video or folder of images")
parser.add_argument("--reference", type=Path, default=REAL / "sensor_a" / "ball_reference.png", help="untouched skin")
options = parser.parse_args()

shape = load_sensor(options.sensor).shape
untouched = shape.depth_reader(Frame(read_image(options.reference)))  # left out, the first ten images are it
# With a camera, put LatestFrameSource(...) around the source: a slow loop then misses images instead of lagging behind.
with Sensor(source_for(options.source), shape, ReferenceImages(untouched)) as sensor:
    for reading in sensor:  # a recording has an end, a camera has none
        touch = summarise_shape(reading.height)
        cost_ms = reading.stage_ms["rectify"] + reading.stage_ms["depth"]
        print(
            f"image {reading.frame.index}: {touch.max_indentation_mm:.2f} mm deep, "
            f"{touch.contact_area_mm2:6.1f} mm² touched, in {cost_ms:.1f} ms"
        )
print("the recording is over")

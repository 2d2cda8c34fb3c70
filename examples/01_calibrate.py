"""Four images → a calibrated sensor: a folder with its figures, its images and a certificate to read."""

import argparse
import os
import tempfile
from pathlib import Path

from ninedtact import CalibrationImages, calibrate, read_image, save_sensor

REAL = Path(os.environ.get("NINEDTACT_REAL_DATA", Path(__file__).resolve().parents[2] / "shared" / "real"))
RESULTS = Path(tempfile.gettempdir()) / "ninedtact_examples"

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--images", type=Path, default=REAL / "sensor_a", help="folder of the four images")
parser.add_argument("--out", type=Path, default=RESULTS / "sensor", help="sensor folder to write")
options = parser.parse_args()

images = CalibrationImages(
    board_reference=read_image(options.images / "board_reference.png"),  # untouched skin
    board=read_image(options.images / "board.png"),  # the pin board pressed on it
    ball_reference=read_image(options.images / "ball_reference.png"),  # untouched again
    ball=read_image(options.images / "ball.png"),  # a ball of radius 4 mm pressed on it
)
sensor = save_sensor(options.out, calibrate(images, sensor_id=options.out.name))
figures = sensor.record.certificate

print(f"{figures.board.pins_found} pins; a left-out pin is predicted to {figures.board.leave_one_out_rms_mm:.3f} mm")
print(f"depth to {figures.ball.range_mm:.2f} mm, the ball read back to {figures.ball.reconstruction_mae_mm:.3f} mm")
print(*figures.warnings, f"read {options.out / 'certificate.html'}", sep="\n")

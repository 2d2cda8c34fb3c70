"""The six-axis force on every image, with its error, beside the truth: a twin is calibrated, once, pressed and dragged."""

import argparse
import tempfile
from pathlib import Path

from ninedtact import (
    CalibrationImages,
    Frame,
    ObjectTrajectory,
    Pose,
    PressSequence,
    ReferenceImages,
    Sensor,
    SimulatedCamera,
    calibrate,
    default_twin,
    indenter_from_name,
    load_sensor,
    press_trajectory,
    save_sensor,
)
from ninedtact.simulation.calibration_images import simulate_calibration_images

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--force", default="physics", help="physics, or a force model (.onnx)")
parser.add_argument("--sensor", type=Path, default=Path(tempfile.gettempdir()) / "ninedtact_examples" / "twin")
parser.add_argument("--object", default="ball:4")
options = parser.parse_args()

# With a sensor of your own: `ninedtact calibrate`, then load_sensor(folder).
twin = default_twin()
if not options.sensor.exists():
    save_sensor(options.sensor, calibrate(CalibrationImages(**vars(simulate_calibration_images(twin, frames=4)))))
folder = load_sensor(options.sensor)
shape, estimator = folder.shape, folder.estimator(options.force)

motion = press_trajectory(Pose(depth_mm=1.2), drag_mm=(0.8, 0.0))
stage = PressSequence(
    twin, [ObjectTrajectory(indenter_from_name(options.object), motion)], hz=20.0, real_time=False, rounds=1
)
untouched = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-8, 0)))

with Sensor(SimulatedCamera(stage), shape, ReferenceImages(untouched), estimator) as sensor:
    for reading in sensor:
        if reading.frame.index % 10 == 0:
            found, true = reading.force, stage.contact(reading.frame.index).wrench()
            told = ", ".join(
                f"{axis} {value:+.2f} ± {error:.2f} ({exact:+.2f}) N"
                for axis, value, error, exact in zip("xyz", found.wrench.force_n, found.std, true.force_n, strict=False)
            )
            warnings = "".join(f", {warning}" for warning in found.warnings)
            print(f"{reading.frame.index / stage.hz:.1f} s, {reading.stage_ms['force']:4.1f} ms: {told}{warnings}")

"""A fingertip rests on the head of a screw that a hand turns, a third of a turn at a time, and counts its turns.

Between two grips of the hand the fingertip is lifted and put down again. What turns meanwhile is not seen; here nothing does.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from ninedtact import (
    CalibrationImages,
    Frame,
    Pose,
    calibrate,
    default_twin,
    indenter_from_name,
    load_sensor,
    save_sensor,
)
from ninedtact.reading import read_frame
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.tracking import ObjectTracker, TrackState

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--sensor", type=Path, default=Path(tempfile.gettempdir()) / "ninedtact_examples" / "twin")
parser.add_argument("--screw", default="cross_02", help="its head: any object whose turn can be seen")
options = parser.parse_args()
GRIPS, GRIP_DEG, STEP_DEG, DEPTH_MM, SEEN_RAD = 9, 120, 10, 0.25, 0.5

# With a sensor of your own: `ninedtact calibrate`, then load_sensor(folder).
if not options.sensor.exists():
    images = simulate_calibration_images(default_twin(), frames=4)
    save_sensor(options.sensor, calibrate(CalibrationImages(**vars(images))))
folder = load_sensor(options.sensor)
twin, shape, screw = folder.twin(), folder.shape, indenter_from_name(options.screw)
untouched = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-8, 0)))

tracker, counted_deg, before_rad, number = ObjectTracker(), 0.0, None, 0
for grip in range(GRIPS):
    press = None
    for angle_deg in [None, *range(grip * GRIP_DEG, (grip + 1) * GRIP_DEG + 1, STEP_DEG)]:
        if angle_deg is not None:  # at first the fingertip is lifted
            press = twin.press(press, screw, Pose(0.1, -0.1, DEPTH_MM, np.radians(angle_deg)))
        frame = Frame(twin.renderer(None if press is None else press.corrected, number))
        found, number = tracker.update(read_frame(frame, shape, untouched)), number + 1
        if found.state == TrackState.NO_CONTACT:
            before_rad = None
        elif found.is_known and found.std[5] < SEEN_RAD:  # the turn of a ball never is
            if before_rad is not None:
                counted_deg += np.degrees((found.motion.yaw_rad - before_rad + np.pi) % (2 * np.pi) - np.pi)
            before_rad = found.motion.yaw_rad
    print(f"grip {grip + 1}: {counted_deg:.1f}° ({(grip + 1) * GRIP_DEG}° are true)")
print(f"{counted_deg / 360:.3f} turns")

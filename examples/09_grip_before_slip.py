"""A finger holds a ball whose load grows, and tightens its grip when slip is imminent; and what happens when it does not."""

import argparse
import tempfile
from dataclasses import replace
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
from ninedtact.tracking import ContactTracker, SlipState

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--sensor", type=Path, default=Path(tempfile.gettempdir()) / "ninedtact_examples" / "twin")
parser.add_argument("--friction", type=float, default=0.5, help="of the twin; the finger does not know it")
options = parser.parse_args()
HZ, PULL_MM_PER_S, LEAST_STICKING, TIGHTENS_MM, DEEPEST_MM = 60, 3.0, 0.6, 0.03, 1.4

# With a sensor of your own: `ninedtact calibrate`, then load_sensor(folder).
if not options.sensor.exists():
    images = simulate_calibration_images(default_twin(), frames=4)
    save_sensor(options.sensor, calibrate(CalibrationImages(**vars(images))))
folder = load_sensor(options.sensor)
twin, shape, estimator = replace(folder.twin(), friction=options.friction), folder.shape, folder.estimator("physics")
untouched = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-8, 0)))

for tightens in (False, True):
    tracker, press, pose, slid = ContactTracker(), None, Pose(-1.0, 0.0, 0.5), 0
    estimator.forget()
    for number in range(50):
        press = twin.press(press, indenter_from_name("ball:4"), pose)
        frame = Frame(twin.renderer(press.corrected, number), (number + 1) * 10**9 // HZ, number)
        found = tracker.update(estimator.add_force(read_frame(frame, shape, untouched)))
        slip, force_n = found.slip, found.contacts[0].force.wrench.force_n
        slid += slip.state == SlipState.GROSS
        if tightens and slip.sticking_share < LEAST_STICKING and pose.depth_mm < DEEPEST_MM:
            pose = replace(pose, depth_mm=pose.depth_mm + TIGHTENS_MM)
        if number >= 15:  # the load grows: it pulls the ball along the skin
            pose = replace(pose, x_mm=pose.x_mm + PULL_MM_PER_S / HZ)
        if number % 10 == 9:
            print(
                f"{number / HZ:.2f} s: pressed with {-force_n[2]:.2f} N, pulled with {np.hypot(*force_n[:2]):.2f} N, "
                f"{slip.sticking_share:.0%} sticks, {slip.state}"
            )
    print(f"{'tightened' if tightens else 'not tightened'}: slid in {slid} of 50 images")

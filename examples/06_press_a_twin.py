"""A sensor that is not there: an object pressed, dragged and twisted, seen by a camera, felt by a force/torque sensor."""

import argparse
from math import radians

from ninedtact import (
    ObjectTrajectory,
    Pose,
    PressSequence,
    SimulatedCamera,
    SimulatedForceTorque,
    default_twin,
    indenter_from_name,
    press_trajectory,
)

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--object", default="ball:4", help="ball:4, gear_07, part.stl@in; see ninedtact simulate objects")
parser.add_argument("--depth-mm", type=float, default=1.2)
options = parser.parse_args()

# Everything that takes a camera takes this one; load_sensor(folder).twin() is the twin of a sensor that you have.
motion = press_trajectory(Pose(depth_mm=options.depth_mm), drag_mm=(0.8, 0.0), twist_rad=radians(10))
stage = PressSequence(
    default_twin(), [ObjectTrajectory(indenter_from_name(options.object), motion)], hz=20.0, real_time=False, rounds=1
)

with SimulatedCamera(stage) as camera, SimulatedForceTorque(stage, hz=20.0) as force_torque:
    for frame, wrench in zip(camera, force_torque, strict=False):
        if frame.index % 10 == 0:
            darkest, (x, y, z) = frame.image[120:360, 160:480].min(), wrench.force_n
            about_z = wrench.torque_nm[2] * 1e3
            seconds = frame.index / stage.hz
            print(
                f"{seconds:.1f} s: darkest in the middle {darkest}, force ({x:+.2f}, {y:+.2f}, {z:+.2f}) N, "
                f"twist {about_z:+.2f} mN·m"
            )

contact = stage.contact(int(motion.duration_s * stage.hz))  # the truth behind both: pressure, shear, heights
print(f"lifted at the end: {'still touching' if contact.touches else 'nothing touches'}")

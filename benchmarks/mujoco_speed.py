"""The sensor in a MuJoCo scene on one thread: steps per second and forces, for objects that are pressed, rolled and dragged.

A step is eight of MuJoCo (16 ms of the scene), the gel's contact, the image of 640 x 480, the heights and the wrench. An object is
pressed with 2 N and pushed along the skin with a force that grows to 1 N; it then rolls, or sticks. Times are of the thread itself
(median over the steps with contact). The error of a force is that of the gel less MuJoCo's.
"""

from statistics import median
from time import thread_time
from typing import Any

import cv2
import mujoco
import numpy as np
import tyro
from figures import Figure, answer, at_least, at_most

from ninedtact.interop.mujoco import TactileSensor
from ninedtact.simulation.twin import default_twin

GEOMS = {
    "ball, rolls": 'type="sphere" size="0.004"',
    "cylinder, rolls": 'type="cylinder" size="0.003 0.004" euler="90 0 0"',
    "capsule, sticks": 'type="capsule" size="0.003 0.004" euler="0 90 0"',
    "box, sticks": 'type="box" size="0.003 0.003 0.003"',
    "mesh, sticks": 'type="mesh" mesh="wedge"',
}
SCENE = """<mujoco><option timestep="0.002" gravity="0 0 0" integrator="implicitfast" cone="elliptic" impratio="10"/>
<asset><mesh name="wedge" vertex="-.004 -.003 0  .004 -.003 0  0 .004 0  0 0 -.004"/></asset>
<worldbody><body name="sensor"><geom type="box" pos="0 0 -0.0025" size="0.01475 0.01125 0.0025" solref="0.01 1"/></body>
<body pos="0 0 0.0041"><joint type="slide" axis="1 0 0" damping="10"/><joint type="slide" axis="0 0 1" damping="10"/>{hinge}
<geom {geom} mass="0.02"/></body></worldbody></mujoco>"""
STEPS_PER_S = 60.0
PUSH_N, DRAG_N = 2.0, 1.0
MAX_ERROR_N = 0.1


def mujoco_speed(steps: int = 90, quick: bool = False, json: bool = False) -> None:
    """Measure, and print what it must reach."""
    cv2.setNumThreads(1)
    twin, geoms = default_twin(), dict(list(GEOMS.items())[:1]) if quick else GEOMS
    steps = 24 if quick else steps
    figures: list[Figure] = []
    for name, geom in geoms.items():
        hinge = '<joint type="hinge" axis="0 1 0" damping="1e-4"/>' if "rolls" in name else ""
        model = mujoco.MjModel.from_xml_string(SCENE.format(geom=geom, hinge=hinge))
        times, errors = run(model, TactileSensor(model, mujoco.MjData(model), "sensor", twin), steps)
        figures.append(at_least(f"{name}: steps per second", 1 / median(times), STEPS_PER_S))
        for axis, error in zip(("along the skin", "normal"), np.median(np.abs(errors), axis=0).tolist(), strict=True):
            figures.append(at_most(f"{name}: force {axis}, median error", error, MAX_ERROR_N, "N"))
    answer("A sensor in MuJoCo, one thread", figures, json)


def run(model: Any, sensor: TactileSensor, steps: int) -> tuple[list[float], list[tuple[float, float]]]:
    """The time of each step with contact, and the gel's force less MuJoCo's along the skin and normal to it."""
    times, errors = [], []
    sensor.open()
    for step in range(steps):
        sensor.data.qfrc_applied[:2] = DRAG_N * min(1.0, max(0.0, (step - 10) / 30)), -PUSH_N * min(1.0, step / 20)
        began = thread_time()
        mujoco.mj_step(model, sensor.data, 8)
        reading = sensor.step()
        assert reading.heights.z_mm.shape == (90, 120) and reading.frame.image.shape == (480, 640, 3)
        if reading.contact is not None and step > 20:
            times.append(thread_time() - began)
            error = reading.wrench.force_n - reading.scene_wrench.force_n
            errors.append((float(np.hypot(*error[:2])), float(error[2])))
    return times, errors


if __name__ == "__main__":
    tyro.cli(mujoco_speed)

"""Touch in MuJoCo: a finger grips a bar until its image says 2 N, then slides along the bar's edge and keeps that load."""

import argparse
import tempfile
from pathlib import Path

import mujoco
import numpy as np

import ninedtact
from ninedtact.interop.mujoco import TactileSensor
from ninedtact.simulation.calibration_images import simulate_calibration_images

SCENE = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default><joint type="slide" armature="0.05"/><position kp="2000" dampratio="1"/><geom friction="0.4"/></default>
  <worldbody>
    <body name="bar"><geom type="capsule" size="0.003 {half_length_m}" euler="0 90 0"/></body>
    <body name="thumb" pos="0 0 0.004">
      <joint name="thumb_closes" axis="0 0 -1"/><geom type="box" pos="0 0 0.003" size="0.01 0.01 0.002" mass="0.05"/>
    </body>
    <body name="finger" pos="0 0 -0.0035">
      <joint name="slides" axis="1 0 0"/><joint name="closes" axis="0 0 1"/>
      <geom type="box" pos="0 0 -0.0025" size="0.01475 0.01125 0.0025" mass="0.05" solref="0.01 1"/>
    </body>
  </worldbody>
  <actuator><position joint="closes"/><position joint="slides"/><position joint="thumb_closes"/></actuator>
</mujoco>
"""
STEP_S, WANTED_N, SLIDES_M_PER_S = 0.02, 2.0, 1e-3

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--sensor", type=Path, default=Path(tempfile.gettempdir()) / "ninedtact_examples" / "twin")
parser.add_argument("--bar-mm", type=float, default=10.0, help="length of the bar; the camera sees 24 mm")
options = parser.parse_args()

# With a sensor of your own: `ninedtact calibrate`, and give its folder.
images = simulate_calibration_images(ninedtact.default_twin(), frames=4)
ninedtact.save_sensor(options.sensor, ninedtact.calibrate(ninedtact.CalibrationImages(**vars(images))))

half_length_m = max(options.bar_mm / 2e3 - 0.003, 1e-4)  # of the cylinder between the bar's round ends
model = mujoco.MjModel.from_xml_string(SCENE.format(half_length_m=half_length_m))
data = mujoco.MjData(model)
skin = TactileSensor(model, data, "finger", options.sensor)

print("          time   load by image, N   gel of the twin   MuJoCo   friction by image, N     MuJoCo")
grips, errors, frictions, warnings = True, [], [], set()
with ninedtact.open(
    options.sensor, source=skin
) as sensor:  # the first images, while nothing touches, are the reference
    for number in range(240):
        mujoco.mj_step(model, data, round(STEP_S / model.opt.timestep))
        found = sensor.read().force
        load_n, gel_n, scene_n = (
            -wrench.force_n[2] for wrench in (found.wrench, skin.last.wrench, skin.last.scene_wrench)
        )
        closing_mm = float(np.clip(0.3 * (WANTED_N - load_n), -0.1, 0.1))  # the loop closes on the image
        data.ctrl[[0, 2]] += closing_mm / 1e3
        grips = grips and load_n < 0.98 * WANTED_N
        data.ctrl[1] += 0.0 if grips else SLIDES_M_PER_S * STEP_S
        if not grips:
            errors.append(load_n - scene_n)
            frictions.append(found.wrench.force_n[0] - skin.last.scene_wrench.force_n[0])
            warnings.update(found.warnings)
        if number % 20 == 19:
            print(
                f"{'grips ' if grips else 'slides'} {data.time:6.2f} s   {load_n:5.2f} ± {found.std[2]:.2f}       {gel_n:5.2f}"
                f"             {scene_n:5.2f}    {found.wrench.force_n[0]:+5.2f} ± {found.std[0]:.2f}          "
                f"{skin.last.scene_wrench.force_n[0]:+5.2f}"
            )
for name, values in (("load", errors), ("friction", frictions)):
    print(f"while sliding: {name} by image less MuJoCo's {np.mean(values):+.2f} ± {np.std(values):.2f} N")
print(f"warnings of the estimates: {', '.join(sorted(one.value for one in warnings)) or 'none'}")

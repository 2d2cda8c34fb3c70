"""A Gymnasium environment with touch: a sensor is pressed on a rail of unknown direction and must follow it with 1 N.

`gymnasium.make("ninedtact/EdgeFollowing-v0")` works after this module was imported.
"""

from typing import Any

import numpy as np

from ninedtact.interop.mujoco import TactileReading
from ninedtact_train.environments.tactile_environment import STEP_S, TactileEnvironment
from ninedtact_train.environments.vector_environment import register_task

SCENE = """
<mujoco model="edge following">
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default><joint type="slide" armature="0.05"/><position kp="2000" dampratio="1"/></default>
  <worldbody>
    <body name="rail"><geom type="capsule" size="0.003 0.04" euler="0 90 0" friction="0.5"/></body>
    <body name="sensor" pos="0 0 0.0035" euler="180 0 0">
      <joint name="along" axis="1 0 0"/><joint name="across" axis="0 -1 0"/><joint name="down" axis="0 0 1"/>
      <geom type="box" pos="0 0 -0.0025" size="0.01475 0.01125 0.0025" mass="0.05" friction="0.5" solref="0.01 1"/>
    </body>
  </worldbody>
  <actuator><position joint="along"/><position joint="across"/><position joint="down"/></actuator>
</mujoco>
"""
"""A rail of 6 mm in diameter, and a sensor that looks down on it and is moved by three springs of 2 N/mm."""

SPEED_MM_PER_S = (20.0, 20.0, 5.0)
"""Speeds along, across and towards the rail that the actions ±1 stand for."""
LOAD_N = 1.0
RAIL_MM = 12.0
"""Way along the rail after which an episode ends well."""
_TURN_RAD, _OFFSET_MM = 0.2, 1.5


class EdgeFollowingEnvironment(TactileEnvironment):
    """Follow a rail with the camera image and the gel's wrench (`TactileEnvironment`).

    Action: speeds from −1 to 1 along the world's x axis, across it and towards the rail. Reward of a step: mm of progress, less a
    tenth of the distance of the rail from the middle in mm and of the error of the load in N.
    """

    scene = SCENE
    approach = (0.0, 0.0, 1.0)

    def arrange_scene(self) -> None:
        """Turn and move the rail."""
        turn = self.np_random.uniform(-_TURN_RAD, _TURN_RAD)
        rail = self.model.body("rail")
        rail.quat[:] = np.cos(turn / 2), 0, 0, np.sin(turn / 2)
        rail.pos[1] = self.np_random.uniform(-_OFFSET_MM, _OFFSET_MM) / 1e3

    def act(self, action: Any) -> None:
        """Move the springs' ends."""
        self.data.ctrl += action * SPEED_MM_PER_S * STEP_S / 1e3

    def judge(self, state: dict[str, Any]) -> tuple[float, bool]:
        """Return the reward of a step, and whether the end of the rail is reached."""
        error = abs(state["offset_mm"]) + abs(state["load_n"] - LOAD_N)
        return self.progress_mm() - 0.1 * error, self.distance_mm <= 0

    def state(self, reading: TactileReading) -> dict[str, Any]:
        """Return where the rail is from the middle of the skin, and the load of the scene."""
        rail, place = self.model.body("rail"), self.data.body("sensor").xpos
        along = self.data.body("rail").xmat.reshape(3, 3)[:, 0]
        away = place - rail.pos
        offset = away[1] * along[0] - away[0] * along[1]
        return {"offset_mm": 1e3 * float(offset), "load_n": -float(reading.scene_wrench.force_n[2])}

    @property
    def distance_mm(self) -> float:
        """The rest of the way along the first direction of the rail."""
        return RAIL_MM - 1e3 * float(self.data.joint("along").qpos[0])


register_task("ninedtact/EdgeFollowing-v0", EdgeFollowingEnvironment)

"""A Gymnasium environment with touch: two fingers hold a peg and must insert it into a hole whose place they do not know.

`gymnasium.make("ninedtact/PegInsertion-v0")` works after this module was imported.
"""

from typing import Any, ClassVar

import numpy as np

from ninedtact.interop.mujoco import TactileReading
from ninedtact_train.environments.tactile_environment import (
    REFUSED_REWARD,
    STEP_S,
    Observation,
    TactileEnvironment,
    gymnasium,
)
from ninedtact_train.environments.vector_environment import register_task

SCENE = """
<mujoco model="peg insertion">
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10" gravity="0 0 0"/>
  <default>
    <joint type="slide" armature="0.05"/><position kp="2000" dampratio="1"/>
    <geom friction="1 0.001 0.0001" solref="0.004 1"/>
    <default class="plate"><geom type="box" friction="0.2 0.001 0.0001" priority="1"/></default>
  </default>
  <worldbody>
    <body name="plate">
      <geom class="plate" pos="0.01125 0 -0.005" size="0.009 0.02025 0.005"/>
      <geom class="plate" pos="-0.01125 0 -0.005" size="0.009 0.02025 0.005"/>
      <geom class="plate" pos="0 0.01125 -0.005" size="0.00225 0.009 0.005"/>
      <geom class="plate" pos="0 -0.01125 -0.005" size="0.00225 0.009 0.005"/>
    </body>
    <body name="hand" pos="0 0 0.021">
      <joint name="x" axis="1 0 0"/><joint name="y" axis="0 1 0"/><joint name="down" axis="0 0 -1"/>
      <geom type="box" pos="0 0 0.03" size="0.01 0.02 0.01" mass="0.1" contype="0" conaffinity="0"/>
      <body name="sensor" pos="0 -0.0031 0" xyaxes="1 0 0 0 0 -1">
        <geom type="box" pos="0 0 -0.0025" size="0.01475 0.01125 0.0025" mass="0.05"/>
      </body>
      <body name="thumb" pos="0 0.0053 0">
        <joint name="thumb" axis="0 -1 0" damping="20"/><geom type="box" size="0.01 0.002 0.01" mass="0.05"/>
      </body>
    </body>
    <body name="peg" pos="0 0 0.021">
      <freejoint/>
      <geom type="box" size="0.004 0.003 0.004" mass="0.01"/>
      <geom type="capsule" fromto="0 0 -0.004 0 0 -0.0175" size="0.002" mass="0.005"/>
      <site name="pin" type="capsule" fromto="0 0 -0.007 0 0 -0.0175" size="0.0025"/>
      <site name="tip" pos="0 0 -0.0195"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x"/><position joint="y"/><position joint="down"/><motor name="grip" joint="thumb"/>
  </actuator>
  <sensor><touch site="pin"/></sensor>
</mujoco>
"""
"""A pin of 4 mm in diameter with a round tip, on a block that a thumb presses on the skin; a square hole of 4.5 mm in a plate."""

SPEED_MM_PER_S = (20.0, 20.0, 10.0)
"""Speeds of the hand along x and y and downwards that the actions ±1 stand for."""
GRIP_N = 3.0
"""Force of the thumb."""
LIMIT_N = 1.2
"""Force of the plate on the pin that ends an episode."""
DEPTH_MM = 4.0
"""Depth of the tip in the hole at which an episode ends well."""
_OFFSETS_MM = (1.2, 1.6)
"""Smallest and largest distance of the hole from the peg at the start."""


class PegInsertionEnvironment(TactileEnvironment):
    """Insert a peg into a hole 1.2 to 1.6 mm beside it, with little force (`TactileEnvironment`).

    The sensor is one of two fingers: its x axis is that of the hand, its y axis points down, and z to the thumb. The observation
    also has `hand_mm`, how far the hand has moved along x and y and downwards. Action: speeds of the hand along x and y and
    downwards, from −1 to 1. Reward of a step: mm by which the tip came nearer to its place in the hole, less 0.05; 10 more where it
    arrives. The episode ends with −10 where the plate resists with more than 1.2 N.
    """

    scene = SCENE
    approach = (0.0, 0.0, 0.0)
    more_spaces: ClassVar = {"hand_mm": gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)}

    def arrange_scene(self) -> None:
        """Place the hole."""
        angle, offset_mm = self.np_random.uniform(0, 2 * np.pi), self.np_random.uniform(*_OFFSETS_MM)
        self.model.body("plate").pos[:2] = offset_mm / 1e3 * np.array([np.cos(angle), np.sin(angle)])

    def act(self, action: Any) -> None:
        """Move the hand."""
        self.data.ctrl[:3] += action * SPEED_MM_PER_S * STEP_S / 1e3
        self.data.ctrl[3] = GRIP_N

    def more_observations(self) -> Observation:
        """Return the motion of the hand."""
        return {"hand_mm": (1e3 * self.data.qpos[:3]).astype(np.float32)}

    def judge(self, state: dict[str, Any]) -> tuple[float, bool]:
        """Return the reward of a step, and whether the peg is in or pressed too hard."""
        if state["pin_n"] > LIMIT_N:
            return REFUSED_REWARD, True
        return self.progress_reward(bool(state["tip_mm"][2] <= -DEPTH_MM))

    def state(self, reading: TactileReading) -> dict[str, Any]:
        """Return the place of the tip from the mouth of the hole, the force of the plate on the pin, and the load of the scene."""
        return {
            "tip_mm": self._tip_mm,
            "pin_n": float(self.data.sensordata[0]),
            "load_n": -float(reading.scene_wrench.force_n[2]),
        }

    @property
    def distance_mm(self) -> float:
        """The distance of the tip from its place in the hole."""
        return float(np.linalg.norm(self._tip_mm - (0.0, 0.0, -DEPTH_MM)))

    @property
    def _tip_mm(self) -> Any:
        """The tip of the pin, from the middle of the hole's mouth."""
        return 1e3 * (self.data.site("tip").xpos - self.model.body("plate").pos)


register_task("ninedtact/PegInsertion-v0", PegInsertionEnvironment)

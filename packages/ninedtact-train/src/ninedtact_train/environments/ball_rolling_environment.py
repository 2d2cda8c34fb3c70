"""A Gymnasium environment with touch: a plate rolls a ball over the skin to a place that is given, as fingertips do.

`gymnasium.make("ninedtact/BallRolling-v0")` works after this module was imported.
"""

from typing import Any, ClassVar

import numpy as np

from ninedtact.interop.mujoco import TactileReading
from ninedtact_train.environments.tactile_environment import STEP_S, Observation, TactileEnvironment, gymnasium
from ninedtact_train.environments.vector_environment import register_task

SCENE = """
<mujoco model="ball rolling">
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10" gravity="0 0 0"/>
  <default><joint type="slide" armature="0.05"/><geom friction="1 0.001 0.0001" solref="0.01 1"/></default>
  <worldbody>
    <body name="sensor"><geom type="box" pos="0 0 -0.0025" size="0.01475 0.01125 0.0025"/></body>
    <body name="ball" pos="0 0 0.0041"><freejoint/><geom type="sphere" size="0.004" mass="0.01"/></body>
    <body name="plate" pos="0 0 0.0105">
      <joint name="x" axis="1 0 0"/><joint name="y" axis="0 1 0"/><joint name="down" axis="0 0 -1" damping="20"/>
      <geom type="box" size="0.03 0.03 0.002" mass="0.05"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="2000" dampratio="1"/><position joint="y" kp="2000" dampratio="1"/><motor joint="down"/>
  </actuator>
</mujoco>
"""
"""A ball of 4 mm radius between a sensor that faces up and a plate that is pressed down with a force."""

SPEED_MM_PER_S = 20.0
"""Speed of the plate along x and y that the actions ±1 stand for; the ball rolls half as fast."""
LOAD_N = 1.0
"""Force of the plate; the third action changes it by up to half of this."""
REACHED_MM = 0.5
"""Distance of the ball from its goal at which an episode ends well."""
_START_MM, _GOAL_MM = 1.5, 5.0


class BallRollingEnvironment(TactileEnvironment):
    """Roll a ball to a goal with the camera image and the gel's wrench (`TactileEnvironment`).

    Observation besides: `goal_mm`, the x and y on the skin to which the ball must roll. Action: speeds of the plate along x and y
    from −1 to 1, and its load from 0.5 N (−1) to 1.5 N (1). Reward of a step: mm by which the ball came nearer to the goal, less
    0.05; 10 more where it arrives.
    """

    scene = SCENE
    approach = (0.0, 0.0, 0.0)
    more_spaces: ClassVar = {"goal_mm": gymnasium.spaces.Box(-_GOAL_MM, _GOAL_MM, (2,), np.float32)}
    _goal_mm = np.zeros(2)

    def arrange_scene(self) -> None:
        """Place ball and goal."""
        self.data.joint(0).qpos[:2] = self.np_random.uniform(-_START_MM, _START_MM, 2) / 1e3
        angle = self.np_random.uniform(0, 2 * np.pi)
        self._goal_mm = _GOAL_MM * np.array([np.cos(angle), np.sin(angle)])

    def act(self, action: Any) -> None:
        """Move the plate and set its force."""
        self.data.ctrl[:2] += action[:2] * SPEED_MM_PER_S * STEP_S / 1e3
        self.data.ctrl[2] = LOAD_N * (1 + action[2] / 2)

    def judge(self, state: dict[str, Any]) -> tuple[float, bool]:
        """Return the reward of a step, and whether the ball has arrived."""
        return self.progress_reward(state["distance_mm"] < REACHED_MM)

    def state(self, reading: TactileReading) -> dict[str, Any]:
        """Return where the ball is on the skin, how far its goal is, and the load of the scene."""
        return {
            "ball_mm": self._ball_mm,
            "distance_mm": self.distance_mm,
            "load_n": -float(reading.scene_wrench.force_n[2]),
        }

    def more_observations(self) -> Observation:
        """Return the goal."""
        return {"goal_mm": np.clip(self._goal_mm, -_GOAL_MM, _GOAL_MM).astype(np.float32)}

    @property
    def _ball_mm(self) -> Any:
        return 1e3 * self.data.body("ball").xpos[:2].copy()

    @property
    def distance_mm(self) -> float:
        """The distance of the ball from its goal."""
        return float(np.hypot(*(self._goal_mm - self._ball_mm)))


register_task("ninedtact/BallRolling-v0", BallRollingEnvironment)

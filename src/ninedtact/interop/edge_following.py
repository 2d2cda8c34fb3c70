"""A Gymnasium environment with touch: a sensor is pressed on a rail of unknown direction and must follow it with 1 N.

`gymnasium.make("ninedtact/EdgeFollowing-v0")` works after this module was imported.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np

from ninedtact.errors import SimulationError
from ninedtact.interop.mujoco import TactileReading, TactileSensor, require_mujoco
from ninedtact.simulation.twin import Twin, default_twin

require_mujoco("gymnasium")

import gymnasium  # noqa: E402 - after the check that it is there
import mujoco  # noqa: E402

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder

Observation = dict[str, Any]

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

IMAGE_SHAPE = (60, 80)
STEP_S = 0.02
SUBSTEPS = 10
SPEED_MM_PER_S = (20.0, 20.0, 5.0)
"""Speeds along, across and towards the rail that the actions ±1 stand for."""
LOAD_N = 1.0
RAIL_MM = 12.0
"""Way along the rail after which an episode ends well."""
MAX_STEPS = 200
_TURN_RAD, _OFFSET_MM = 0.2, 1.5
_TOUCH_N = 0.3
_LOST_STEPS = 25


class EdgeFollowing(gymnasium.Env[Observation, np.ndarray]):  # type: ignore[misc]
    """Follow a rail with the camera image and the gel's wrench.

    Observation: `image`, the grey image of the camera at 60 × 80 pixels, and `wrench`, N and N·m in the sensor frame. Action:
    speeds from −1 to 1 along the world's x axis, across it and towards the rail. Reward of a step: mm of progress, less a tenth of
    the distance of the rail from the middle in mm and of the error of the load in N.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": round(1 / STEP_S)}

    def __init__(
        self, sensor_folder: "SensorFolder | Twin | Path | str | None" = None, render_mode: str | None = None
    ) -> None:
        self.model = mujoco.MjModel.from_xml_string(SCENE)
        self.data = mujoco.MjData(self.model)
        self.sensor = TactileSensor(self.model, self.data, "sensor", sensor_folder or default_twin())
        self.render_mode, self._steps, self._lost = render_mode, 0, 0
        self._reading: TactileReading | None = None
        self.observation_space = gymnasium.spaces.Dict(
            {
                "image": gymnasium.spaces.Box(0, 255, IMAGE_SHAPE, np.uint8),
                "wrench": gymnasium.spaces.Box(-np.inf, np.inf, (6,), np.float32),
            }
        )
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Place the rail anew and lower the sensor until it touches."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        turn = self.np_random.uniform(-_TURN_RAD, _TURN_RAD)
        rail = self.model.body("rail")
        rail.quat[:] = np.cos(turn / 2), 0, 0, np.sin(turn / 2)
        rail.pos[1] = self.np_random.uniform(-_OFFSET_MM, _OFFSET_MM) / 1e3
        self.sensor.open()
        self._steps = self._lost = 0
        reading = self._advance(np.zeros(3))
        while -reading.scene_wrench.force_n[2] < _TOUCH_N:
            reading = self._advance(np.array([0.0, 0.0, 1.0]))
        return self._observation(reading), self._state(reading)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move for 20 ms."""
        before = self._progress_mm
        self._steps += 1
        try:
            reading = self._advance(np.clip(action, -1.0, 1.0))
        except SimulationError as refused:  # pressed through the gel or off its edge: the end of the episode
            assert self._reading is not None
            return self._observation(self._reading), -10.0, True, False, {"refused": str(refused)}
        state = self._state(reading)
        self._lost = self._lost + 1 if state["load_n"] < _TOUCH_N / 10 else 0
        error = abs(state["offset_mm"]) + abs(state["load_n"] - LOAD_N)
        ended = self._progress_mm >= RAIL_MM or self._lost >= _LOST_STEPS
        reward = self._progress_mm - before - 0.1 * error
        return self._observation(reading), float(reward), bool(ended), self._steps >= MAX_STEPS, state

    def render(self) -> Any:
        """Return the raw image of the camera, RGB."""
        assert self._reading is not None
        return cv2.cvtColor(self._reading.frame.image, cv2.COLOR_BGR2RGB)

    def _advance(self, action: Any) -> TactileReading:
        """Move the springs' ends and return what the sensor shows and feels after a step."""
        self.data.ctrl += action * SPEED_MM_PER_S * STEP_S / 1e3
        mujoco.mj_step(self.model, self.data, SUBSTEPS)
        self._reading = self.sensor.step()
        return self._reading

    def _observation(self, reading: TactileReading) -> Observation:
        """Return the small grey image and the wrench."""
        grey = cv2.cvtColor(reading.frame.image, cv2.COLOR_BGR2GRAY)
        image = cv2.resize(grey, IMAGE_SHAPE[::-1], interpolation=cv2.INTER_AREA)
        return {"image": image, "wrench": reading.wrench.six.astype(np.float32)}

    @property
    def _progress_mm(self) -> float:
        """The way along the first direction of the rail."""
        return 1e3 * float(self.data.joint("along").qpos[0])

    def _state(self, reading: TactileReading) -> dict[str, Any]:
        """Return what an agent does not see: where the rail is from the middle of the skin, and the load of the scene."""
        rail, place = self.model.body("rail"), self.data.body("sensor").xpos
        along = self.data.body("rail").xmat.reshape(3, 3)[:, 0]
        away = place - rail.pos
        offset = away[1] * along[0] - away[0] * along[1]
        return {"offset_mm": 1e3 * float(offset), "load_n": -float(reading.scene_wrench.force_n[2])}


gymnasium.register("ninedtact/EdgeFollowing-v0", entry_point=EdgeFollowing)

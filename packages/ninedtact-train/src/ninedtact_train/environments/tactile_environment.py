"""What the Gymnasium environments with touch share: a MuJoCo scene with a sensor, its observations, and the end of an episode."""

from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact import open_sensor
from ninedtact.capture.frame_source import FrameSourceWrapper
from ninedtact.errors import InputError, NinedtactError, SimulationError
from ninedtact.interop.mujoco import TactileReading, TactileSensor
from ninedtact.mechanics.pose import InvalidPose
from ninedtact.quantities import Frame
from ninedtact.required_libraries import require_libraries
from ninedtact.sensor import Sensor
from ninedtact.simulation.twin import Twin, default_twin

require_libraries("environments", "mujoco", "gymnasium")

import gymnasium as gymnasium  # noqa: E402 - after the check that it is there; tasks import it from here
import mujoco  # noqa: E402

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder

Observation = dict[str, Any]
Estimates = tuple[Float32[Array, "rows cols"], Float64[Array, "6"]]
"""Heights in mm and the wrench, in N and N·m, that were estimated from an image."""

IMAGE_SHAPE = (60, 80)
STEP_S = 0.02
OBSERVATIONS = ("image", "heights", "wrench")
OF_THE_GEL = "gel"
"""The `force` whose observations are heights and wrench of the twin's own gel."""
TOUCH_N = 0.3
"""Load from which a sensor counts as touching at the start of an episode."""
_SUBSTEPS = 10
_MAX_STEPS = 200
_LOST_STEPS = 25
REFUSED_REWARD = -10.0
"""Reward of a step that ends an episode because it pressed too hard."""
PRESS_REFUSED = (SimulationError, InvalidPose)
"""What a sensor raises that is pressed through the gel or off its edge."""
_ARRIVAL_REWARD, _STEP_COST = 10.0, 0.05


def needs_calibrated_sensor(force: str, sensor_folder: Any) -> InputError:
    """Return the error of an estimator without a sensor that is calibrated for it."""
    return InputError(
        expected=f"force={OF_THE_GEL!r}, or the name of an estimator and the folder of a calibrated sensor",
        got=f"force={force!r} and sensor_folder={getattr(sensor_folder, 'name', sensor_folder)!s}",
        remedy="correct one of them",
    )


class _NewestFrame(FrameSourceWrapper):
    """Frames of a sensor in a scene: its newest reading, or a new press of the scene where that reading was returned before."""

    def __init__(self, sensor: TactileSensor) -> None:
        super().__init__(sensor)
        self._sensor, self._read_last = sensor, sensor.last

    def read(self) -> Frame:
        """Return the frame; raises what `TactileSensor.step` raises."""
        if self._sensor.last is None or self._sensor.last is self._read_last:
            self._sensor.step()
        self._read_last = self._sensor.last
        assert self._read_last is not None
        return self._read_last.frame


class TactileEnvironment(gymnasium.Env[Observation, np.ndarray]):  # type: ignore[misc]
    """An environment whose scene has a body `sensor`.

    Observation, in the sensor frame: `image`, the grey image of the camera, and `heights`, those of the skin in mm, both 60 × 80;
    `wrench`, N and N·m; those of them that `observations` names, and what else the task observes. Heights and wrench are those of
    the gel or, where `force` names an estimator as in `ninedtact.open` ("physics"), what the sensor of `sensor_folder` computes
    from the rendered image. An episode ends where the task says so, after 0.5 s without contact, and with a reward of −10 where the
    gel is pressed through. It is cut after 4 s.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": round(1 / STEP_S)}
    scene: ClassVar[str]
    """The MuJoCo scene (MJCF)."""
    gel_geom: ClassVar[str | int | None] = None
    """Name or number of the geom of body `sensor` that is the gel, needed where several collide."""
    approach: ClassVar[tuple[float, ...]]
    """The action that brings the sensor into contact at the start; every action is as many numbers from −1 to 1."""
    more_spaces: ClassVar[dict[str, Any]] = {}
    """The spaces of the task's own observations."""

    def __init__(
        self,
        sensor_folder: "SensorFolder | Twin | Path | str | None" = None,
        render_mode: str | None = None,
        force: str = OF_THE_GEL,
        observations: Sequence[str] = OBSERVATIONS,
        pitch_mm: float = 0.3,
    ) -> None:
        """Build the scene. pitch_mm: of the grid on which contacts are solved. Raises `InputError`."""
        if not set(observations) <= set(OBSERVATIONS):
            raise InputError(
                expected=f"observations out of {OBSERVATIONS}", got=f"{tuple(observations)}", remedy="correct them"
            )
        self.model = mujoco.MjModel.from_xml_string(self.scene)
        self.data = mujoco.MjData(self.model)
        self.render_mode, self._steps, self._lost = render_mode, 0, 0
        self._reading: TactileReading | None = None
        self._estimates: Estimates | None = None
        if force != OF_THE_GEL and (sensor_folder is None or isinstance(sensor_folder, Twin) or force == "none"):
            raise needs_calibrated_sensor(force, sensor_folder)
        self._folder, self._force = sensor_folder or default_twin(), force
        self.use_sensor(TactileSensor(self.model, self.data, "sensor", self._folder, pitch_mm, self.gel_geom))
        self._distance_before_mm = 0.0
        spaces = {
            "image": gymnasium.spaces.Box(0, 255, IMAGE_SHAPE, np.uint8),
            "heights": gymnasium.spaces.Box(-np.inf, np.inf, IMAGE_SHAPE, np.float32),
            "wrench": gymnasium.spaces.Box(-np.inf, np.inf, (6,), np.float32),
        }
        chosen = {name: spaces[name] for name in observations}
        self.observation_space = gymnasium.spaces.Dict(chosen | self.more_spaces)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.approach),), np.float32)

    def use_sensor(self, sensor: TactileSensor) -> None:
        """Use another sensor in the same scene, for example one of a batch."""
        self.sensor = sensor
        self._calibrated: Sensor | None = None
        if self._force != OF_THE_GEL:
            assert not isinstance(self._folder, Twin)
            self._calibrated = open_sensor.open(self._folder, _NewestFrame(sensor), self._force)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Arrange the scene anew, and advance it until the sensor touches; raises `SimulationError` where it does not in time."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.arrange_scene()
        (self._calibrated or self.sensor).open()
        self._steps = self._lost = 0
        reading = self._approach()
        self._distance_before_mm = self.distance_mm
        return self._observation(reading), self.state(reading)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act for 20 ms; raises `InputError` for an action that is not as many finite numbers as the task has."""
        self.begin_step(action)
        try:
            reading = self.sensor.step()
        except PRESS_REFUSED as refused:
            return self.refuse(refused)
        return self.end_step(reading)

    def begin_step(self, action: Any) -> None:
        """Act for 20 ms in the scene alone; the sensor is pressed next. Raises `InputError` as `step` does."""
        action = np.asarray(action, float)
        if (
            action.shape != (len(self.approach),) or not np.isfinite(action).all()
        ):  # MuJoCo would reset the scene in silence
            raise InputError(
                expected=f"an action of {len(self.approach)} finite numbers",
                got=f"{action.tolist()}",
                remedy="correct it",
            )
        self._steps += 1
        self._move(np.clip(action, -1.0, 1.0))

    def refuse(self, refused: NinedtactError) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Return the end of an episode that pressed through the gel or off its edge, with the last observation."""
        assert self._reading is not None
        return self._observation(self._reading), REFUSED_REWARD, True, False, {"refused": str(refused)}

    def end_step(
        self, reading: TactileReading, estimates: Estimates | None = None
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Return what `step` returns, given the reading after `begin_step` and the estimates from its image."""
        self._keep(reading, estimates)
        state = self.state(reading)
        self._lost = self._lost + 1 if state["load_n"] < TOUCH_N / 10 else 0
        reward, reached = self.judge(state)
        ended = reached or self._lost >= _LOST_STEPS
        return self._observation(reading), reward, ended, self._steps >= _MAX_STEPS, state

    def render(self) -> Any:
        """Return the raw image of the camera, RGB."""
        assert self._reading is not None
        return cv2.cvtColor(self._reading.frame.image, cv2.COLOR_BGR2RGB)

    @abstractmethod
    def arrange_scene(self) -> None:
        """Place what is placed at random, with `self.np_random`."""

    @abstractmethod
    def act(self, action: Any) -> None:
        """Change the controls of the scene by the clipped actions of one step."""

    @abstractmethod
    def state(self, reading: TactileReading) -> dict[str, Any]:
        """Return what an agent does not see, with `load_n`, the load of the scene."""

    @abstractmethod
    def judge(self, state: dict[str, Any]) -> tuple[float, bool]:
        """Return the reward of a step, and whether the task is done."""

    @property
    @abstractmethod
    def distance_mm(self) -> float:
        """The distance from the place where the task is done."""

    def progress_mm(self) -> float:
        """Return by how much the distance has shrunk since the last call, or since the start of the episode."""
        before_mm, self._distance_before_mm = self._distance_before_mm, self.distance_mm
        return float(before_mm - self._distance_before_mm)

    def progress_reward(self, arrived: bool) -> tuple[float, bool]:
        """Return the progress, less 0.05, with 10 more on arrival; and `arrived`."""
        return self.progress_mm() - _STEP_COST + _ARRIVAL_REWARD * arrived, bool(arrived)

    def more_observations(self) -> Observation:
        """Return the task's own observations."""
        return {}

    def _approach(self) -> TactileReading:
        """Let the scene settle and the sensor approach, and return the first reading that touches."""
        action = np.zeros(len(self.approach))
        for _ in range(_MAX_STEPS):
            reading = self._advance(action)
            if -reading.scene_wrench.force_n[2] >= TOUCH_N:
                return reading
            action = np.array(self.approach)
        raise SimulationError(
            expected=f"the sensor to touch with {TOUCH_N:g} N within {_MAX_STEPS} steps",
            got=f"{abs(reading.scene_wrench.force_n[2]):.3g} N",
            remedy="correct the task's `approach`, or where `arrange_scene` places things",
        )

    def _advance(self, action: Any) -> TactileReading:
        """Act for one step and return the reading after it."""
        self._move(action)
        reading = self.sensor.step()
        self._keep(reading)
        return reading

    def _move(self, action: Any) -> None:
        self.act(action)
        mujoco.mj_step(self.model, self.data, _SUBSTEPS)

    def observe(self, estimates: Estimates) -> Observation:
        """Return the newest observation, with these estimates from its image."""
        assert self._reading is not None
        self._keep(self._reading, estimates)
        return self._observation(self._reading)

    def _keep(self, reading: TactileReading, estimates: Estimates | None = None) -> None:
        """Keep the newest reading and the estimates from its image, which a calibrated sensor of this environment computes."""
        self._reading, self._estimates = reading, estimates
        if self._calibrated is not None:
            found = self._calibrated.read()
            if found.wrench is not None:
                self._estimates = found.height.z_mm, found.wrench.about_skin_centre().six

    def _observation(self, reading: TactileReading) -> Observation:
        each = {"image": self._image, "heights": self._heights, "wrench": self._wrench}
        chosen = {name: observe(reading) for name, observe in each.items() if name in self.observation_space.spaces}
        return chosen | self.more_observations()

    def _image(self, reading: TactileReading) -> Any:
        grey = cv2.cvtColor(reading.frame.image, cv2.COLOR_BGR2GRAY)
        return cv2.resize(grey, IMAGE_SHAPE[::-1], interpolation=cv2.INTER_AREA)

    def _heights(self, reading: TactileReading) -> Any:
        z_mm = reading.heights.z_mm if self._estimates is None else self._estimates[0]
        return cv2.resize(np.nan_to_num(z_mm), IMAGE_SHAPE[::-1], interpolation=cv2.INTER_AREA)

    def _wrench(self, reading: TactileReading) -> Any:
        six = reading.wrench.six if self._estimates is None else self._estimates[1]
        return six.astype(np.float32)

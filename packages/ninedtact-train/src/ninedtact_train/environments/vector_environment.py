"""Many environments with touch as one, by Gymnasium's `VectorEnv`: their contacts are solved in batches, on any device of torch.

MuJoCo steps the scenes one after the other. Observations and actions have a leading axis of environments. The arrays of
observations are NumPy's, which torch and JAX read without a copy (`torch.from_dlpack`); actions may be arrays of any library and
device.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from array_api_compat import is_array_api_obj
from jaxtyping import Bool
from numpy import ndarray as Array

from ninedtact.errors import InputError, NinedtactError
from ninedtact.force.estimator_loading import PHYSICS
from ninedtact.interop.mujoco import TactileReading
from ninedtact.mechanics.numpy_or_torch_arrays import array_namespace_of, to_numpy
from ninedtact.quantities import Frame
from ninedtact.simulation.twin import Twin
from ninedtact_train.environments.mujoco_batch import TactileSensorBatch
from ninedtact_train.environments.tactile_environment import (
    OF_THE_GEL,
    PRESS_REFUSED,
    Estimates,
    Observation,
    TactileEnvironment,
    gymnasium,
    needs_calibrated_sensor,
)

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact_train.batched.force_by_physics import BatchedPhysics

Steps = tuple[Observation, Array, Bool[Array, " envs"], Bool[Array, " envs"], dict[str, Any]]


class TactileVectorEnvironment(gymnasium.vector.VectorEnv):  # type: ignore[misc]
    """Environments of one task, which step together.

    An environment that has ended is reset by the next step, whose action it ignores (Gymnasium's `AutoresetMode.NEXT_STEP`); with
    `autoreset=False` only by `reset(options={"reset_mask": mask})`, which leaves the others as they are. An environment whose press
    is refused ends alone, with the reason in `infos["refused"]`.

    >>> envs = gymnasium.make_vec("ninedtact/PegInsertion-v0", num_envs=64)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
    """

    def __init__(
        self,
        task: type[TactileEnvironment],
        num_envs: int = 1,
        sensor_folder: "SensorFolder | Twin | Path | str | None" = None,
        force: str = OF_THE_GEL,
        like: Any = None,
        autoreset: bool = True,
        **options: Any,
    ) -> None:
        """Build the environments. sensor_folder, force, options: as of `TactileEnvironment`. Raises `InputError`.

        like: an array whose library and device solve the contacts (`torch.zeros((), device="cuda")`), None for NumPy. With an array
        of torch, force by physics is estimated from all images in one batch.
        """
        if num_envs < 1:
            raise InputError(expected="at least one environment", got=f"{num_envs}", remedy="give a larger num_envs")
        self.num_envs, self._autoreset = num_envs, autoreset
        mode = gymnasium.vector.AutoresetMode
        self.metadata: dict[str, Any] = {
            **task.metadata,
            "autoreset_mode": mode.NEXT_STEP if autoreset else mode.DISABLED,
        }
        self._physics = None
        if force == PHYSICS and like is not None and not isinstance(like, np.ndarray):
            self._physics, force = _batched_physics(sensor_folder, like), OF_THE_GEL
        self.environments = [task(sensor_folder, force=force, **options) for _ in range(num_envs)]
        first, batch = self.environments[0], gymnasium.vector.utils.batch_space
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        self.observation_space, self.action_space = (
            batch(space, num_envs) for space in (first.observation_space, first.action_space)
        )
        scenes = [(one.model, one.data) for one in self.environments]
        arrays = np.zeros((), np.float32) if like is None else like
        twin = first.sensor.twin
        self.batch = TactileSensorBatch(scenes, "sensor", twin, arrays, twin.pitch_mm, task.gel_geom)
        for environment, sensor in zip(self.environments, self.batch.sensors, strict=True):
            environment.use_sensor(sensor)
        self._ended = np.ones(num_envs, bool)
        self._observations: list[Observation] = [{}] * num_envs

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Reset all environments, or those of a mask in `options["reset_mask"]`, and return the observations of all.

        seed: of the first environment, the next ones follow it; or one for each. Raises `InputError`.
        """
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise InputError(
                expected=f"a reset_mask of {self.num_envs} truth values",
                got=f"{mask.dtype} of shape {mask.shape}",
                remedy="give one for each environment",
            )
        seeds = [seed + number for number in range(self.num_envs)] if isinstance(seed, int) else seed
        infos: dict[str, Any] = {}
        for number in np.flatnonzero(mask).tolist():
            infos = self._reset_one(number, None if seeds is None else seeds[number], infos)
        if not all(self._observations):
            raise InputError(
                expected="all environments reset at first",
                got=f"{int(mask.sum())} of them",
                remedy="reset without a mask",
            )
        return self._stacked(), infos

    def step(self, actions: Any) -> Steps:
        """Act in all environments for 20 ms; raises `InputError` for actions of another shape or not finite."""
        acting, infos = self._checked(actions), dict[str, Any]()
        rewards, terminated, truncated = np.zeros(self.num_envs), *np.zeros((2, self.num_envs), bool)
        ended = np.flatnonzero(self._ended).tolist()
        if ended and not self._autoreset:
            raise InputError(
                expected="a step of environments that have not ended",
                got=f"environments {ended} that have",
                remedy="reset them with options={'reset_mask': mask}",
            )
        for number in ended:
            infos = self._reset_one(number, None, infos)
        running = [number for number in range(self.num_envs) if number not in ended]
        for number in running:
            self.environments[number].begin_step(acting[number])
        responses = self.batch.step_each(running)
        readings = {number: one for number, one in responses.items() if isinstance(one, TactileReading)}
        estimates = self._estimates(readings)
        for number, response in responses.items():
            found = self._end_step(self.environments[number], response, estimates.get(number))
            self._observations[number], rewards[number], terminated[number], truncated[number], info = found
            infos = self._add_info(infos, info, number)
        self._ended = terminated | truncated
        return self._stacked(), rewards, terminated, truncated, infos

    def _estimates(self, readings: dict[int, TactileReading]) -> dict[int, Estimates]:
        """Return the estimates from the images of these readings, in one batch; none where each sensor estimates its own."""
        if self._physics is None or not readings:
            return {}
        grey = np.stack([cv2.cvtColor(one.frame.image, cv2.COLOR_BGR2GRAY) for one in readings.values()])
        like = self.batch.like
        found = self._physics(array_namespace_of(like).asarray(grey, device=like.device))
        heights_mm, wrenches = to_numpy(found.heights_mm).astype(np.float32), to_numpy(found.wrenches)
        return dict(zip(readings, zip(heights_mm, wrenches, strict=True), strict=True))

    def _end_step(
        self, environment: TactileEnvironment, response: TactileReading | NinedtactError, estimates: Estimates | None
    ) -> Any:
        if isinstance(response, PRESS_REFUSED):
            return environment.refuse(response)
        if isinstance(response, NinedtactError):
            raise response
        return environment.end_step(response, estimates)

    def _reset_one(self, number: int, seed: int | None, infos: dict[str, Any]) -> dict[str, Any]:
        environment = self.environments[number]
        self._observations[number], info = environment.reset(seed=seed)
        assert environment.sensor.last is not None
        estimates = self._estimates({number: environment.sensor.last})
        if estimates:
            self._observations[number] = environment.observe(estimates[number])
        self._ended[number] = False
        return self._add_info(infos, info, number)

    def _stacked(self) -> Observation:
        return {name: np.stack([one[name] for one in self._observations]) for name in self._observations[0]}

    def _checked(self, actions: Any) -> Array:
        """Return the actions as an array of numbers on the processor; raises `InputError`."""
        found = to_numpy(actions) if is_array_api_obj(actions) else np.asarray(actions, float)
        wanted = (self.num_envs, *self.single_action_space.shape)
        if found.shape != wanted or not np.isfinite(found).all():
            said = f"shape {found.shape}" if found.shape != wanted else "some that are not finite"
            raise InputError(expected=f"finite actions of shape {wanted}", got=said, remedy="correct them")
        return found


def _batched_physics(sensor_folder: "SensorFolder | Twin | Path | str | None", like: Any) -> "BatchedPhysics":
    """Return the batched estimator of a calibrated sensor on the device of an array of torch; raises `InputError`."""
    from ninedtact.calibration.sensor_folder import load_sensor
    from ninedtact_train.batched.depth_reading import BatchedDepthReader
    from ninedtact_train.batched.force_by_physics import BatchedPhysics

    if sensor_folder is None or isinstance(sensor_folder, Twin):
        raise needs_calibrated_sensor(PHYSICS, sensor_folder)
    folder = load_sensor(sensor_folder) if isinstance(sensor_folder, Path | str) else sensor_folder
    reader = folder.shape.depth_reader(Frame(folder.twin().renderer.reference.round().astype(np.uint8)))
    return BatchedPhysics(BatchedDepthReader(folder.shape.rectify, reader, str(like.device)), folder.estimator(PHYSICS))


def register_task(name: str, task: type[TactileEnvironment]) -> None:
    """Register a task under a name, for `gymnasium.make` and `gymnasium.make_vec`."""
    gymnasium.register(name, entry_point=task, vector_entry_point=partial(TactileVectorEnvironment, task))

"""Many environments as one: each is that environment alone, one that is refused ends alone, and bad input ends in a sentence."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.errors import InputError, SimulationError
from ninedtact.simulation.twin import default_twin

gymnasium = pytest.importorskip("gymnasium", reason="the extra 'environments' is not installed")
pytest.importorskip("mujoco", reason="the extra 'environments' is not installed")

from ninedtact_train.environments.edge_following_environment import EdgeFollowingEnvironment  # noqa: E402
from ninedtact_train.environments.vector_environment import TactileVectorEnvironment  # noqa: E402

TWIN = replace(default_twin(), pitch_mm=0.5)
pytestmark = [
    pytest.mark.interop,
    pytest.mark.filterwarnings("ignore:.*Box observation space:UserWarning"),
    # Arithmetic of torch's tensors with NumPy's arrays, which would fail on a GPU.
    pytest.mark.filterwarnings("error:__array_wrap__:DeprecationWarning"),
]


def edge(many: int, **options: Any) -> TactileVectorEnvironment:
    envs: TactileVectorEnvironment = gymnasium.make_vec(
        "ninedtact/EdgeFollowing-v0", many, sensor_folder=TWIN, **options
    ).unwrapped
    return envs


@pytest.mark.parametrize("like", [np.zeros((), np.float32), torch.zeros(())], ids=["numpy", "torch"])
def test_each_environment_is_that_environment_alone(like: Any) -> None:
    envs = edge(2, like=like)
    alone = [EdgeFollowingEnvironment(TWIN) for _ in range(2)]
    seen, _ = envs.reset(seed=3)
    assert envs.observation_space.contains(seen)
    first = [one.reset(seed=3 + number)[0] for number, one in enumerate(alone)]
    np.testing.assert_allclose(seen["wrench"], [one["wrench"] for one in first], atol=1e-6)
    for step in range(3):
        actions = np.array([[0.5, 0.1 * step, 0.0], [0.3, -0.1, 0.1]], np.float32)
        seen, rewards, ended, cut, infos = envs.step(torch.from_numpy(actions))
        steps = [one.step(action) for one, action in zip(alone, actions, strict=True)]
        np.testing.assert_allclose(seen["wrench"], [one[0]["wrench"] for one in steps], atol=2e-2)
        np.testing.assert_allclose(rewards, [one[1] for one in steps], atol=1e-2)
        np.testing.assert_allclose(infos["offset_mm"], [one[4]["offset_mm"] for one in steps], atol=1e-9)
        assert abs(seen["image"].astype(int) - np.stack([one[0]["image"] for one in steps])).mean() < 0.5
    assert not (ended | cut).any()
    assert torch.from_dlpack(seen["image"]).data_ptr() == seen["image"].ctypes.data


def test_the_sensor_estimates_all_images_at_once(physical_sensor: SensorFolder) -> None:
    options: dict[str, Any] = {"sensor_folder": physical_sensor.path, "force": "physics", "pitch_mm": 0.5}
    envs = gymnasium.make_vec("ninedtact/EdgeFollowing-v0", 2, like=torch.zeros(()), **options).unwrapped
    alone = [EdgeFollowingEnvironment(**options) for _ in range(2)]
    seen, _ = envs.reset(seed=3)
    each = [one.reset(seed=3 + number)[0] for number, one in enumerate(alone)]
    for _ in range(2):
        np.testing.assert_allclose(seen["wrench"], [one["wrench"] for one in each], atol=0.02)
        np.testing.assert_allclose(seen["heights"], [one["heights"] for one in each], atol=0.01)
        true_n = [one.batch.sensors[number].last.wrench.force_n[2] for number, one in ((0, envs), (1, envs))]
        assert (np.abs(seen["wrench"][:, 2] - true_n) > 1e-4).all()
        seen, *_ = envs.step(np.full((2, 3), 0.3))
        each = [one.step(np.full(3, 0.3))[0] for one in alone]
    with pytest.raises(
        InputError, match="the name of an estimator and the folder of a calibrated sensor, got force='phys"
    ):
        edge(2, force="physics", like=torch.zeros(()))


def test_what_is_not_observed_is_not_computed() -> None:
    envs = edge(2, observations=("wrench",))
    seen, _ = envs.reset(seed=0)
    assert set(seen) == {"wrench"} and envs.observation_space.contains(seen)
    assert all("frame" not in vars(one.last) for one in envs.batch.sensors)
    with pytest.raises(InputError, match=r"observations out of .*, got \('force',\)"):
        edge(2, observations=("force",))


def test_a_sensor_that_never_touches_ends_the_reset() -> None:
    class Retreating(EdgeFollowingEnvironment):
        approach = (0.0, 0.0, -1.0)

    with pytest.raises(
        SimulationError, match=r"expected the sensor to touch .* got 0 N; correct the task's `approach`"
    ):
        Retreating(TWIN).reset(seed=0)


def test_an_environment_that_is_refused_ends_alone_and_begins_again_by_the_next_step() -> None:
    envs = edge(3)
    envs.reset(seed=0)
    before = [one.data.time for one in envs.environments]
    hover, ended = np.zeros((3, 3), np.float32), np.zeros(3, bool)
    envs.environments[1].model.geom_size[0, :2] = 0.0002, 0.002  # a wire, pressed with 8 N in place of the rail
    envs.environments[1].data.ctrl[2] += 0.007
    while not ended.any():
        _, rewards, ended, _, infos = envs.step(hover)
    assert ended.tolist() == [False, True, False]
    assert rewards[1] == -10 and infos["_refused"].tolist() == [False, True, False]
    assert "scene 1" in infos["refused"][1]
    _, rewards, ended, _, infos = envs.step(hover)
    assert not ended.any() and rewards[1] == 0 and "refused" not in infos
    times = [one.data.time for one in envs.environments]
    assert before[0] < times[0] == times[2] != times[1]


def test_environments_that_are_not_reset_by_themselves_are_reset_by_a_mask() -> None:
    envs = edge(2, autoreset=False)
    with pytest.raises(
        InputError, match="expected all environments reset at first, got 1 of them; reset without a mask"
    ):
        envs.reset(options={"reset_mask": np.array([True, False])})
    envs.reset(seed=1)
    envs.step(np.zeros((2, 3)))
    times = [one.data.time for one in envs.environments]
    envs.reset(options={"reset_mask": np.array([False, True])})
    assert envs.environments[0].data.time == times[0] > envs.environments[1].data.time
    with pytest.raises(InputError, match=r"expected a reset_mask of 2 truth values, got int64 of shape \(2,\); give"):
        envs.reset(options={"reset_mask": np.array([0, 1])})
    envs._ended[1] = True
    with pytest.raises(InputError, match=r"got environments \[1\] that have; reset them with options"):
        envs.step(np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("actions", "got"),
    [([[0, 0, np.nan], [0, 0, 0]], "some that are not finite"), (np.zeros((3, 3)), r"shape \(3, 3\)")],
)
def test_bad_actions_move_nothing(actions: Any, got: str) -> None:
    envs = edge(2)
    envs.reset(seed=1)
    times = [one.data.time for one in envs.environments]
    with pytest.raises(InputError, match=rf"expected finite actions of shape \(2, 3\), got {got}; correct them"):
        envs.step(actions)
    assert times == [one.data.time for one in envs.environments]

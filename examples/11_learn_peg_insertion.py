"""A policy learns by PPO to insert a peg into a hole whose place it does not know: with touch, and without.

Without touch it observes only how far the hand has moved. pip install 'ninedtact-train[training,reinforcement]'
"""

import argparse
from time import perf_counter, process_time
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import ninedtact_train.environments.peg_insertion_environment  # noqa: F401 - registers the task

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=50_000, help="environment steps of each policy")
parser.add_argument("--envs", type=int, default=32)
parser.add_argument("--episodes", type=int, default=100, help="episodes after training")
parser.add_argument("--pitch-mm", type=float, default=0.5, help="pitch of the grid of contacts; finer is slower")
parser.add_argument("--device", default="cpu", help="of torch; on 'cuda' contacts are solved there too")
options = parser.parse_args()
ROLLOUT = 64
"""Steps of each environment between two updates of the policy."""
REPORT_EVERY = 200
"""Episodes between two lines of progress, which give the share of these that succeeded."""
ARRIVAL_REWARD = 5.0
"""Reward of a step above which the peg has arrived: the environment gives 10 for it, and nothing else comes near."""


class _Pegs(VecEnv):
    """The environments in the interface of stable-baselines3: flat observations, and ended episodes reset within the step."""

    def __init__(self, observations: tuple[str, ...]) -> None:
        like = None if options.device == "cpu" else torch.zeros((), device=options.device)
        self.envs = gymnasium.make_vec(
            "ninedtact/PegInsertion-v0",
            options.envs,
            observations=observations,
            pitch_mm=options.pitch_mm,
            like=like,
            autoreset=False,
        )
        self.inserted: list[bool] = []
        count = gymnasium.spaces.flatdim(self.envs.single_observation_space)
        box = gymnasium.spaces.Box(-np.inf, np.inf, (count,), np.float32)
        super().__init__(options.envs, box, self.envs.single_action_space)

    def reset(self) -> np.ndarray:
        observations, _ = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        return self._flat(observations)

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = actions

    def step_wait(self) -> Any:
        found, rewards, terminated, truncated, _ = self.envs.step(self.actions)
        observations, ended = self._flat(found), terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": bool(cut)} for cut in truncated & ~terminated]
        if ended.any():
            self.inserted += (rewards[ended] > ARRIVAL_REWARD).tolist()
            for number in np.flatnonzero(ended):
                infos[number]["terminal_observation"] = observations[number]
            observations = self._flat(self.envs.reset(options={"reset_mask": ended})[0])
        return observations, rewards.astype(np.float32), ended, infos

    def _flat(self, observations: dict[str, np.ndarray]) -> np.ndarray:
        return np.concatenate([observations[name] for name in sorted(observations)], axis=1)

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **named: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


class _Progress(BaseCallback):
    """Prints the share of pegs that were inserted lately."""

    def __init__(self, pegs: _Pegs) -> None:
        super().__init__()
        self.pegs, self.began, self.reported = pegs, process_time(), 0

    def _on_step(self) -> bool:
        if len(self.pegs.inserted) >= self.reported + REPORT_EVERY:
            self.reported = len(self.pegs.inserted)
            per_s = self.num_timesteps / (process_time() - self.began)
            share = np.mean(self.pegs.inserted[-REPORT_EVERY:])
            print(f"  {self.num_timesteps} steps, {per_s:.0f} per s of processor: {share:.0%} inserted", flush=True)
        return True


def learn(name: str, observations: tuple[str, ...]) -> None:
    """Train a policy, and print the share of pegs that it inserts afterwards."""
    pegs = _Pegs(observations)
    envs = VecNormalize(pegs, gamma=0.97)
    policy = PPO(
        "MlpPolicy",
        envs,
        learning_rate=1e-3,
        n_steps=ROLLOUT,
        batch_size=min(512, ROLLOUT * options.envs),
        gamma=0.97,
        gae_lambda=0.9,
        policy_kwargs={"log_std_init": -0.7},
        device=options.device,
        seed=0,
    )
    began = perf_counter()
    policy.learn(options.steps, callback=_Progress(pegs))
    per_s = policy.num_timesteps / (perf_counter() - began)
    envs.training = False
    share = evaluate(policy, envs, pegs)
    print(
        f"{name}: {policy.num_timesteps} environment steps, {per_s:.0f} per s; then {share:.0%} of pegs inserted",
        flush=True,
    )


def evaluate(policy: PPO, envs: VecNormalize, pegs: _Pegs) -> float:
    """Return the share of pegs that a policy inserts without exploration."""
    pegs.inserted = []
    observations = envs.reset()
    while len(pegs.inserted) < options.episodes:
        observations, *_ = envs.step(policy.predict(observations, deterministic=True)[0])
    return float(np.mean(pegs.inserted))


torch.set_num_threads(1)
learn("with touch", ("wrench",))
learn("without touch", ())

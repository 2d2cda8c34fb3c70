"""How often a controller of three lines inserts the peg of `ninedtact/PegInsertion-v0`: by the wrench of the gel, by the wrench
that is estimated from the rendered image, and by pushing straight down. Each episode has another place of the hole.
"""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import numpy as np
import tyro
from figures import Figure, answer

import ninedtact_train.environments.peg_insertion_environment
from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.twin import default_twin

Controller = Callable[[dict[str, Any]], list[float]]


def peg_insertion(
    by_gel: int = 30, by_estimate: int = 8, blind: int = 20, quick: bool = False, json: bool = False
) -> None:
    """Run these numbers of episodes and print how many inserted the peg; a minute."""
    by_gel, by_estimate, blind = (1, 1, 1) if quick else (by_gel, by_estimate, blind)
    twin = default_twin()
    with TemporaryDirectory() as folder:
        images = simulate_calibration_images(twin, frames=4)
        save_sensor(Path(folder), calibrate(CalibrationImages(**vars(images))))
        figures = [
            *run("by the wrench of the gel", by_gel, yield_to_force, sensor_folder=twin),
            *run("by the estimated wrench", by_estimate, yield_to_force, sensor_folder=folder, force="physics"),
            *run("straight down", blind, push_down, sensor_folder=twin),
        ]
    answer("Insertion of a peg", figures, json)


def yield_to_force(observation: dict[str, Any]) -> list[float]:
    """Give way to the force on the gel, and push with the rest."""
    side, along, away = observation["wrench"][:3]
    return [2 * side, away + 3, 0.7 + 2 * along - abs(side) - abs(away + 3)]


def push_down(observation: dict[str, Any]) -> list[float]:
    """Push, whatever is felt."""
    return [0.0, 0.0, 1.0]


def run(name: str, episodes: int, controller: Controller, **options: Any) -> list[Figure]:
    """Return how many of the episodes inserted the peg, the most steps, and the largest forces on the pin."""
    env = gymnasium.make("ninedtact/PegInsertion-v0", **options)
    inserted, steps, most_n = 0, [], []
    for seed in range(episodes):
        observation, state = env.reset(seed=seed)
        ended, count, pin_n = False, 0, 0.0
        while not ended:
            action = np.clip(controller(observation), -1, 1).astype(np.float32)
            observation, _, terminated, truncated, state = env.step(action)
            ended, count, pin_n = terminated or truncated, count + 1, max(pin_n, state.get("pin_n", 0.0))
        inserted += state["tip_mm"][2] <= -ninedtact_train.environments.peg_insertion_environment.DEPTH_MM
        steps.append(count)
        most_n.append(pin_n)
    return [
        Figure(f"{name}: inserted", f"{inserted} of {episodes}"),
        Figure(f"{name}: steps of 20 ms", f"{min(steps)} to {max(steps)}"),
        Figure(f"{name}: largest force on the pin, N", f"{min(most_n):.2f} to {max(most_n):.2f}"),
    ]


if __name__ == "__main__":
    tyro.cli(peg_insertion)

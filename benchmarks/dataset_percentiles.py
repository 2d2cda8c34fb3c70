"""Wrenches of the twins' data set beside 10,000 real ones: 5th, 50th and 95th percentile of every axis, by the paper's rule."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro
from figures import Figure, answer, at_most

from ninedtact_train.dataset.dataset_card import REAL_PERCENTILES
from ninedtact_train.dataset.generation.generate import generate_dataset
from ninedtact_train.dataset.generation.settings import GenerationSettings

ALLOWED = 25.0
"""% of each axis's span from 5 to 95."""


def dataset_percentiles(
    pairs: int = 2000, seed: int = 0, workers: int = os.cpu_count() or 1, quick: bool = False, json: bool = False
) -> None:
    """Measure. Images are small here: the wrenches are as likely with large ones."""
    pairs, workers, sensors = (8, 1, 1) if quick else (pairs, workers, 20)
    with TemporaryDirectory() as folder:
        settings = GenerationSettings(pairs, size=(32, 24), seed=seed, sensors=sensors)
        made = generate_dataset(Path(folder), settings, workers, progress=not json)
    figures, errors = [], made.statistics.differences_from_real_percentiles
    for number, (axis, found) in enumerate(made.statistics.percentiles.items()):
        worst = 100 * max(abs(part) for part in errors[axis])
        figures.append(Figure(f"{axis}, 5 / 50 / 95", three(found), peer=three(REAL_PERCENTILES[number].tolist())))
        figures.append(at_most(f"{axis}, largest difference, % of the real span", worst, ALLOWED))
    answer(f"{pairs} pairs of twins beside real wrenches, N and N·m about 35 mm below the skin", figures, json)


def three(values: list[float]) -> str:
    return " / ".join(f"{value:.3g}" for value in values)


if __name__ == "__main__":
    tyro.cli(dataset_percentiles)

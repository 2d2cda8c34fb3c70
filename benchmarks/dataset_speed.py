"""How fast data sets are made: full images, default settings, and what 10,000 pairs take."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import tyro
from figures import Figure, answer, at_most

from ninedtact_train.dataset.generation.generate import generate_dataset, generate_file
from ninedtact_train.dataset.generation.settings import GenerationSettings

WANTED, ALLOWED_MINUTES = 10_000, 20.0


def dataset_speed(
    pairs: int = 1000, workers: int = os.cpu_count() or 1, quick: bool = False, json: bool = False
) -> None:
    """Measure."""
    pairs, workers, alone, sensors = (4, 1, 2, 1) if quick else (pairs, workers, 100, 20)
    with TemporaryDirectory() as folder:
        began = perf_counter()
        generate_dataset(Path(folder), GenerationSettings(pairs, sensors=sensors), workers, progress=not json)
        minutes = (perf_counter() - began) / 60
        size = sum(path.stat().st_size for path in Path(folder).rglob("*.parquet"))
    one = cpu_ms(alone)
    figures = [
        Figure(f"pairs a minute, {workers} workers", pairs / minutes),
        at_most(f"{WANTED} pairs, min", WANTED * minutes / pairs, ALLOWED_MINUTES),
        Figure("CPU time of one pair in one process, ms", one),
        at_most(f"{WANTED} pairs by that on two free cores, min", WANTED * one / 2 / 6e4, ALLOWED_MINUTES),
        Figure("size of one pair, kB", size / pairs / 1e3),
    ]
    answer(f"Data set of {pairs} pairs, 460 x 345 px, 0.2 mm pitch", figures, json)


def cpu_ms(pairs: int) -> float:
    """Of one file in this process, whoever else uses the machine."""
    with TemporaryDirectory() as folder:
        began = process_time()
        made = generate_file(Path(folder), "one.parquet", GenerationSettings(pairs, sensors=min(2, pairs // 2)), 0)
    return 1e3 * (process_time() - began) / made


if __name__ == "__main__":
    tyro.cli(dataset_speed)

"""How fast data sets are made, full images by default settings, and what 10,000 pairs take; and how fast they are read in training,
at 160 x 120 on one core.
"""

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least, at_most

from ninedtact_train.dataset.generation.generate import generate_dataset, generate_file
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact_train.dataset.reader import load_dataset

WANTED, ALLOWED_MINUTES = 10_000, 20.0
READ_PER_S, BATCH = 2000, 64


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
        reading = read_figures(Path(folder), pairs)
    one = cpu_ms(alone)
    figures = [
        Figure(f"pairs a minute, {workers} workers", pairs / minutes),
        at_most(f"{WANTED} pairs, min", WANTED * minutes / pairs, ALLOWED_MINUTES),
        Figure("CPU time of one pair in one process, ms", one),
        at_most(f"{WANTED} pairs by that on two free cores, min", WANTED * one / 2 / 6e4, ALLOWED_MINUTES),
        Figure("size of one pair, kB", size / pairs / 1e3),
        *reading,
    ]
    answer(f"Data set of {pairs} pairs, 460 x 345 px, 0.2 mm pitch", figures, json)


def read_figures(folder: Path, pairs: int) -> list[Figure]:
    """Return images a second of CPU time: decoded once, then in random batches and one by one."""
    cv2.setNumThreads(1)
    rng, began = np.random.default_rng(0), process_time()
    data = load_dataset(folder)
    decoded, opened = process_time(), perf_counter()
    load_dataset(folder)
    again_s, ready = perf_counter() - opened, process_time()
    read = sum(len(batch.images) for _ in range(10) for batch in data.batches(BATCH, rng))
    batched = process_time()
    for number in rng.permutation(len(data)):
        data.batch(np.array([number]))
    alone = process_time()
    per_s = read / (batched - ready)
    return [
        at_least("images a second with wrench and reference, batches of 64", per_s, READ_PER_S),
        Figure("the same, one by one", len(data) / (alone - batched)),
        Figure("first opening, images decoded a second of CPU time", pairs / (decoded - began)),
        Figure("later opening, s", again_s),
    ]


def cpu_ms(pairs: int) -> float:
    """Of one file in this process, whoever else uses the machine."""
    with TemporaryDirectory() as folder:
        began = process_time()
        made = generate_file(Path(folder), "one.parquet", GenerationSettings(pairs, sensors=min(2, pairs // 2)), 0)
    return 1e3 * (process_time() - began) / made


if __name__ == "__main__":
    tyro.cli(dataset_speed)

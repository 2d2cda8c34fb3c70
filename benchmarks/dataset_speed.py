"""How fast data sets are made, full images by default settings, and what 10,000 pairs take; how many transforms a contact step of
them costs, and how far its wrenches and images are from steps solved to 2e-4 of the depth; and how fast they are read in training,
at 160 x 120 on one core.
"""

import os
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least, at_most

from ninedtact.mechanics import skin
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.simulation.press import Press
from ninedtact_train.batched.session_requests import RenderRequest, StepRequest, respond_on_cpu, send_to_session
from ninedtact_train.dataset.generation.generate import generate_dataset, generate_file, make_simulated_sensor
from ninedtact_train.dataset.generation.press_session import SimulatedPressSession
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact_train.dataset.reader import load_dataset

WANTED, ALLOWED_MINUTES = 10_000, 20.0
PAIR_MS, READ_PER_S, BATCH = 30.0, 2000, 64
WRENCH_SHARE, IMAGE_GREY = 0.01, 0.1
"""Largest differences from exact steps: force by load, and RMS of the image."""
EXACT = SolverSettings(tolerance=2e-4, max_rounds=200, max_iterations=30, must_converge=False)


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
    cpu_ms(2)  # imports, which do not count
    one = cpu_ms(alone)
    figures = [
        Figure(f"pairs a minute, {workers} workers", pairs / minutes),
        at_most(f"{WANTED} pairs, min", WANTED * minutes / pairs, ALLOWED_MINUTES),
        at_most("CPU time of one pair in one process, ms", one, PAIR_MS, "ms"),
        *solver_figures(4 if quick else 60, sensors),
        at_most(f"{WANTED} pairs by that on two free cores, min", WANTED * one / 2 / 6e4, ALLOWED_MINUTES),
        Figure("size of one pair, kB", size / pairs / 1e3),
        *reading,
    ]
    answer(f"Data set of {pairs} pairs, 460 x 345 px, 0.2 mm pitch", figures, json)


def solver_figures(pairs: int, sensors: int) -> list[Figure]:
    """Return the cost of a step of two sessions in transforms, and the largest differences from the same steps solved exactly."""
    settings = GenerationSettings(pairs, sensors=min(sensors, 2), session_pairs=pairs // 2)
    steps, wrong, transforms = 0, {"force": [0.0], "image": [0.0]}, 0
    count, kept = skin.forward_transform, []

    def counted(field: Any, shape: tuple[int, int]) -> Any:
        nonlocal transforms
        transforms += field[..., 0, 0].size
        return count(field, shape)

    for number in range(2):
        setup = make_simulated_sensor(number, settings)
        exact = replace(setup, twin=replace(setup.twin, solver_settings=EXACT))
        requests, response = SimulatedPressSession(number, settings, exact).requests(), None
        found: dict[int, Press] = {}
        for _ in range(10 * pairs):
            try:
                request = send_to_session(requests, response)
            except StopIteration:
                break
            response = respond_on_cpu(request)
            if not (isinstance(request, StepRequest) and isinstance(response, Press)):
                continue
            skin.forward_transform = counted
            last = None if request.last is None else found.get(id(request.last))
            press = respond_on_cpu(replace(request, setup=setup, last=last))
            skin.forward_transform = count
            if not isinstance(press, Press):
                continue
            found[id(response)], steps = press, steps + 1
            kept.append(response)  # so that its id stays its own
            difference_n = np.abs(press.wrench.force_n - response.wrench.force_n).max()
            wrong["force"].append(difference_n / max(response.load_n, 0.2))
            shown, wanted = (
                np.float32(1) if factor is None else factor
                for factor in (RenderRequest(setup, one.corrected).respond() for one in (press, response))
            )
            wrong["image"].append(np.sqrt(np.mean((setup.renderer.reference * (shown - wanted)) ** 2)))
    said = f"95 %: {np.quantile(wrong['force'], 0.95):.2g}; {steps} steps"
    grey = f"95 %: {np.quantile(wrong['image'], 0.95):.2g}"
    return [
        Figure("transforms there and back of a contact step", transforms / steps),
        replace(
            at_most("force of a step from exact ones, share of the load", max(wrong["force"]), WRENCH_SHARE, ""),
            peer=said,
        ),
        replace(
            at_most("image of a step from exact ones, grey levels RMS", max(wrong["image"]), IMAGE_GREY, ""), peer=grey
        ),
    ]


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

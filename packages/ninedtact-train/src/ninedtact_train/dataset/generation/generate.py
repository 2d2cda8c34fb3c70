"""Generates a data set with simulated sensors, file by file, in several processes or on a GPU, and continues a stopped run.

A file consists of sessions (`press_session.py`), each of some fifty pairs with one simulated sensor.

Every file depends on the settings and its own number alone, and is written completely or not at all. A run that was killed
therefore continues with the missing files and ends with the same bytes. Files are made in processes of this machine or on a
cluster (`parallel_jobs`). Each GPU is used by one process, or one worker of a cluster, which advances many sessions together.

On a GPU, which sessions form one batch depends on the settings and on the batch size, never on the files that exist already:
arithmetic on a device rounds by the shape of its batch, and a continued run must end with the same bytes. A batch with missing
files is therefore computed again as a whole, and only those files are written.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any
from warnings import warn

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.capture.strict_image_reading import encode_png
from ninedtact.checked_reading import CHECKSUM_KEY, mapping_checksum
from ninedtact.errors import InputError
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.parallel_jobs import DaskCluster, Workers, require_workers, run_writing_jobs
from ninedtact.simulation.objects.catalogue import mesh_file_of_name
from ninedtact_train.batched.executor import BatchExecutor, run_sessions
from ninedtact_train.batched.session_requests import (
    Device,
    SimulatedSetup,
    choose_compute_device,
    run_session_on_cpu,
)
from ninedtact_train.dataset.dataset_card import (
    DatasetStatistics,
    compute_dataset_statistics,
    format_generation_card,
)
from ninedtact_train.dataset.folder import (
    CARD_FILE,
    REFERENCES_FILE,
    SENSORS_FILE,
    SETTINGS_FILE,
    begin_or_resume_dataset,
    pair_file,
    to_json_bytes,
)
from ninedtact_train.dataset.generation.press_session import SimulatedPressSession, load_object
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact_train.dataset.parquet_files import write_pair_file, write_reference_images_file
from ninedtact_train.dataset.schema import ReferenceImage
from ninedtact_train.population.sensor_population import rectified_renderer

_SOLVER_SETTINGS = SolverSettings(tolerance=1e-2, max_rounds=60, max_iterations=6, must_converge=False)
"""Rounds of few iterations: a fifth fewer transforms than those of a live press, for steps as large as those of a session, and a
GPU can record them. Wrenches stay within a hundredth of the load, and images within a tenth of a grey level
(`benchmarks/dataset_speed.py`)."""


def make_simulated_sensor(number: int, settings: GenerationSettings) -> SimulatedSetup:
    """Return the simulated sensor of this number, ready for contact steps and renders."""
    parameters = settings.sensor_parameters(number)
    twin = replace(parameters.twin(settings.pitch_mm), solver_settings=_SOLVER_SETTINGS)
    return SimulatedSetup(parameters, twin, rectified_renderer(parameters, settings.size))


@lru_cache(maxsize=2)
def cached_setup(number: int, settings: GenerationSettings) -> SimulatedSetup:
    """Return the simulated sensor of this number, made once while it is in use."""
    return make_simulated_sensor(number, settings)


SESSIONS_PER_BATCH = 256
"""Sessions that a GPU advances together. More are not faster, and hold some 3 MB of images each in memory."""


@dataclass(frozen=True)
class GenerationResult:
    """A data set that was generated."""

    folder: Path
    statistics: DatasetStatistics
    new_files: int
    """Number of files that this run made; the others existed already."""
    device: str
    """The kind of device on which all files were made."""


def generate_dataset(
    out: Path,
    settings: GenerationSettings,
    workers: Workers = 1,
    *,
    progress: bool = False,
    device: str = "cpu",
    sessions_per_batch: int = SESSIONS_PER_BATCH,
    notify: Callable[[str], None] = warn,
) -> GenerationResult:
    """Generate a data set with simulated sensors, or continue a run that was stopped.

    Args:
        out: folder of the data set: new, empty, or begun with the same settings.
        settings: everything that decides about the pairs.
        workers: number of processes, or with a GPU number of threads that make noise and PNG files; or a cluster of
            processors, or of workers with a GPU each.
        progress: whether to show a progress bar.
        device: a name that `choose_compute_device` knows.
        sessions_per_batch: number of sessions that a GPU advances together.
        notify: is called with a sentence when the memory of a GPU is too small for a batch.

    Raises `InputError`, `OutputError`, `FileNotWritten`, `DeviceError`.
    """
    from tqdm import tqdm

    require_workers(workers)
    if sessions_per_batch < 1:
        raise InputError(
            expected="at least 1 session per batch", got=f"{sessions_per_batch}", remedy="give a larger number"
        )
    on = _select_device(device, workers)
    begin_generation(out, settings, {"device": on.kind, **settings.to_json_dict()})
    files = [pair_file(out, number, settings.files) for number in range(settings.files)]
    missing = [number for number, file in enumerate(files) if not file.is_file()]
    if on.is_batched and isinstance(workers, int):
        pair_counts = _make_files_in_batches(files, missing, settings, on, sessions_per_batch, workers, notify)
    elif on.is_batched:
        batches = _batches_of_files(settings, sessions_per_batch)
        unwritten = [sorted(set(missing).intersection(batch)) for batch in batches]
        gpu_jobs = [(settings, numbers, on.name, sessions_per_batch) for numbers in unwritten if numbers]
        pair_counts = (pairs for _, pairs in run_writing_jobs(generate_batch, out / "data", gpu_jobs, workers))
    else:
        jobs = [(files[number].name, settings, number) for number in missing]
        pair_counts = (pairs for _, pairs in run_writing_jobs(generate_file, out / "data", jobs, workers))
    there = min((settings.files - len(missing)) * settings.pairs_per_file, settings.pairs)
    with tqdm(total=settings.pairs, initial=there, unit="pair", disable=not progress) as bar:
        for pairs in pair_counts:
            bar.update(pairs)
    statistics = compute_dataset_statistics(files)
    card = format_generation_card(settings, statistics, version("ninedtact"), on.kind)
    write_file_atomically(out / CARD_FILE, card.encode())
    return GenerationResult(out, statistics, len(missing), on.kind)


def _select_device(name: str, workers: Workers) -> Device:
    """Return the device of this name, the processor for `auto` on a cluster; raises `InputError`, `DeviceError`.

    On a cluster the workers, not this process, check that their GPU exists.
    """
    if not isinstance(workers, DaskCluster):
        return choose_compute_device(name)
    if name not in ("auto", "cpu", "cuda", "torch-cpu"):
        raise InputError(
            expected="--device cpu or cuda together with --cluster",
            got=f"{name}",
            remedy="let each worker see one GPU, by CUDA_VISIBLE_DEVICES",
        )
    return Device("cpu" if name == "auto" else name)


def begin_generation(out: Path, settings: GenerationSettings, stored: Mapping[str, Any]) -> None:
    """Write what all files share, or check that the folder was begun with the same settings.

    stored: the settings as they are stored, with the kind of device. Raises `InputError`, `OutputError`, `FileNotWritten`.
    """
    if not (out / SETTINGS_FILE).is_file():
        for name in settings.object_names:
            load_object(name, settings.objects_seed)  # unknown names are refused before anything is written
    digests = _mesh_digests(settings)
    meshes = {"mesh_digests": digests} if digests else {}
    begin_or_resume_dataset(out, {**stored, **meshes})
    if not (out / SENSORS_FILE).is_file():
        sensors = [settings.sensor_parameters(number).to_json_dict() for number in range(settings.sensors)]
        with_checksums = [{**sensor, CHECKSUM_KEY: mapping_checksum(sensor)} for sensor in sensors]
        write_file_atomically(out / SENSORS_FILE, to_json_bytes(with_checksums))
    if not (out / REFERENCES_FILE).is_file():
        write_reference_images_file(out / REFERENCES_FILE, _render_references(settings))


def _mesh_digests(settings: GenerationSettings) -> dict[str, str]:
    files = {name: mesh_file_of_name(name) for name in settings.object_names}
    for name, file in files.items():
        if file is not None:
            load_object(name, settings.objects_seed)  # a file that is missing or no mesh is refused
    return {name: sha256(file.read_bytes()).hexdigest() for name, file in files.items() if file is not None}


def _render_references(settings: GenerationSettings) -> Iterator[ReferenceImage]:
    """Yield the reference image (no contact) of every sensor, as taken when it was switched on."""
    for number in range(settings.sensors):
        setup, rng = cached_setup(number, settings), np.random.default_rng([settings.seed, 3, number])
        name = setup.member.name
        yield ReferenceImage(name, encode_png(setup.renderer.render(None, rng)), name)


def generate_file(folder: Path, name: str, settings: GenerationSettings, number: int) -> int:
    """Make one file of pairs on the processor and return how many they are; raises `FileNotWritten`."""
    rows = []
    for session in settings.sessions_of_file(number):
        setup = cached_setup(session % settings.sensors, settings)
        rows += run_session_on_cpu(SimulatedPressSession(session, settings, setup).requests())
    write_pair_file(folder / name, rows)
    return len(rows)


def generate_batch(
    folder: Path, settings: GenerationSettings, numbers: Sequence[int], device: str, sessions_per_batch: int
) -> int:
    """Make the files with these numbers, all of one batch, on a device and return the number of their pairs.

    Raises `DeviceError`, `FileNotWritten`.
    """
    files = [folder / pair_file(folder, number, settings.files).name for number in range(settings.files)]
    on, threads = choose_compute_device(device), os.cpu_count() or 1
    return sum(_make_files_in_batches(files, numbers, settings, on, sessions_per_batch, threads, warn))


def _batches_of_files(settings: GenerationSettings, sessions_per_batch: int) -> Iterator[range]:
    """Yield the numbers of the files of each batch. A file with more sessions than a batch is a batch of its own."""
    files_per_batch = max(1, sessions_per_batch // settings.sessions_per_file)
    for first in range(0, settings.files, files_per_batch):
        yield range(first, min(first + files_per_batch, settings.files))


def _make_files_in_batches(
    files: Sequence[Path],
    missing: Sequence[int],
    settings: GenerationSettings,
    device: Device,
    sessions_per_batch: int,
    threads: int,
    notify: Callable[[str], None],
) -> Iterator[int]:
    """Make the missing files in batches of sessions on one device; yield numbers of new pairs from time to time.

    Every file is written when its last session has ended.
    """
    executor: BatchExecutor | None = None
    for batch in _batches_of_files(settings, sessions_per_batch):
        unwritten = {number for number in batch if number in missing}
        if not unwritten:
            continue
        executor = _next_executor(executor, batch, settings, device, sessions_per_batch, notify)
        sessions = {
            file: [
                SimulatedPressSession(number, settings, executor.setups[number % settings.sensors])
                for number in settings.sessions_of_file(file)
            ]
            for file in batch
        }
        counted, known = [session for file in unwritten for session in sessions[file]], 0
        requests = {session.number: session.requests() for own in sessions.values() for session in own}
        for running in run_sessions(requests, executor, threads):
            new = sum(len(session.rows) for session in counted)
            yield new - known
            known = new
            ended = {number for number in unwritten if running.isdisjoint(settings.sessions_of_file(number))}
            for number in sorted(ended):
                write_pair_file(files[number], [row for session in sessions[number] for row in session.rows])
            unwritten -= ended


def _next_executor(
    last: BatchExecutor | None,
    batch: range,
    settings: GenerationSettings,
    device: Device,
    sessions_per_batch: int,
    notify: Callable[[str], None],
) -> BatchExecutor:
    """Return an executor with the sensors of these files; it keeps the setups and the batch size of the last one."""
    before = last.setups if last else {}
    numbers = sorted({session % settings.sensors for file in batch for session in settings.sessions_of_file(file)})
    setups = {number: before.get(number) or make_simulated_sensor(number, settings) for number in numbers}
    return BatchExecutor(setups, device, last.batch_size if last else sessions_per_batch, notify)

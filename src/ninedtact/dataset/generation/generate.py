"""Generates a data set with simulated sensors, file by file, in several processes or on a GPU, and continues a stopped run.

Every file depends on the settings and its own number alone, and is written completely or not at all. A run that was killed
therefore continues with the missing files and ends with the same bytes. Files are made in processes of this machine or on a cluster
(`parallel_jobs`). A GPU is used by one process, which advances many sessions together.

On a GPU, which sessions form one batch depends on the settings and on the batch size, never on the files that exist already:
arithmetic on a device rounds by the shape of its batch, and a continued run must end with the same bytes. A batch with missing
files is therefore computed again as a whole, and only those files are written.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from warnings import warn

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.checked_reading import CHECKSUM_KEY, values_checksum
from ninedtact.dataset.card import format_generation_card
from ninedtact.dataset.folder import DatasetFolder, begin_dataset_folder, to_json_bytes
from ninedtact.dataset.generation.session import GenerationSession, cached_setup, load_object, make_setup
from ninedtact.dataset.generation.settings import GenerationImpossible, GenerationSettings
from ninedtact.dataset.parquet_files import write_pair_file, write_reference_file
from ninedtact.dataset.schema import ReferenceImage
from ninedtact.dataset.statistics import DatasetStatistics, compute_dataset_statistics
from ninedtact.dataset.stored_images import encode_png
from ninedtact.parallel_jobs import Cluster, Workers, WorkersImpossible, require_workers, run_writing_jobs
from ninedtact.simulation.batched.device import Device, find_device
from ninedtact.simulation.batched.executor import BatchExecutor, run_sessions
from ninedtact.simulation.batched.session_requests import run_on_processor

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
        workers: number of processes, or with a GPU number of threads that make noise and PNG files; or a cluster of processors.
        progress: whether to show a progress bar.
        device: a name that `simulation.batched.device` knows.
        sessions_per_batch: number of sessions that a GPU advances together.
        notify: is called with a sentence when the memory of a GPU is too small for a batch.

    Raises `GenerationImpossible`, `WorkersImpossible`, `UnknownObject`, `DatasetFolderTaken`, `FileNotWritten`, `DeviceMissing`.
    """
    require_workers(workers)
    if sessions_per_batch < 1:
        raise GenerationImpossible(
            f"expected at least 1 session per batch, got {sessions_per_batch}; give a larger number"
        )
    on = _select_device(device, workers)
    folder = DatasetFolder(out)
    _begin_generation(folder, settings, on.kind)
    missing = [number for number in range(settings.files) if not folder.pair_file(number, settings.files).is_file()]
    if on.is_batched and isinstance(workers, int):
        pair_counts = _BatchedGeneration(folder, settings, on, sessions_per_batch, workers, notify).make_files(missing)
    else:
        pair_counts = _make_files_in_processes(folder, settings, missing, workers)
    _consume_with_progress(pair_counts, settings, missing, progress)
    return _finish_generation(folder, settings, len(missing), on.kind)


def _select_device(name: str, workers: Workers) -> Device:
    """Return the device of this name, the processor for `auto` on a cluster; raises `WorkersImpossible`, `DeviceMissing`."""
    if not isinstance(workers, Cluster):
        return find_device(name)
    if name not in ("auto", "cpu"):
        raise WorkersImpossible(
            f"expected --device cpu together with --cluster, got {name}; a GPU is used by one process, so drop one of the two"
        )
    return find_device("cpu")


def _begin_generation(folder: DatasetFolder, settings: GenerationSettings, device: str) -> None:
    """Write what all files share, or check that the folder was begun with the same settings on this kind of device."""
    if not folder.settings.is_file():
        for name in settings.object_names:
            load_object(name, settings.objects_seed)  # unknown names are refused before anything is written
    begin_dataset_folder(folder, {"device": device, **settings.to_json_dict()})
    if not folder.sensors.is_file():
        sensors = [settings.sensor_parameters(number).to_json_dict() for number in range(settings.sensors)]
        with_checksums = [{**sensor, CHECKSUM_KEY: values_checksum(sensor)} for sensor in sensors]
        write_file_atomically(folder.sensors, to_json_bytes(with_checksums))
    if not folder.references.is_file():
        write_reference_file(folder.references, _render_references(settings))


def _render_references(settings: GenerationSettings) -> Iterator[ReferenceImage]:
    """Yield the reference image (no contact) of every sensor, as taken when it was switched on."""
    for number in range(settings.sensors):
        setup, rng = cached_setup(number, settings), np.random.default_rng([settings.seed, 3, number])
        name = setup.member.name
        yield ReferenceImage(name, encode_png(setup.renderer.render(None, rng)), name)


def _consume_with_progress(
    pair_counts: Iterable[int], settings: GenerationSettings, missing: list[int], progress: bool
) -> None:
    """Wait until all files are made, with a progress bar; pair_counts yields numbers of new pairs."""
    from tqdm import tqdm

    there = (settings.files - len(missing)) * settings.pairs_per_file
    with tqdm(total=settings.pairs, initial=min(there, settings.pairs), unit="pair", disable=not progress) as bar:
        for pairs in pair_counts:
            bar.update(pairs)


def _make_files_in_processes(
    folder: DatasetFolder, settings: GenerationSettings, missing: list[int], workers: Workers
) -> Iterator[int]:
    """Make the missing files in any order; yield how many pairs each has."""
    jobs = [(folder.pair_file(number, settings.files).name, settings, number) for number in missing]
    data = folder.pair_file(0, settings.files).parent
    yield from (pairs for _, pairs in run_writing_jobs(generate_file, data, jobs, workers))


def generate_file(folder: Path, name: str, settings: GenerationSettings, number: int) -> int:
    """Make one file of pairs on the processor and return how many they are; raises `FileNotWritten`."""
    rows = []
    for session in settings.sessions_of_file(number):
        setup = cached_setup(session % settings.sensors, settings)
        rows += run_on_processor(GenerationSession(session, settings, setup).requests())
    write_pair_file(folder / name, rows)
    return len(rows)


@dataclass
class _BatchedGeneration:
    """Makes files in batches of sessions on one device."""

    folder: DatasetFolder
    settings: GenerationSettings
    device: Device
    sessions_per_batch: int
    """A batch consists of whole files; a file with more sessions is a batch of its own."""
    threads: int
    notify: Callable[[str], None]
    executor: BatchExecutor | None = field(default=None, init=False)
    """The executor of the batch before; None before the first."""

    def make_files(self, missing: Sequence[int]) -> Iterator[int]:
        """Make the missing files; yield numbers of new pairs from time to time."""
        files_per_batch = max(1, self.sessions_per_batch // self.settings.sessions_per_file)
        for first in range(0, self.settings.files, files_per_batch):
            batch = range(first, min(first + files_per_batch, self.settings.files))
            if wanted := [number for number in batch if number in missing]:
                yield from self._make_batch(batch, wanted)

    def _make_batch(self, batch: range, wanted: Sequence[int]) -> Iterator[int]:
        """Run the sessions of one batch; every wanted file is written when its last session has ended."""
        executor = self.executor = self._next_executor(batch)
        files = {number: self._make_sessions(number, executor) for number in batch}
        sessions = [session for sessions in files.values() for session in sessions]
        unwritten, known = set(wanted), 0
        for running in run_sessions(sessions, executor, self.threads):
            new = sum(len(session.rows) for number in wanted for session in files[number])
            yield new - known
            known = new
            ended = {number for number in unwritten if running.isdisjoint(self.settings.sessions_of_file(number))}
            for number in sorted(ended):
                rows = [row for session in files[number] for row in session.rows]
                write_pair_file(self.folder.pair_file(number, self.settings.files), rows)
            unwritten -= ended

    def _make_sessions(self, file: int, executor: BatchExecutor) -> list[GenerationSession]:
        sensors = self.settings.sensors
        return [
            GenerationSession(number, self.settings, executor.setup(number % sensors))
            for number in self.settings.sessions_of_file(file)
        ]

    def _next_executor(self, batch: range) -> BatchExecutor:
        """Return an executor with the sensors of these files; it keeps the setups and the batch size of the one before."""
        before = dict(zip(self.executor.sensor_numbers, self.executor.setups, strict=True)) if self.executor else {}
        sessions = (session for number in batch for session in self.settings.sessions_of_file(number))
        numbers = sorted({session % self.settings.sensors for session in sessions})
        setups = [before.get(number) or make_setup(number, self.settings) for number in numbers]
        batch_size = self.executor.batch_size if self.executor else self.sessions_per_batch
        return BatchExecutor(numbers, setups, self.device, batch_size, self.notify)


def _finish_generation(
    folder: DatasetFolder, settings: GenerationSettings, new_files: int, device: str
) -> GenerationResult:
    """Read back what was made and write the card."""
    files = [folder.pair_file(number, settings.files) for number in range(settings.files)]
    statistics = compute_dataset_statistics(files)
    card = format_generation_card(settings, statistics, version("ninedtact"), device)
    write_file_atomically(folder.card, card.encode())
    return GenerationResult(folder.path, statistics, new_files, device)

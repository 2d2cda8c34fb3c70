"""Generates a data set with simulated sensors, file by file, in several processes or on a GPU, and continues a stopped run.

A file consists of sessions. One session makes some fifty pairs with one simulated sensor (no contact, light touches, scripted
presses).

Every file depends on the settings and its own number alone, and is written completely or not at all. A run that was killed
therefore continues with the missing files and ends with the same bytes. Files are made in processes of this machine or on a
cluster (`parallel_jobs`). A GPU is used by one process, which advances many sessions together.

On a GPU, which sessions form one batch depends on the settings and on the batch size, never on the files that exist already:
arithmetic on a device rounds by the shape of its batch, and a continued run must end with the same bytes. A batch with missing
files is therefore computed again as a whole, and only those files are written.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version
from math import gcd
from pathlib import Path
from warnings import warn

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.bounds_and_checked_reading import CHECKSUM_KEY, mapping_checksum
from ninedtact.design import rectified_mm_per_px
from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import Indenter
from ninedtact.parallel_jobs import Cluster, Workers, require_workers, run_writing_jobs
from ninedtact.quantities import NO_OBJECT
from ninedtact.simulation.objects.catalogue import indenter_from_name, mesh_file_of_name
from ninedtact.simulation.twin import Press
from ninedtact_train.batched.executor import BatchExecutor, Device, choose_compute_device, run_sessions
from ninedtact_train.batched.session_requests import (
    RenderRequest,
    RequestGenerator,
    SimulatedSetup,
    run_session_on_cpu,
)
from ninedtact_train.collecting.training_pair_rule import SamplingRule
from ninedtact_train.dataset.folder import DatasetFolder, begin_or_resume_dataset, to_json_bytes
from ninedtact_train.dataset.generation.press_trajectory import RandomPress
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact_train.dataset.parquet_files import encode_png, write_pair_file, write_reference_images_file
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage
from ninedtact_train.dataset.statistics_and_card import (
    DatasetStatistics,
    compute_dataset_statistics,
    format_generation_card,
)
from ninedtact_train.population.rectified_renderer import rectified_renderer

_STEP_NS = 100_000_000
"""Time between two steps of a press: ten a second."""
_LIGHTEST_N = 0.02
_MAX_FRUITLESS_PRESSES = 30
"""Number of consecutive presses without a pair after which the session is abandoned."""
_OBJECT_SHIFT = 7
"""Shift of each session's first object in the shuffled list: about as many presses as a session makes."""


@dataclass
class SimulatedPressSession:
    """One session of presses on one simulated sensor, until its share of the pairs is full.

    Its pairs depend neither on which other sessions are made nor on which executor computes its requests.
    """

    number: int
    settings: GenerationSettings
    setup: SimulatedSetup
    rows: list[DatasetRow] = field(default_factory=list, init=False)
    """The pairs so far."""
    _presses: int = field(default=0, init=False)
    _steps: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.settings.seed, 1, self.number])
        self._rule = SamplingRule(self.settings.rule, self._rng)
        self._missing = session_quotas(self.number, self.settings)

    def requests(self) -> RequestGenerator[list[DatasetRow]]:
        """Yield the session's requests; the result is its pairs. Raises `InputError` where presses give no pairs."""
        objects = session_objects(self.settings, self.number)
        fruitless = 0
        while any(self._missing.values()):
            before = len(self.rows)
            yield from self._press_once(next(objects))
            fruitless = fruitless + 1 if len(self.rows) == before else 0
            if fruitless > _MAX_FRUITLESS_PRESSES:
                raise InputError(
                    expected="pairs from presses",
                    got=f"none from {_MAX_FRUITLESS_PRESSES} of them",
                    remedy="press harder, or loosen the rule",
                )
        return self.rows

    def _press_once(self, object_name: str) -> RequestGenerator[None]:
        """Add a pair of every kind that is still missing: without contact, of a light touch, and of one press."""
        self._presses += 1
        if self._missing["no_contact"]:
            yield from self._add_row(None, NO_OBJECT, "no_contact")
        if self._missing["light_touch"]:
            press = self._start_press(object_name)
            load_n = float(self._rng.uniform(_LIGHTEST_N, self.settings.light_below_n))
            contact = yield from press.press_lightly(load_n)
            if contact and -self.settings.light_below_n < contact.wrench.force_n[2] < 0:
                yield from self._add_row(contact, object_name, "light_touch")
        if self._missing["rule"]:
            self._presses += 1
            yield from self._add_selected_rows(object_name)

    def _add_selected_rows(self, object_name: str) -> RequestGenerator[None]:
        """Add what the sampling rule selects of one press."""
        self._rule.end_contact()
        press = self._start_press(object_name)
        for target in press.targets():
            contact = yield from press.step_towards(target)
            if contact is None:
                return
            self._steps += 1
            if self._rule.keeps(contact.wrench):
                yield from self._add_row(contact, object_name, "rule")
            if not self._missing["rule"]:
                return

    def _start_press(self, object_name: str) -> RandomPress:
        indenter = _load_object(object_name, self.settings.objects_seed)
        return RandomPress(self.setup, indenter, self.settings.press, self._rng)

    def _add_row(self, contact: Press | None, object_name: str, kind: str) -> RequestGenerator[None]:
        """Request an image of the contact and add it with its wrench."""
        self._missing[kind] -= 1
        wrench = contact.wrench.six if contact else np.zeros(6)
        factor = yield RenderRequest(self.setup, contact.corrected if contact else None)
        image = self.setup.renderer.add_noise(factor, self._rng)
        self.rows.append(
            DatasetRow(
                id=self._row_id(len(self.rows)),
                image=encode_png(image),
                reference_id=self.setup.member.name,
                wrench=wrench.astype(np.float32),
                object=object_name,
                contact_id=f"{self.number:05d}-{self._presses:03d}",
                step=self._steps,
                time_ns=self._steps * _STEP_NS,
                sensor=self.setup.member.name,
                kind=kind,
                source=None,
                mm_per_px=rectified_mm_per_px(self.settings.size, self.settings.design),
            )
        )

    def _row_id(self, index: int) -> str:
        """Return the id of a row of this session: the numbers of its file and of its row there."""
        file, session_in_file = divmod(self.number, self.settings.sessions_per_file)
        return f"train-{file:05d}-{session_in_file * self.settings.pairs_per_session + index:05d}"


def make_simulated_sensor(number: int, settings: GenerationSettings) -> SimulatedSetup:
    """Return the simulated sensor of this number, ready for contact steps and renders."""
    parameters = settings.sensor_parameters(number)
    return SimulatedSetup(parameters, parameters.twin(settings.pitch_mm), rectified_renderer(parameters, settings.size))


@lru_cache(maxsize=2)
def _cached_setup(number: int, settings: GenerationSettings) -> SimulatedSetup:
    """Return the simulated sensor of this number, kept while the next one is in use."""
    return make_simulated_sensor(number, settings)


def _load_object(name: str, seed: int) -> Indenter:
    """Return the object of this name, made once, and again where its mesh file was written again; raises `InputError`."""
    file = mesh_file_of_name(name)
    entry = file.stat() if file is not None and file.is_file() else None
    return _cached_object(name, seed, entry and (entry.st_size, entry.st_mtime_ns))


@lru_cache(maxsize=64)
def _cached_object(name: str, seed: int, stamp: tuple[int, int] | None) -> Indenter:
    """Return the object of this name; stamp: size and time of its mesh file."""
    return indenter_from_name(name, seed)


def _mesh_digests(settings: GenerationSettings) -> dict[str, str]:
    """Return a digest of the mesh file of every object that is one; raises what `indenter_from_name` raises."""
    files = {name: mesh_file_of_name(name) for name in settings.object_names}
    for name, file in files.items():
        if file is not None:
            _load_object(name, settings.objects_seed)  # a file that is missing or no mesh is refused
    return {name: sha256(file.read_bytes()).hexdigest() for name, file in files.items() if file is not None}


def session_objects(settings: GenerationSettings, session: int) -> Iterator[str]:
    """Yield names of objects for one session without end; over all sessions all objects come equally often."""
    names = settings.selected_objects
    order = np.random.default_rng([settings.seed, 2]).permutation(len(names))
    # After this many turns a sensor would begin with the same object again, and is shifted once more.
    turns = len(names) // gcd(len(names), _OBJECT_SHIFT * settings.sensors)
    at = (session + session // (turns * settings.sensors)) * _OBJECT_SHIFT
    while True:
        yield names[order[at % len(names)]]
        at += 1


def session_quotas(number: int, settings: GenerationSettings) -> dict[str, int]:
    """Return how many pairs of each kind a session makes, such that the shares hold over all sessions.

    Where both small kinds are due in a session without room for both, light touches wait for the next one with room.
    """
    ends = np.minimum(settings.pairs_per_session * np.arange(number + 2), settings.pairs)
    no_contact, light_due = (
        np.rint(share * ends).astype(int) for share in (settings.shares.no_contact, settings.shares.light_touch)
    )
    room = ends - no_contact
    light_touch = room + np.minimum.accumulate(light_due - room)
    pairs, untouched, light = (int(total[-1] - total[-2]) for total in (ends, no_contact, light_touch))
    return {"no_contact": untouched, "light_touch": light, "rule": pairs - untouched - light}


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
        device: a name that `simulation.batched.executor` knows.
        sessions_per_batch: number of sessions that a GPU advances together.
        notify: is called with a sentence when the memory of a GPU is too small for a batch.

    Raises `InputError`, `OutputError`, `FileNotWritten`, `DeviceError`.
    """
    require_workers(workers)
    if sessions_per_batch < 1:
        raise InputError(
            expected="at least 1 session per batch", got=f"{sessions_per_batch}", remedy="give a larger number"
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
    """Return the device of this name, the processor for `auto` on a cluster; raises `InputError`, `DeviceError`."""
    if not isinstance(workers, Cluster):
        return choose_compute_device(name)
    if name not in ("auto", "cpu"):
        raise InputError(
            expected="--device cpu together with --cluster",
            got=f"{name}",
            remedy="a GPU is used by one process, so drop one of the two",
        )
    return choose_compute_device("cpu")


def _begin_generation(folder: DatasetFolder, settings: GenerationSettings, device: str) -> None:
    """Write what all files share, or check that the folder was begun with the same settings on this kind of device."""
    if not folder.settings.is_file():
        for name in settings.object_names:
            _load_object(name, settings.objects_seed)  # unknown names are refused before anything is written
    digests = _mesh_digests(settings)
    meshes = {"mesh_digests": digests} if digests else {}
    begin_or_resume_dataset(folder, {"device": device, **settings.to_json_dict(), **meshes})
    if not folder.sensors.is_file():
        sensors = [settings.sensor_parameters(number).to_json_dict() for number in range(settings.sensors)]
        with_checksums = [{**sensor, CHECKSUM_KEY: mapping_checksum(sensor)} for sensor in sensors]
        write_file_atomically(folder.sensors, to_json_bytes(with_checksums))
    if not folder.references.is_file():
        write_reference_images_file(folder.references, _render_references(settings))


def _render_references(settings: GenerationSettings) -> Iterator[ReferenceImage]:
    """Yield the reference image (no contact) of every sensor, as taken when it was switched on."""
    for number in range(settings.sensors):
        setup, rng = _cached_setup(number, settings), np.random.default_rng([settings.seed, 3, number])
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
        setup = _cached_setup(session % settings.sensors, settings)
        rows += run_session_on_cpu(SimulatedPressSession(session, settings, setup).requests())
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

    def _make_sessions(self, file: int, executor: BatchExecutor) -> list[SimulatedPressSession]:
        sensors = self.settings.sensors
        return [
            SimulatedPressSession(number, self.settings, executor.setup(number % sensors))
            for number in self.settings.sessions_of_file(file)
        ]

    def _next_executor(self, batch: range) -> BatchExecutor:
        """Return an executor with the sensors of these files; it keeps the setups and the batch size of the one before."""
        before = dict(zip(self.executor.sensor_numbers, self.executor.setups, strict=True)) if self.executor else {}
        sessions = (session for number in batch for session in self.settings.sessions_of_file(number))
        numbers = sorted({session % self.settings.sensors for session in sessions})
        setups = [before.get(number) or make_simulated_sensor(number, self.settings) for number in numbers]
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

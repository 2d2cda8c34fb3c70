"""A data set from beginning to end: checked, cut into files, made by several processes, and gone on with after a stop.

Every file depends on the settings and on its own number alone, and appears whole or not at all. So a job that was killed goes
on with the files that are missing, and ends with the same bytes. Processes are joblib's: under `joblib.parallel_config("ray")`, or
Dask's, they are a cluster's. A GPU is one process, and advances many sessions together (`dataset.together`).
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from warnings import warn

from ninedtact.atomic_write import write_file_atomically
from ninedtact.dataset.generation.batched_files import Making
from ninedtact.dataset.generation.bench import bench
from ninedtact.dataset.generation.card import card
from ninedtact.dataset.generation.folder import begin, path_of
from ninedtact.dataset.generation.pair import Pair
from ninedtact.dataset.generation.percentiles import by_axis, lines, off, percentiles
from ninedtact.dataset.generation.session import Session
from ninedtact.dataset.generation.settings import DatasetImpossible, DatasetSettings
from ninedtact.dataset.generation.table import wrenches, write_pairs
from ninedtact.simulation.batched.device import device_named
from ninedtact.simulation.batched.requests import alone

CARD = "README.md"
AT_ONCE = 256
"""Sessions that a GPU advances together. More are not quicker, and hold some 3 MB of images each in memory."""


@dataclass(frozen=True)
class Made:
    """A finished data set."""

    folder: Path
    kinds: dict[str, int]
    percentiles: dict[str, list[float]]
    """5, 50 and 95 of every axis, of the pairs that the rule kept, about the paper's force/torque sensor."""
    off: dict[str, list[float]]
    """Their differences from the real ones as parts of the real spans."""
    table: list[str]
    """The same for a person."""
    new_files: int
    """Made by this run; the others were there."""
    device: str
    """The kind of device that all were made on."""


def make_dataset(
    folder: Path,
    settings: DatasetSettings,
    workers: int = 1,
    *,
    progress: bool = False,
    device: str = "cpu",
    at_once: int = AT_ONCE,
    tell: Callable[[str], None] = warn,
) -> Made:
    """Make a data set, or go on with one; raises `DatasetImpossible`, `ObjectUnknown`, `FileNotWritten`, `DeviceMissing`.

    workers: processes; with a GPU threads, which make noise and PNG. device: a name that `together.device` knows. at_once:
    sessions that a GPU advances together. tell: hears of a GPU's memory running out.
    """
    require_some(workers, at_once)
    on = device_named(device)
    begin(folder, settings, on.kind)
    missing = [number for number in range(settings.files) if not path_of(folder, settings, number).is_file()]
    made = (
        Making(folder, settings, on, at_once, workers, tell).files(missing)
        if on.many
        else made_by_workers(folder, settings, missing, workers)
    )
    counted(made, settings, missing, progress)
    return finished(folder, settings, len(missing), on.kind)


def require_some(workers: int, at_once: int) -> None:
    """Refuse none; raises `DatasetImpossible`."""
    if min(workers, at_once) < 1:
        raise DatasetImpossible(
            f"expected at least 1 worker and 1 session at once, got {workers} and {at_once}; give one worker for each core"
        )


def counted(made: Iterable[int], settings: DatasetSettings, missing: list[int], progress: bool) -> None:
    """Let all be made, and show how far it is."""
    from tqdm import tqdm

    there = (settings.files - len(missing)) * settings.pairs_per_file
    with tqdm(total=settings.pairs, initial=min(there, settings.pairs), unit="pair", disable=not progress) as bar:
        for pairs in made:
            bar.update(pairs)


def made_by_workers(folder: Path, settings: DatasetSettings, missing: list[int], workers: int) -> Iterator[int]:
    """Make the missing files, in any order; how many pairs each has."""
    from joblib import delayed

    yield from as_done(
        [delayed(make_file)(path_of(folder, settings, number), settings, number) for number in missing], workers
    )


def as_done(jobs: list[Any], workers: int) -> Iterable[int]:
    """What joblib's jobs return: each when it is done, where the backend can tell, as Ray's cannot."""
    from joblib import Parallel
    from joblib.parallel import get_active_backend

    tells = get_active_backend()[0].supports_return_generator
    return Parallel(n_jobs=workers, return_as="generator_unordered" if tells else "list")(jobs)


def make_file(path: Path, settings: DatasetSettings, number: int) -> int:
    """One file of pairs; how many they are."""
    pairs = list(pairs_of(settings, number))
    write_pairs(path, pairs)
    return len(pairs)


def pairs_of(settings: DatasetSettings, number: int) -> Iterator[Pair]:
    """All pairs of one file."""
    for session in settings.sessions_of(number):
        yield from alone(Session(session, settings, bench(session % settings.sensors, settings)).asking())


def finished(folder: Path, settings: DatasetSettings, new_files: int, device: str) -> Made:
    """Read back what was made, and write its card."""
    six, kinds = wrenches(path_of(folder, settings, number) for number in range(settings.files))
    by_rule = six[kinds == "rule"] if "rule" in kinds else six
    table, found = list(lines(by_rule)), percentiles(by_rule)
    counts = dict(sorted(Counter(kinds.tolist()).items()))
    write_file_atomically(folder / CARD, card(settings, version("ninedtact"), counts, table, device).encode())
    return Made(folder, counts, by_axis(found), by_axis(off(found)), table, new_files, device)

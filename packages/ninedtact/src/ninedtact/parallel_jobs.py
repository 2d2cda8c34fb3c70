"""Runs independent jobs in this process, in several processes of this machine, or on the workers of a Dask cluster.

`Workers` says where: a number of processes, or a `DaskCluster` to which `connect_workers` has connected. At most two jobs for each
worker are submitted to either at once. A job that ran on a cluster returns its files to this process, which writes
them: a cluster needs no shared file system for results.

Every job uses one thread of linear algebra, because the rounding of BLAS depends on the number of its threads, and a calibration
amplifies the last digits. Processes of this machine end when this process is killed.
"""

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from socket import gethostname
from tempfile import TemporaryDirectory
from threading import Thread
from time import sleep
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from ninedtact._version import __version__
from ninedtact.atomic_write import write_files_atomically
from ninedtact.errors import DeviceError, InputError
from ninedtact.required_libraries import require_libraries

CONNECT_TIMEOUT_S = 8
"""Time in which a cluster must answer."""
_PARENT_POLL_S = 1.0
"""Time after which a worker process looks whether its parent still runs; all of them had ended 1.3 to 2.2 s after a kill."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class DaskCluster:
    """A cluster to which this process is connected; all of its cores are used."""

    name: str
    """The address of its scheduler."""
    cores: int
    submit: Callable[..., "Future[Any]"]
    """Starts a call of a function without arguments on a worker."""
    lost_errors: tuple[type[Exception], ...] = ()
    """Errors of a job whose workers were lost."""


Workers = int | DaskCluster
"""A number of processes on this machine, or a cluster."""


@contextmanager
def connect_workers(workers: int, cluster: str | None) -> Iterator[Workers]:
    """Yield the connection to a Dask cluster by its scheduler, `10.0.0.1:8786`; without an address the number of processes.

    Raises `InputError` for fewer than one worker, `MissingLibraryError` without Dask, and `DeviceError` for a cluster that does not
    answer, or whose workers have another version of ninedtact.
    """
    require_workers(workers)
    if cluster is None:
        yield workers
        return
    require_libraries("cluster", "distributed")
    with _connect_dask(cluster) as connected:
        yield connected


def require_workers(workers: Workers) -> None:
    """Raise `InputError` for fewer than one worker."""
    if isinstance(workers, int) and workers < 1:
        raise InputError(expected="at least 1 worker", got=f"{workers}", remedy="give one for each core")


def run_jobs(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], workers: Workers
) -> Iterator[tuple[int, Result]]:
    """Call a function with the arguments of every job; yield the number and the result of each job when it is done.

    One worker runs the jobs in this process. Raises `InputError` for fewer than one worker, `DeviceError` where workers are lost
    before the work is done, and what the function raises.
    """
    require_workers(workers)
    if isinstance(workers, DaskCluster):
        calls = (partial(_run_remote_job, __version__, function, job) for job in jobs)
        yield from _run_on_executor(workers.submit, workers.cores, calls, workers.name, workers.lost_errors)
    elif workers == 1 or (isinstance(jobs, Sequence) and len(jobs) < 2):
        for number, job in enumerate(jobs):
            with _limit_threads():
                result = function(*job)
            yield number, result
    else:
        yield from _run_in_processes(function, jobs, workers)


def run_writing_jobs(
    function: Callable[..., Result], folder: Path, jobs: Sequence[tuple[Any, ...]], workers: Workers
) -> Iterator[tuple[int, Result]]:
    """Call a function that writes files into a folder, its first argument, with every job; yield numbers and results.

    On a cluster the function writes into a temporary folder of the worker, and this process moves its files and folders to
    `folder`, each of them whole, in the order of their names. Raises as `run_jobs`, and `FileNotWritten`.
    """
    if not isinstance(workers, DaskCluster):
        yield from run_jobs(function, [(folder, *job) for job in jobs], workers)
        return
    for number, (result, files) in run_jobs(_call_in_temporary_folder, [(function, job) for job in jobs], workers):
        write_files_atomically(folder, files)
        yield number, result


def _call_in_temporary_folder(
    function: Callable[..., Result], job: tuple[Any, ...]
) -> tuple[Result, list[tuple[str, bytes]]]:
    """Return the result of a job and the files that it wrote, by their paths in the folder."""
    with TemporaryDirectory(prefix="ninedtact") as name:
        folder = Path(name)
        result = function(folder, *job)
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return result, [(path.relative_to(folder).as_posix(), path.read_bytes()) for path in files]


def _run_on_executor(
    submit: Callable[..., "Future[Any]"],
    workers: int,
    calls: Iterable[Callable[[], Any]],
    place: str,
    lost_errors: tuple[type[Exception], ...],
) -> Iterator[tuple[int, Any]]:
    """Submit calls, two for each worker at once; yield the number and the result of each when it is done.

    place: the name of the executor. Raises `DeviceError` for `lost_errors`, and what the calls raise.
    """
    running: dict[Future[Any], int] = {}
    numbered = enumerate(calls)
    try:
        while True:
            for number, call in islice(numbered, 2 * workers - len(running)):
                running[submit(call)] = number
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    except lost_errors as error:
        reason = (str(error).splitlines() or [""])[0][:200]
        raise DeviceError(
            expected=f"{place} until the end",
            got=f"{type(error).__name__}: {reason}",
            remedy="run the command again to continue, with more memory for each worker if they were killed",
        ) from error
    finally:
        for future in running:
            future.cancel()


def _limit_threads() -> threadpool_limits:
    """Limit linear algebra to one thread, as a context or for good."""
    import scipy.linalg  # noqa: F401  (SciPy has a BLAS of its own, which is found only once it is loaded)

    return threadpool_limits(1)


def _run_job(function: Callable[..., Result], job: tuple[Any, ...]) -> Result:
    _limit_threads()  # for good, because other threads of a cluster's worker may run jobs as well
    return function(*job)


def _run_in_processes(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], workers: int
) -> Iterator[tuple[int, Result]]:
    from loky import get_reusable_executor

    executor = get_reusable_executor(max_workers=workers, initializer=_watch_parent, initargs=(os.getpid(),))
    calls = (partial(_run_job, function, job) for job in jobs)
    finished = False
    try:
        yield from _run_on_executor(executor.submit, workers, calls, f"{workers} worker processes", (BrokenExecutor,))
        finished = True
    finally:
        if not finished:
            executor.shutdown(kill_workers=True)  # jobs that have begun would otherwise run to their end


def _watch_parent(parent: int) -> None:
    """End this process when its parent has ended, which a killed parent cannot request."""

    def exit_with_parent() -> None:
        while os.getppid() == parent:
            sleep(_PARENT_POLL_S)
        os._exit(1)

    Thread(target=exit_with_parent, daemon=True).start()


def _run_remote_job(version: str, function: Callable[..., Result], job: tuple[Any, ...]) -> Result:
    """Run a job on a worker of a cluster, unless it joined with another version than this process."""
    _require_version(version, __version__, gethostname())
    try:
        return _run_job(function, job)
    except ImportError as error:
        raise InputError(
            f"expected the libraries of this command on every worker, got: {error} on {gethostname()}; install the extras of "
            "ninedtact that this machine has there"
        ) from error


def _require_version(expected: str, found: str | None, place: str) -> None:
    """Raise `DeviceError` where a part of a cluster has another version of ninedtact, or none."""
    if found != expected:
        raise DeviceError(
            expected=f"ninedtact {expected} on every machine of the cluster",
            got=f"{found or 'none'} on {place}",
            remedy="install that version there",
        )


@contextmanager
def _connect_dask(address: str) -> Iterator[DaskCluster]:
    """Connect to a Dask scheduler; raises `DeviceError`."""
    import dask
    from distributed import Client, KilledWorker

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # failures are raised as one sentence
    # A job of `evaluate` contains some MB of images, of which Dask would warn.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"}):
        try:
            client = _call_within(CONNECT_TIMEOUT_S, lambda: Client(address))
        except (OSError, ValueError) as error:
            raise _unreachable(address, error) from error
        with client:
            cores = sum(client.ncores().values())
            if not cores:
                raise _unreachable(address, "a scheduler without workers")
            for worker, found in client.get_versions(packages=["ninedtact"])["workers"].items():
                _require_version(__version__, found["packages"]["ninedtact"], worker)
            submit = client.get_executor(pure=False).submit
            yield DaskCluster(address, cores, submit, (KilledWorker, CancelledError))


def _unreachable(address: str, reason: object) -> DeviceError:
    words = " ".join(str(reason).split())[:200] or f"no answer within {CONNECT_TIMEOUT_S} s"
    return DeviceError(
        expected="--cluster HOST:PORT of a Dask scheduler that answers",
        got=f"{address}: {words}",
        remedy="check the address, and that its scheduler and workers run",
    )


def _call_within(seconds: float, connect: Callable[[], Result]) -> Result:
    """Return what a call returns; raises `TimeoutError`, and what the call raises."""
    outcome: Future[Result] = Future()

    def call() -> None:
        try:
            outcome.set_result(connect())
        except Exception as error:
            outcome.set_exception(error)

    Thread(target=call, daemon=True).start()  # Dask waits for ever for a port that accepts and says nothing
    return outcome.result(seconds)

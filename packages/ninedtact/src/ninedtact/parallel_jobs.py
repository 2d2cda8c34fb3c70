"""Runs independent jobs in this process, in several processes of this machine, or on the workers of a Dask or Ray cluster.

`Workers` says where: a number of processes, or a `Cluster` to which `connect_workers` has connected. All of them are executors to
which at most two jobs for each worker are submitted at once. A job that ran on a cluster returns its files to this process, which
writes them: a cluster needs no shared file system for results.

Every job uses one thread of linear algebra, because the rounding of BLAS depends on the number of its threads, and a calibration
amplifies the last digits. A worker of a cluster compares its version of ninedtact with that of this process before it reads a job.
Processes of this machine end when this process is killed.
"""

import logging
import os
import pickle
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import distributions
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from socket import gethostname
from tempfile import TemporaryDirectory
from threading import Thread
from time import sleep
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from ninedtact._version import __version__, installation_command
from ninedtact.atomic_write import write_files_atomically
from ninedtact.errors import DeviceError, InputError, MissingLibraryError

CONNECT_TIMEOUT_S = 8
"""Time in which a cluster must answer."""
_PACKAGES = {"dask": ("dask", "distributed"), "ray": ("ray", "grpc")}
"""Packages that each kind of cluster needs."""
_EXECUTOR_PACKAGES = ("asyncio", "concurrent", "distributed", "joblib", "ray")
"""Packages whose errors mean that a worker was lost; a job raises others."""
_PARENT_POLL_S = 1.0
"""Time after which a worker process looks whether its parent still runs; all of them had ended 1.3 to 2.2 s after a kill."""

Result = TypeVar("Result")


class WorkersImpossible(InputError):
    """Raised for fewer than one worker process, and for work that a cluster cannot do."""


class ClusterAddressInvalid(InputError):
    """Raised for a text that is not the address of a cluster."""


class ClusterLibraryMissing(MissingLibraryError):
    """Raised where the library of this kind of cluster is not installed."""


class ClusterUnreachable(DeviceError):
    """Raised for a cluster that does not answer or has no workers."""


class WorkerVersionDiffers(DeviceError):
    """Raised for a cluster worker with another version of ninedtact, or without it."""


class WorkersLost(DeviceError):
    """Raised where worker processes or the cluster ended before the work was done."""


@dataclass(frozen=True)
class Cluster:
    """A cluster of Dask or Ray to which this process is connected; all of its cores are used."""

    name: str
    """The address as it was given."""
    cores: int
    submit: Callable[..., "Future[Any]"]
    """Starts a call of a function with arguments on a worker."""


Workers = int | Cluster
"""A number of processes on this machine, or a cluster."""


@contextmanager
def connect_workers(workers: int, cluster: str | None) -> Iterator[Workers]:
    """Yield the connection to a cluster, such as `dask:10.0.0.1:8786`; without an address the number of processes.

    Raises `WorkersImpossible`, `ClusterAddressInvalid`, `ClusterLibraryMissing`, `ClusterUnreachable`, `WorkerVersionDiffers`.
    """
    require_workers(workers)
    if cluster is None:
        yield workers
        return
    kind, _, address = cluster.partition(":")
    if kind not in _PACKAGES or not re.fullmatch(r"(\w+://)?[^/]+:\d+", address):
        raise ClusterAddressInvalid(f"expected --cluster dask:HOST:PORT or ray:HOST:PORT, got {cluster!r}; correct it")
    for package in _PACKAGES[kind]:
        if find_spec(package) is None:
            raise ClusterLibraryMissing(
                f"expected the libraries of clusters, got no {package}; run {installation_command('cluster')}"
            )
    with (_connect_dask if kind == "dask" else _connect_ray)(cluster, address) as connected:
        list(run_jobs(int, [(0,)], connected))  # refuses workers of another version before work begins
        yield connected


def require_workers(workers: Workers) -> None:
    """Raise `WorkersImpossible` for fewer than one worker."""
    if isinstance(workers, int) and workers < 1:
        raise WorkersImpossible(f"expected at least 1 worker, got {workers}; give one for each core")


def run_jobs(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], workers: Workers
) -> Iterator[tuple[int, Result]]:
    """Call a function with the arguments of every job; yield the number and the result of each job when it is done.

    One worker runs the jobs in this process. Raises `WorkersImpossible`, `WorkersLost`, `WorkerVersionDiffers`, and what the
    function raises.
    """
    require_workers(workers)
    if isinstance(workers, Cluster):
        yield from _run_on_cluster(function, jobs, workers)
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
    if not isinstance(workers, Cluster):
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
    submit: Callable[..., "Future[Any]"], workers: int, calls: Iterable[tuple[Any, ...]], place: str
) -> Iterator[tuple[int, Any]]:
    """Submit calls of a function, two for each worker at once; yield the number and the result of each when it is done.

    place: the name of the executor for `WorkersLost`. Raises it, and what the functions raise.
    """
    running: dict[Future[Any], int] = {}
    numbered = enumerate(calls)
    try:
        while True:
            for number, call in islice(numbered, 2 * workers - len(running)):
                running[submit(*call)] = number
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    except Exception as error:
        if type(error).__module__.partition(".")[0] not in _EXECUTOR_PACKAGES:
            raise
        reason = (str(error).splitlines() or [""])[0][:200]
        raise WorkersLost(
            f"expected {place} until the end, got {type(error).__name__}: {reason}; run the command again to continue, with "
            "more memory for each worker if they were killed"
        ) from error
    finally:
        for future in running:
            future.cancel()


def _limit_threads() -> threadpool_limits:
    """Limit linear algebra to one thread, as a context or for good."""
    import scipy.linalg  # noqa: F401  (SciPy has a BLAS of its own, which is found only once it is loaded)

    return threadpool_limits(1)


def _run_in_processes(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], workers: int
) -> Iterator[tuple[int, Result]]:
    """Run jobs in processes of this machine; see `run_jobs`."""
    from joblib.externals.loky import get_reusable_executor

    executor = get_reusable_executor(max_workers=workers, initializer=_watch_parent, initargs=(os.getpid(),))
    calls = ((_run_local_job, function, job) for job in jobs)
    finished = False
    try:
        yield from _run_on_executor(executor.submit, workers, calls, f"{workers} worker processes")
        finished = True
    finally:
        if not finished:
            executor.shutdown(kill_workers=True)  # jobs that have begun would otherwise run to their end


def _run_local_job(function: Callable[..., Result], job: tuple[Any, ...]) -> Result:
    """Run a job in a worker process."""
    _limit_threads()
    return function(*job)


def _watch_parent(parent: int) -> None:
    """End this process when its parent has ended, which a killed parent cannot request."""

    def exit_with_parent() -> None:
        while os.getppid() == parent:
            sleep(_PARENT_POLL_S)
        os._exit(1)

    Thread(target=exit_with_parent, daemon=True).start()


def _run_on_cluster(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], cluster: Cluster
) -> Iterator[tuple[int, Result]]:
    """Run jobs on the workers of a cluster; see `run_jobs`."""

    # A lambda travels as code, because a worker may have another version of this module, or none.
    run_if_same_version = lambda expected, payload: (  # noqa: E731
        import_module("ninedtact.parallel_jobs")._run_remote_job(payload)
        if (found := next((one.version for one in distributions(name="ninedtact")), "none")) == expected
        else f"{found} on {gethostname()}"
    )
    calls = ((run_if_same_version, __version__, pickle.dumps((function, job))) for job in jobs)
    for number, answer in _run_on_executor(cluster.submit, cluster.cores, calls, cluster.name):
        if isinstance(answer, str):
            raise WorkerVersionDiffers(
                f"expected ninedtact {__version__} on every worker of {cluster.name}, got {answer}; install that version there"
            )
        result, error = pickle.loads(answer)
        if error is not None:
            raise error
        yield number, result


def _run_remote_job(payload: bytes) -> bytes:
    """Run a job on a worker of a cluster; return its result and its error, one of which is None, as pickled bytes."""
    try:
        function, job = pickle.loads(payload)
        _limit_threads()  # for good, because other threads of this process may run jobs as well
        return pickle.dumps((function(*job), None))
    except ImportError as error:
        missing = WorkersImpossible(
            f"expected the libraries of this command on every worker, got: {error} on {gethostname()}; install the extras of "
            "ninedtact that this machine has there"
        )
        return pickle.dumps((None, missing))
    except Exception as error:  # raised again in the process that sent the job
        return pickle.dumps((None, error))


def _unreachable(cluster: str, reason: object) -> ClusterUnreachable:
    words = " ".join(str(reason).split())[:200] or f"no answer within {CONNECT_TIMEOUT_S} s"
    return ClusterUnreachable(
        f"expected a cluster that answers at {cluster}, got: {words}; check the address, and that its scheduler and workers run"
    )


@contextmanager
def _connect_dask(cluster: str, address: str) -> Iterator[Cluster]:
    """Connect to a Dask scheduler; raises `ClusterUnreachable`."""
    import dask
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # failures are raised as one sentence
    # A job of `evaluate` contains some MB of images, of which Dask would warn.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"}), ExitStack() as stack:
        try:
            client = stack.enter_context(_call_within(CONNECT_TIMEOUT_S, lambda: Client(address)))
        except (OSError, ValueError) as error:
            raise _unreachable(cluster, error) from error
        cores = sum(client.ncores().values())
        if not cores:
            raise _unreachable(cluster, "a scheduler without workers")
        yield Cluster(cluster, cores, client.get_executor(pure=False).submit)


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


@contextmanager
def _connect_ray(cluster: str, address: str) -> Iterator[Cluster]:
    """Connect to a Ray cluster; raises `ClusterUnreachable`."""
    import grpc

    channel = grpc.insecure_channel(address.removeprefix("ray://"))  # Ray itself waits for minutes
    try:
        grpc.channel_ready_future(channel).result(timeout=CONNECT_TIMEOUT_S)
    except grpc.FutureTimeoutError as error:
        raise _unreachable(cluster, error) from error
    finally:
        channel.close()
    import ray

    try:
        ray.init(address, logging_level="ERROR", log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise _unreachable(cluster, error) from error
    task = ray.remote(lambda function, *arguments: function(*arguments))  # a task of a killed worker is run again
    try:
        cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
        yield Cluster(cluster, cores, lambda function, *arguments: task.remote(function, *arguments).future())
    finally:
        ray.shutdown()

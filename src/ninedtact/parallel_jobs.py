"""Runs independent jobs in this process, in several processes of this machine, or on the workers of a Dask or Ray cluster.

`Workers` says where: a number of processes, or a `Cluster` to which `connect_workers` has connected. All three run through joblib.
A job that ran on a cluster returns its files to this process, which writes them: a cluster needs no shared file system for results.

A worker of a cluster compares its version of ninedtact with that of this process before it reads a job. Processes of this machine
end within a second when this process is killed.
"""

import os
import pickle
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from time import sleep
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from ninedtact._version import __version__
from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import DeviceError, InputError, MissingLibraryError

CONNECT_TIMEOUT_S = 8
"""Time in which a cluster must answer."""
_PACKAGES = {"dask": ("distributed",), "ray": ("ray", "grpc")}
"""Packages that each kind of cluster needs."""
_ADDRESS_FORMS = "dask:HOST:PORT, ray:HOST:PORT or ray:ray://HOST:PORT"
_PARENT_POLL_S = 1.0

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
    backend: Callable[[], AbstractContextManager[Any]]
    """Makes the cluster joblib's backend while the context is open."""


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
    if kind not in _PACKAGES or not address:
        raise ClusterAddressInvalid(f"expected --cluster {_ADDRESS_FORMS}, got {cluster!r}; correct it")
    for package in ("joblib", *_PACKAGES[kind]):
        if find_spec(package) is None:
            raise ClusterLibraryMissing(
                f"expected the libraries of clusters, got no {package}; run pip install 'ninedtact[cluster]'"
            )
    _require_open_port(cluster, address)
    with {"dask": _connect_dask, "ray": _connect_ray}[kind](cluster, address) as backend:
        connected = Cluster(cluster, backend)
        list(run_jobs(int, [(0,)], connected))  # refuses workers of another version before work begins
        yield connected


def run_jobs(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], workers: Workers
) -> Iterator[tuple[int, Result]]:
    """Call a function with the arguments of every job; yield the number and the result of each job when it is done.

    One worker runs the jobs in this process. Raises `WorkersImpossible`, `WorkersLost`, `WorkerVersionDiffers`, and what the
    function raises.
    """
    if isinstance(workers, Cluster):
        yield from _run_on_cluster(function, jobs, workers)
        return
    require_workers(workers)
    if workers == 1 or (isinstance(jobs, Sequence) and len(jobs) < 2):
        yield from ((number, _call_with_one_thread(function, job)) for number, job in enumerate(jobs))
        return
    from joblib import Parallel, delayed
    from joblib._parallel_backends import LokyBackend
    from joblib.externals.loky.process_executor import BrokenProcessPool
    from joblib.parallel import get_active_backend

    parent = os.getpid() if isinstance(get_active_backend()[0], LokyBackend) else None
    numbered = (delayed(_run_local_job)(parent, number, function, job) for number, job in enumerate(jobs))
    try:
        yield from Parallel(n_jobs=workers, return_as="generator_unordered")(numbered)
    except BrokenProcessPool as error:
        raise WorkersLost(
            f"expected {workers} worker processes until the end, got one that was killed, perhaps because memory ran out; run "
            "the command again to continue, with fewer --workers"
        ) from error


def run_writing_jobs(
    function: Callable[..., Result],
    folder: Path,
    jobs: Sequence[tuple[Any, ...]],
    workers: Workers,
    last: tuple[str, ...] = (),
) -> Iterator[tuple[int, Result]]:
    """Call a function that writes files into a folder, its first argument, with every job; yield numbers and results.

    On a cluster the function writes into a temporary folder of the worker, and this process moves its files and folders to
    `folder`, each of them whole, those whose names end with one of `last` after the others. Raises as `run_jobs`, and
    `FileNotWritten`.
    """
    if not isinstance(workers, Cluster):
        yield from run_jobs(function, [(folder, *job) for job in jobs], workers)
        return
    for number, (result, files) in run_jobs(_call_in_temporary_folder, [(function, job) for job in jobs], workers):
        _copy_into_folder(files, folder, last)
        yield number, result


def _copy_into_folder(files: Iterable[tuple[str, bytes]], folder: Path, last: tuple[str, ...]) -> None:
    """Write files that were received, first below a partial folder beside their place; raises `FileNotWritten`, `OSError`."""
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder, prefix=".", suffix=".partial") as name:
        staging = Path(name)
        for relative_path, content in files:
            (staging / relative_path).parent.mkdir(parents=True, exist_ok=True)
            write_file_atomically(staging / relative_path, content)
        for entry in sorted(staging.iterdir(), key=lambda path: path.name.endswith(last)):
            entry.replace(folder / entry.name)


def _call_in_temporary_folder(
    function: Callable[..., Result], job: tuple[Any, ...]
) -> tuple[Result, list[tuple[str, bytes]]]:
    """Return the result of a job and the files that it wrote, by their paths in the folder."""
    with TemporaryDirectory(prefix="ninedtact") as name:
        folder = Path(name)
        result = function(folder, *job)
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return result, [(path.relative_to(folder).as_posix(), path.read_bytes()) for path in files]


def require_workers(workers: Workers) -> None:
    """Raise `WorkersImpossible` for fewer than one worker."""
    if isinstance(workers, int) and workers < 1:
        raise WorkersImpossible(f"expected at least 1 worker, got {workers}; give one for each core")


def _call_with_one_thread(function: Callable[..., Result], job: tuple[Any, ...]) -> Result:
    """Return what a function returns with one thread of linear algebra, whose rounding depends on the number of threads."""
    with threadpool_limits(1):
        return function(*job)


def _run_local_job(
    parent: int | None, number: int, function: Callable[..., Result], job: tuple[Any, ...]
) -> tuple[int, Result]:
    """Run a job, in a process that ends with its parent where one is given."""
    if parent is not None and not _watches_parent:
        _watches_parent.append(Thread(target=_exit_with_parent, args=(parent,), daemon=True))
        _watches_parent[0].start()
    return number, _call_with_one_thread(function, job)


_watches_parent: list[Thread] = []
"""The thread of a worker process that waits for the end of its parent."""


def _exit_with_parent(parent: int) -> None:
    """End this process when its parent has ended, which a killed parent cannot request."""
    while os.getppid() == parent:
        sleep(_PARENT_POLL_S)
    os._exit(1)


def _run_on_cluster(
    function: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], cluster: Cluster
) -> Iterator[tuple[int, Result]]:
    """Run jobs on the workers of a cluster; see `run_jobs`."""
    from joblib import Parallel, delayed

    # The lambda travels as code, because a worker may have another version of this module, or none.
    run = delayed(
        lambda expected, number, payload: (
            import_module("ninedtact.parallel_jobs")._run_remote_job(number, payload)
            if version("ninedtact") == expected
            else (number, "version", f"{version('ninedtact')} on {socket.gethostname()}")
        )
    )
    calls = (run(__version__, number, pickle.dumps((function, job))) for number, job in enumerate(jobs))
    try:
        with cluster.backend():
            for number, kind, value in Parallel(n_jobs=-1, batch_size=1, return_as="generator_unordered")(calls):
                if kind == "version":
                    raise _other_version(cluster, value)
                if kind == "missing":
                    raise WorkersImpossible(
                        f"expected the libraries of this command on every worker of {cluster.name}, got: {value}; install the "
                        "extras of ninedtact that this machine has there"
                    )
                if kind == "error":
                    raise pickle.loads(value)
                yield number, pickle.loads(value)
    except PackageNotFoundError as error:
        raise _other_version(cluster, "none on one of them") from error
    except Exception as error:
        if type(error).__module__.partition(".")[0] not in ("distributed", "ray", "concurrent", "asyncio"):
            raise
        reason = (str(error).splitlines() or [""])[0]
        raise WorkersLost(
            f"expected {cluster.name} and its workers until the end, got: {type(error).__name__} {reason}; run the command again "
            "to continue, with more memory for each worker if they were killed"
        ) from error


def _other_version(cluster: Cluster, found: str) -> WorkerVersionDiffers:
    return WorkerVersionDiffers(
        f"expected ninedtact {__version__} on every worker of {cluster.name}, got {found}; install that version there"
    )


def _run_remote_job(number: int, payload: bytes) -> tuple[int, str, Any]:
    """Run a job on a worker of a cluster; return its number, the kind of its outcome, and the outcome."""
    try:
        function, job = pickle.loads(payload)
        return number, "result", pickle.dumps(_call_with_one_thread(function, job))
    except ImportError as error:
        return number, "missing", f"{error} on {socket.gethostname()}"
    except Exception as error:  # raised again in the process that sent the job
        return number, "error", pickle.dumps(error)


def _require_open_port(cluster: str, address: str) -> None:
    """Refuse an address at which nothing listens; raises `ClusterAddressInvalid`, `ClusterUnreachable`."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not host or not port.isdecimal():
        raise ClusterAddressInvalid(f"expected --cluster {_ADDRESS_FORMS}, got {cluster!r}; correct it")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_TIMEOUT_S / 2).close()
    except (OSError, OverflowError) as error:
        raise _unreachable(cluster, error) from error


def _unreachable(cluster: str, reason: object) -> ClusterUnreachable:
    words = " ".join(str(reason).split())[:200] or type(reason).__name__
    return ClusterUnreachable(
        f"expected a cluster that answers at {cluster}, got: {words}; check the address, and that its scheduler and workers run"
    )


@contextmanager
def _connect_dask(cluster: str, address: str) -> Iterator[Callable[[], AbstractContextManager[Any]]]:
    """Connect to a Dask scheduler and yield joblib's own backend for it; raises `ClusterUnreachable`."""
    import logging

    import dask
    from distributed import Client
    from joblib import parallel_config

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # failures are raised as one sentence
    with dask.config.set({"distributed.comm.timeouts.connect": f"{CONNECT_TIMEOUT_S}s"}):
        client = _call_within(CONNECT_TIMEOUT_S, cluster, lambda: Client(address, timeout=CONNECT_TIMEOUT_S))
    with client:
        if not client.ncores():
            raise _unreachable(cluster, "a scheduler without workers")
        yield partial(parallel_config, "dask", client=client)


@contextmanager
def _connect_ray(cluster: str, address: str) -> Iterator[Callable[[], AbstractContextManager[Any]]]:
    """Connect to a Ray cluster and yield a backend for it; raises `ClusterUnreachable`."""
    import grpc

    host = address.removeprefix("ray://")
    _call_within(
        CONNECT_TIMEOUT_S,
        cluster,
        lambda: grpc.channel_ready_future(grpc.insecure_channel(host)).result(timeout=CONNECT_TIMEOUT_S),
    )
    import ray
    from joblib import parallel_config

    try:
        ray.init(address, logging_level="ERROR", log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise _unreachable(cluster, error) from error
    try:
        yield partial(parallel_config, _make_ray_backend())
    finally:
        ray.shutdown()


def _call_within(seconds: float, cluster: str, connect: Callable[[], Any]) -> Any:
    """Return what a call returns; raises `ClusterUnreachable` where it fails or takes longer."""
    outcome: list[Any] = []

    def call() -> None:
        try:
            outcome.append((connect(), None))
        except Exception as error:  # the libraries raise many kinds of error
            outcome.append((None, error))

    thread = Thread(target=call, daemon=True)
    thread.start()
    thread.join(seconds)
    if not outcome:
        raise _unreachable(cluster, f"no answer within {seconds:g} s")
    connection, error = outcome[0]
    if error is not None:
        raise _unreachable(cluster, error) from error
    return connection


def _make_ray_backend() -> Any:
    """Return a joblib backend that runs each job as a Ray task.

    Ray's own backend returns all results at the end and does not replace a worker that was killed; a task is run again by Ray.
    """
    import ray
    from joblib.parallel import ParallelBackendBase

    run_batch = ray.remote(lambda batch: batch())  # travels as code

    class RayTasks(ParallelBackendBase):  # type: ignore[misc]
        supports_retrieve_callback = True

        def effective_n_jobs(self, n_jobs: int) -> int:
            return max(1, int(ray.cluster_resources().get("CPU", 1)))

        def submit(self, func: Callable[[], Any], callback: Callable[[Any], None]) -> Any:
            future = run_batch.remote(func).future()
            future.add_done_callback(callback)
            return future

        def retrieve_result_callback(self, future: Any) -> Any:
            return future.result()

    return RayTasks()

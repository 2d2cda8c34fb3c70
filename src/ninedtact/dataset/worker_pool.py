"""The worker pool of data sets: jobs in several processes, or on a cluster under `joblib.parallel_config`."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from ninedtact.errors import InputError

Result = TypeVar("Result")


class WorkersImpossible(InputError):
    """Fewer than one worker process."""


def run_in_processes(
    function: Callable[..., Result], jobs: Sequence[tuple[Any, ...]], workers: int
) -> Iterator[tuple[int, Result]]:
    """Call a function with the arguments of every job; yield the number and the result of each job when it is done.

    One worker runs the jobs in this process. The processes are joblib's, so `joblib.parallel_config("ray")` or Dask's makes them
    those of a cluster; a backend that cannot report single results reports all at the end. Raises `WorkersImpossible`.
    """
    require_workers(workers)
    if workers == 1 or len(jobs) < 2:
        yield from ((number, function(*job)) for number, job in enumerate(jobs))
        return
    from joblib import Parallel, delayed
    from joblib.parallel import get_active_backend

    reports_each = get_active_backend()[0].supports_return_generator
    numbered = (delayed(_run_numbered_job)(number, function, job) for number, job in enumerate(jobs))
    yield from Parallel(n_jobs=workers, return_as="generator_unordered" if reports_each else "list")(numbered)


def _run_numbered_job(number: int, function: Callable[..., Result], job: tuple[Any, ...]) -> tuple[int, Result]:
    return number, function(*job)


def require_workers(workers: int) -> None:
    """Raise `WorkersImpossible` for fewer than one worker."""
    if workers < 1:
        raise WorkersImpossible(f"expected at least 1 worker, got {workers}; give one for each core")

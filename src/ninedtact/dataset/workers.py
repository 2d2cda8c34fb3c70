"""Several files at once, each in a process of its own."""

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from ninedtact.errors import NinedtactError

Result = TypeVar("Result")


class WorkersImpossible(NinedtactError):
    """Fewer than one process."""


def as_done(function: Callable[..., Result], jobs: list[tuple[Any, ...]], workers: int) -> Iterator[tuple[int, Result]]:
    """Each job's number and result, as they come; joblib's processes where there are several."""
    if workers < 1:
        raise WorkersImpossible(f"expected at least 1 worker, got {workers}; give one for each core")
    if workers == 1 or len(jobs) < 2:
        yield from ((number, function(*job)) for number, job in enumerate(jobs))
        return
    from joblib import Parallel, delayed

    numbered = (delayed(with_number)(number, function, job) for number, job in enumerate(jobs))
    yield from Parallel(n_jobs=workers, return_as="generator_unordered")(numbered)


def with_number(number: int, function: Callable[..., Result], job: tuple[Any, ...]) -> tuple[int, Result]:
    """A result that knows whose it is."""
    return number, function(*job)

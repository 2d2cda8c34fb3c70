"""Time functions of several processes in turns.

Each contestant has a process, and so memory, of its own, as when a user runs it alone; a burst of calls of one, then a burst of the
next, over and over, lets whatever else the machine does meet all alike. Every burst begins with calls that do not count.
"""

import multiprocessing
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from time import perf_counter_ns, thread_time_ns

import numpy as np

Tasks = dict[str, Callable[[int], object]]
"""Functions of the call's number, by name."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
WARM_UP, BURST = 2, 6


@dataclass(frozen=True)
class Times:
    """Milliseconds of every call."""

    wall_ms: np.ndarray
    cpu_ms: np.ndarray
    """Of the thread alone: what others do meanwhile does not count."""

    @property
    def least_ms(self) -> float:
        return float(self.wall_ms.min())

    @property
    def median_cpu_ms(self) -> float:
        return float(np.median(self.cpu_ms))


def in_turns(
    contestants: dict[str, Callable[[], Tasks]], rounds: int, quick: bool = False
) -> dict[tuple[str, str], Times]:
    """Return times by (contestant, task); `quick` calls every task a few times in this process instead."""
    if quick:
        tasks = {(who, name): task for who, make in contestants.items() for name, task in make().items()}
        return {
            name: Times(*(np.array([timed(task, call) for call in range(2)]) / 1e6).T) for name, task in tasks.items()
        }
    os.environ.update(ONE_THREAD)
    with started(contestants) as links:
        names = {(who, task): link for who, link in links.items() for task in link.recv()}
        taken: dict[tuple[str, str], list[tuple[int, int]]] = {name: [] for name in names}
        for _ in range(rounds):
            for (who, task), link in names.items():
                link.send(task)
                taken[who, task] += link.recv()
        return {name: Times(*(np.array(times) / 1e6).T) for name, times in taken.items()}


@contextmanager
def started(contestants: dict[str, Callable[[], Tasks]]) -> Iterator[dict[str, Connection]]:
    """A fresh process for each; all are ended at the end."""
    context = multiprocessing.get_context("spawn")
    pipes = {who: context.Pipe() for who in contestants}
    processes = [
        context.Process(target=serve, args=(pipes[who][1], make), daemon=True) for who, make in contestants.items()
    ]
    for process, (_, far_end) in zip(processes, pipes.values(), strict=True):
        process.start()
        far_end.close()  # else the death of a process would leave us waiting for its answer
    try:
        yield {who: pipe[0] for who, pipe in pipes.items()}
    finally:
        for process in processes:
            process.terminate()


def serve(link: Connection, make: Callable[[], Tasks]) -> None:
    """Tell the tasks, then time a burst of whichever is asked for."""
    import cv2

    cv2.setNumThreads(1)
    tasks = make()
    link.send(list(tasks))
    while True:
        task = tasks[link.recv()]
        link.send([timed(task, call) for call in range(WARM_UP + BURST)][WARM_UP:])


def timed(task: Callable[[int], object], call: int) -> tuple[int, int]:
    """Nanoseconds on the wall and of this thread."""
    wall, cpu = perf_counter_ns(), thread_time_ns()
    task(call)
    cpu_end = thread_time_ns()
    return perf_counter_ns() - wall, cpu_end - cpu

"""Runs a function on a stranger's file in a process of its own, with a limit of memory and time.

Meshes and networks are read by libraries whose cost no check of ours can predict, and which no signal interrupts. In a process of
its own a file can neither exhaust the memory of the program, nor keep its other threads or Ctrl-C waiting. The limit of memory
holds on Linux, that of time everywhere. One file is read at a time.
"""

import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen, TimeoutExpired
from threading import Lock
from typing import Any, TypeVar, cast

from ninedtact.errors import FileFormatError

Result = TypeVar("Result")
_LEAST_BYTES, _BYTES_PER_BYTE = 300_000_000, 10
_LEAST_S, _BYTES_PER_S = 6.0, 5e6
_START_S = 10.0
"""Time in which a computer starts the process and its libraries."""
_BUSY_FACTOR = 1 if sys.platform == "win32" else 8
"""How much longer is waited for a process whose own processor time is limited, because other programs may take the rest."""
_ONE_AT_A_TIME = Lock()


class FileTooCostly(FileFormatError):
    """Raised for a file that needs more memory or time than files of its size do."""


def run_limited(function: Callable[..., Result], *arguments: Any, file_bytes: int) -> Result:
    """Return what a function of a module returns, called in a process of its own; raises what it raises, and `FileTooCostly`."""
    memory = _LEAST_BYTES + _BYTES_PER_BYTE * file_bytes
    seconds = max(_LEAST_S, file_bytes / _BYTES_PER_S)
    program = (
        f"import sys; sys.path[:] = {sys.path!r}; import {__name__} as limited; limited._serve({memory}, {seconds})"
    )
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    with (
        _ONE_AT_A_TIME,
        Popen(
            [sys.executable, "-c", program], stdin=PIPE, stdout=PIPE, stderr=DEVNULL, env={**os.environ, **threads}
        ) as child,
    ):
        try:
            answer, _ = child.communicate(pickle.dumps((function, arguments)), (seconds + _START_S) * _BUSY_FACTOR)
        except TimeoutExpired:
            answer = b""
        finally:
            child.kill()
    has_failed, value = pickle.loads(answer) if answer else (True, MemoryError())
    if has_failed and isinstance(value, MemoryError):
        raise FileTooCostly(
            expected=f"a file that is read with {memory / 1e6:.0f} MB of memory within {seconds:.0f} s",
            got="one that needs more",
            remedy="simplify it, or export it again",
        )
    if has_failed:
        raise value
    return cast(Result, value)


def _serve(memory: int, seconds: float) -> None:
    """Answer the request on standard input, in the process of its own."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print
    function, arguments = pickle.load(sys.stdin.buffer)
    _limit(memory, seconds)
    try:
        outcome = False, function(*arguments)
    except Exception as error:
        outcome = True, error
    answer.write(pickle.dumps(outcome))
    answer.flush()
    os._exit(0)


def _limit(memory: int, seconds: float) -> None:
    """Limit what this process takes from now on."""
    with suppress(ImportError, OSError, ValueError, StopIteration):
        import resource  # not on Windows

        used_s = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        resource.setrlimit(resource.RLIMIT_CPU, (round(used_s + seconds), round(used_s + seconds) + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        status = Path("/proc/self/status").read_text()  # of Linux
        used = next(int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmData"))
        resource.setrlimit(resource.RLIMIT_DATA, (used + memory, used + memory))

"""Damage to files, as Hypothesis draws it, and a command that runs on a damaged file in a process of its own."""

import io
import json
import os
import re
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from hypothesis import strategies as st

from ninedtact.cli import main as run_command
from ninedtact.errors import NinedtactError

LONGEST_S, MOST_BYTES = 20, 12 << 30
"""Processor time after which a case counts as one that does not end, and its address space: what reads without end fails there."""
NUMBER = re.compile(rb"(?<![\w.\"/-])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?![\w.\"/:-])")
"""A number of TOML, JSON or CSV that is no part of a word, a path or a date."""
FACTORS = (0.0, -1.0, 10.0, 0.1, 1.3, 1e6, 1e-9, 1e30)
WORDS = (b"nan", b"inf", b"-inf", b"NaN", b"Infinity", b'"many"', b"true", b"[1.0, 2.0]")
PLACES = ("missing", "folder", "pipe", "device", "unreadable")
"""What stands in place of a file."""


@st.composite
def damaged_bytes(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Flip a bit; cut; zero, insert, exchange or append bytes: anywhere, or near either end, where files say what they hold."""
    span = draw(st.sampled_from((len(content), min(len(content), 6000))))
    at = draw(st.integers(0, span - 1))
    at = draw(st.sampled_from((at, len(content) - 1 - at)))
    size = draw(st.integers(1, 64))
    other, tail = draw(st.binary(min_size=size, max_size=size)), content[at + size :]
    changes = {
        "bit flipped": bytes([content[at] ^ 1 << size % 8]) + content[at + 1 :],
        "cut": b"",
        "zeros": bytes(len(content[at : at + size])) + tail,
        "inserted": other + content[at:],
        "exchanged": other + tail,
        "appended": content[at:] + other,
    }
    name = draw(st.sampled_from(("bit flipped", *changes)))
    return f"{name} at byte {at}", content[:at] + changes[name]


@st.composite
def damaged_text(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Another number or word in place of a number; a line left out, repeated, renamed or added."""
    numbers = list(NUMBER.finditer(content))
    if numbers and draw(st.integers(0, 4)):
        found = draw(st.sampled_from(numbers))
        value, whole = float(found[0]), found[0].lstrip(b"-").isdigit()
        scaled = [value * factor for factor in FACTORS]
        other = draw(
            st.sampled_from([(str(int(one)) if whole else repr(one)).encode() for one in scaled] + list(WORDS))
        )
        line = content.count(b"\n", 0, found.start()) + 1
        return f"{found[0].decode()} becomes {other.decode()} in line {line}", content[
            : found.start()
        ] + other + content[found.end() :]
    lines = content.splitlines(keepends=True)
    at = draw(st.integers(0, len(lines) - 1))
    changes = {
        "left out": b"",
        "repeated": lines[at] * 2,
        "renamed": b"x" + lines[at],
        "added to": lines[at] + b"new = 1\n",
    }
    name = draw(st.sampled_from(list(changes)))
    return f"line {at + 1} {name}", b"".join([*lines[:at], changes[name], *lines[at + 1 :]])


@st.composite
def damaged_array(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Another array in a .npy file: of other numbers, another shape or another type."""
    array = np.load(io.BytesIO(content))
    one, spoilt = array.astype(float), array.astype(float)
    spoilt.flat[draw(st.integers(0, one.size - 1))] = draw(st.sampled_from((np.nan, np.inf, -1e3, 1e12)))
    changes = {
        "one number": spoilt,
        "x": one * draw(st.sampled_from((10, 0.1, 1.3, -1, 1e6))),
        "constant": np.full_like(one, draw(st.sampled_from((0, 1, -1, 1e6)))),
        "reversed": np.flip(array),
        "transposed": array.T.copy(),
        "half": array[: len(array) // 2],
        "nothing": array[:0],
        "one dimension more": array[None],
        "twice": np.concatenate([array, array]),
        "type": array.astype(draw(st.sampled_from(("i1", "u1", "?", "U", "c16")))),
    }
    name = draw(st.sampled_from(list(changes)))
    stream = io.BytesIO()
    np.save(stream, changes[name], allow_pickle=False)
    return name, stream.getvalue()


def put(path: Path, place: str) -> None:
    """Put something that is no file, or none that can be read, in place of a file."""
    content = path.read_bytes()
    path.unlink()
    if place == "folder":
        path.mkdir()
    elif place == "pipe":
        os.mkfifo(path)
    elif place == "device":
        path.symlink_to("/dev/zero")
    elif place == "unreadable":
        path.write_bytes(content)
        path.chmod(0)


def restore(path: Path, content: bytes) -> None:
    """Put the file back."""
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)
    path.write_bytes(content)


@dataclass(frozen=True)
class Kind:
    """One file that commands read."""

    path: Path
    work: Callable[[Path], int]
    """Gets a folder for its results, prints JSON, and returns an exit code."""
    damage: Callable[[bytes], st.SearchStrategy[tuple[str, bytes]]] = damaged_bytes
    part: bytes | None = None
    """The part that is damaged; None for the whole file."""
    whole: Callable[[bytes], bytes] = bytes
    """Makes the file of a damaged part."""
    is_authored: bool = False


def commands(*lines: str) -> Callable[[Path], int]:
    """Return command lines as one function; OUT in them stands for the folder of results."""

    def work(out: Path) -> int:
        return next((code for line in lines if (code := run_command(line.replace("OUT", f"{out}/x").split()))), 0)

    return work


def printing(read: Callable[[Path], Any]) -> Callable[[Path], int]:
    """Return a call of the library that prints what it reads, and ends as a command does where it is refused."""

    def work(out: Path) -> int:
        try:
            print(json.dumps(read(out), default=str))
        except NinedtactError as refusal:
            print(f"ninedtact: {refusal}", file=sys.stderr)
            return 1
        return 0

    return work


@dataclass(frozen=True)
class Run:
    """How a process ended, and what it printed."""

    code: int
    """The exit code; negative where a signal ended it."""
    printed: str
    complaints: str
    cpu_s: float = 0.0
    """Processor time, that of its own processes included."""
    grown_bytes: int = 0
    """Largest memory beyond that with which it began."""


def run_forked(work: Callable[[Path], int], folder: Path, unprivileged: bool = False) -> Run:
    """Do work in a process of its own, with a limit of time and memory. unprivileged: also as a user who may not read all."""
    with TemporaryDirectory(dir=folder) as name:
        out = Path(name)
        for path in (folder, out):
            path.chmod(0o777)
        child = os.fork()
        if child == 0:
            _work_and_leave(work, out, unprivileged)
        signal.signal(signal.SIGALRM, lambda *_: os.kill(child, signal.SIGKILL))
        signal.alarm(10 * LONGEST_S)
        _, status, used = os.wait4(child, 0)
        signal.alarm(0)
        printed, complaints = ((out / each).read_text(errors="replace") for each in ("stdout", "stderr"))
        grown_bytes = 1024 * used.ru_maxrss - int((out / "began").read_text())
        return Run(os.waitstatus_to_exitcode(status), printed, complaints, used.ru_utime + used.ru_stime, grown_bytes)


def _resident_bytes() -> int:
    """Return the memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1]) if sys.platform == "linux" else 0
    return pages * resource.getpagesize()


def _work_and_leave(work: Callable[[Path], int], out: Path, unprivileged: bool) -> None:
    """Work in the child and end it; a traceback is exit code 70."""
    (out / "began").write_text(str(_resident_bytes()))
    code = 70
    try:
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(out / name, os.O_WRONLY | os.O_CREAT), number)
        sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
        resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S + 5))
        if unprivileged and os.geteuid() == 0:
            os.seteuid(65534)
        code = work(out)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)

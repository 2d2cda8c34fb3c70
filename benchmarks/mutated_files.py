"""Files that lie: every kind of file that the program reads, mutated; what the commands answer is counted.

Each case runs the commands in a process of its own, on one mutated file. A case is answered well if the file is refused in one
sentence with exit code 1, if the answer carries a warning that the unmutated file's does not, or if the answer is that of the
unmutated file: within three of its stated standard deviations, or exactly where none is stated. Designs and tables of predictions
are what their authors write: another possible number there is another design, and is counted by itself. Everything else is answered
badly: a traceback, a process that dies or does not end, a different answer without a warning.
"""

import io
import json as json_text
import os
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import tyro
from file_mutations import Mutation, remove

from ninedtact.cli import main as run_command
from ninedtact.errors import NinedtactError

LONGEST_S, LONGEST_BY_THE_CLOCK_S = 20, 120.0
"""Processor time, and time on a busy machine, after which a case counts as one that does not end; the slowest good one takes a few
seconds."""
MOST_BYTES = 12 << 30
"""Address space of a case: a command that reads without end fails there, and not the machine."""
STDS = 3.0
NOBODY = 65534
VERDICTS = ("refused", "warned", "same answer", "taken as written", "badly")
VOLATILE = ("image", "time_ns", "files", "folder", "report", "sensor", "out")
"""Keys whose values are paths or the time of day."""


@dataclass(frozen=True)
class FileKind:
    """One file that commands read."""

    name: str
    path: Path
    mutations: Sequence[Mutation]
    commands: Sequence[Callable[[Path], int]]
    """Each gets a folder for its results, prints JSON, and returns its exit code."""
    is_authored: bool = False
    """Whether every possible number in it is right, because a person or another program states it."""


@dataclass(frozen=True)
class Run:
    """What a process printed and how it ended."""

    code: int
    """The exit code; negative where a signal ended it, −SIGXCPU where it did not end."""
    printed: str
    complaints: str


@dataclass(frozen=True)
class Answer:
    """The figures that commands printed, with their stated standard deviations, and their warnings."""

    figures: dict[str, tuple[Any, float]]
    warnings: Counter[str]


@dataclass
class Tally:
    """Verdicts on the mutations of one kind of file."""

    name: str
    verdicts: Counter[str] = field(default_factory=Counter)
    bad: list[str] = field(default_factory=list)
    """Each bad case in words."""


def mutated_files(cases: int = 2100, seed: int = 0, only: str = "", json: bool = False) -> None:
    """Mutate files, run the commands, print the table; exit code 1 where a case is answered badly."""
    from mutated_kinds import file_kinds, make_sensor

    cv2.setNumThreads(1)
    with TemporaryDirectory(prefix="mutated_") as name:
        folder = Path(name)
        sensor = make_sensor(folder / "sensor")
        kinds = [kind for kind in file_kinds(sensor, folder, cases, seed) if only in kind.name]
        tallies = [tally_kind(kind, folder) for kind in kinds]
    if json:
        print(json_text.dumps([{"kind": one.name, **one.verdicts, "bad": one.bad} for one in tallies], indent=1))
    else:
        print("\n".join(table_lines(tallies)))
    sys.exit(1 if any(tally.bad for tally in tallies) else 0)


def table_lines(tallies: Sequence[Tally]) -> Iterator[str]:
    """Yield the table in Markdown, and below it every bad case."""
    yield "| kind of file | cases | " + " | ".join(VERDICTS) + " |"
    yield "|---|" + "---:|" * (len(VERDICTS) + 1)
    total = Tally("all", sum((tally.verdicts for tally in tallies), Counter()))
    for tally in [*tallies, total]:
        counts = [tally.verdicts.total(), *(tally.verdicts[verdict] for verdict in VERDICTS)]
        yield f"| {tally.name} | " + " | ".join(map(str, counts)) + " |"
    yield from (f"BADLY: {tally.name}, {case}" for tally in tallies for case in tally.bad)


def tally_kind(kind: FileKind, folder: Path) -> Tally:
    """Judge all mutations of one kind of file; the file is restored in the end."""
    content = kind.path.read_bytes()
    with TemporaryDirectory(dir=folder) as name:  # once here, so that no case has to import what it needs
        quietly(lambda: [command(Path(name)) for command in kind.commands])
    pristine = run_forked(kind.commands, folder)
    usual, tally = answer_of(pristine), Tally(kind.name)
    if usual is None:
        raise RuntimeError(f"expected an answer for the unmutated {kind.path}, got {pristine}")
    began = time.monotonic()
    for mutation in kind.mutations:
        kind.path.unlink()
        try:
            mutation.put(kind.path, content)
            run = run_forked(kind.commands, folder, unprivileged=mutation.place == "unreadable")
        finally:
            remove(kind.path)
            kind.path.write_bytes(content)
        verdict, reason = judge(run, usual, kind.is_authored)
        tally.verdicts[verdict] += 1
        if verdict == "badly":
            tally.bad.append(f"{mutation.name}: {reason}")
            print(f"BADLY: {kind.name}, {tally.bad[-1]}", file=sys.stderr, flush=True)
    took_s = time.monotonic() - began
    print(f"{kind.name}: {dict(tally.verdicts)} in {took_s:.0f} s", file=sys.stderr, flush=True)
    return tally


def run_forked(commands: Sequence[Callable[[Path], int]], folder: Path, unprivileged: bool = False) -> Run:
    """Run commands one after the other in a process of their own, until one of them fails."""
    with TemporaryDirectory(dir=folder) as name:
        out, printed, complaints = Path(name) / "results", Path(name) / "stdout", Path(name) / "stderr"
        out.mkdir()
        for path in (folder, Path(name), out):
            path.chmod(0o777)
        child = os.fork()
        if child == 0:
            _run_and_leave(commands, out, printed, complaints, unprivileged)
        code = _wait(child)
        return Run(code, *(path.read_text(errors="replace") for path in (printed, complaints)))


def _run_and_leave(
    commands: Sequence[Callable[[Path], int]], out: Path, printed: Path, complaints: Path, unprivileged: bool
) -> None:
    """Run the commands in the child and end it; a traceback is exit code 70."""
    code = 70
    try:
        for number, path in ((1, printed), (2, complaints)):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
        sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
        resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S + 5))
        if unprivileged and os.geteuid() == 0:
            os.seteuid(NOBODY)
        code = next((failed for command in commands if (failed := command(out))), 0)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _wait(child: int) -> int:
    """Return the exit code of the child, which is ended after `LONGEST_BY_THE_CLOCK_S`."""
    deadline = time.monotonic() + LONGEST_BY_THE_CLOCK_S
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.004)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -signal.SIGXCPU


def judge(run: Run, usual: Answer, is_authored: bool) -> tuple[str, str]:
    """Return the verdict on one case, and what is wrong where it is answered badly."""
    said = [line for line in run.complaints.splitlines() if line.strip()]
    last = said[-1][:300] if said else "nothing said"
    if run.code == -signal.SIGXCPU:
        return "badly", f"no end after {LONGEST_S} s"
    if run.code == 1 and "Traceback" not in run.complaints and "expected" in last:
        return "refused", ""
    if run.code != 0:
        return "badly", f"exit code {run.code}, {last}"
    answer = answer_of(run)
    if answer is None:
        return "badly", "no answer in JSON"
    if answer.warnings - usual.warnings:
        return "warned", ""
    differing = next(iter(differing_figures(answer, usual)), None)
    if differing is None:
        return "same answer", ""
    return ("taken as written", "") if is_authored else ("badly", differing)


def differing_figures(answer: Answer, usual: Answer) -> Iterator[str]:
    """Yield in words each figure that differs by more than its stated standard deviations allow."""
    for name in {**usual.figures, **answer.figures}:
        missing = "nothing", 0.0
        (value, std), (before, std_before) = answer.figures.get(name, missing), usual.figures.get(name, missing)
        if isinstance(value, int | float) and isinstance(before, int | float):
            same = (
                abs(value - before) <= STDS * std + 1e-9 * abs(before)
                and std <= 2 * std_before + 1e-9
                and std >= std_before / 2
            )
        else:
            same = value == before
        if not same:
            yield f"{name} of {value} ± {std:.3g} in place of {before} ± {std_before:.3g}"


def answer_of(run: Run) -> Answer | None:
    """Return the figures and warnings of a run; None where it failed or printed no JSON."""
    if run.code != 0:
        return None
    warnings = Counter(line for line in run.complaints.splitlines() if line.startswith("ninedtact: "))
    figures: dict[str, tuple[Any, float]] = {}
    decoder, text, number = json_text.JSONDecoder(), run.printed.strip(), 0
    while text:
        try:
            value, end = decoder.raw_decode(text)
        except ValueError:
            return None
        text, number = text[end:].lstrip(), number + 1
        _collect(f"answer {number}", value, figures, warnings)
    return Answer(figures, warnings)


def _collect(name: str, value: Any, figures: dict[str, tuple[Any, float]], warnings: Counter[str]) -> None:
    """Add the figures and warnings of a JSON value."""
    if isinstance(value, dict):
        if value.get("finished") is False:
            warnings["cut short"] += 1
        std = _stated_stds(value)
        for key, part in value.items():
            if key in ("warnings", "notices", "findings", "faults"):
                warnings.update(map(str, part if isinstance(part, list) else [f"{k} {n}" for k, n in part.items()]))
            elif std and key in std:
                error = value[std[key]]
                figures[f"{name}, {key}"] = (part, float("inf") if error is None else error)
            elif not std and key not in VOLATILE:
                _collect(f"{name}, {key}", part, figures, warnings)
    elif isinstance(value, list):
        for number, part in enumerate(value):
            _collect(f"{name} {number}", part, figures, warnings)
    else:
        figures[name] = (value, 0.0)


def _stated_stds(row: dict[str, Any]) -> dict[str, str]:
    """Return the figures of a row whose standard deviations it states, with the names of those; the row's others do not count."""
    if "eFz" in row:
        return {name: f"e{name[:2]}" for name in ("Fx_N", "Fy_N", "Fz_N", "Tx_Nm", "Ty_Nm", "Tz_Nm")}
    if "max_indentation_error_mm" in row:
        return {"max_indentation_mm": "max_indentation_error_mm"}
    return {}


def command(*words: str | Path) -> Callable[[Path], int]:
    """Return a command line as a function; the word OUT in it stands for the folder of results."""
    return lambda out: run_command([str(out / "x") if word == "OUT" else str(word) for word in words])


def refusing(work: Callable[[Path], int]) -> Callable[[Path], int]:
    """Return work of the library that ends as a command does where it is refused."""

    def run(out: Path) -> int:
        try:
            return work(out)
        except NinedtactError as refusal:
            print(f"ninedtact: {refusal}", file=sys.stderr)
            return 1

    return run


def quietly(work: Callable[[], object]) -> None:
    """Do work whose output nobody needs."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        work()


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    tyro.cli(mutated_files)

"""What the tests of a package execute without a mutation, and whether they notice one: in processes that are forked from one that
has imported the large libraries.
"""

import hashlib
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from compileall import compile_dir
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import coverage
import pytest
from mutations import Mutation

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src" / "ninedtact"
MOST_BYTES = 16 << 30
"""Address space of a mutant: one that allocates without end fails there, and not the machine."""
LEAST_LIMIT_S = 30.0
LIMIT_FACTOR = 5.0
"""A mutant ends in this many times the time that its tests take without it, or counts as killed."""
_LIBRARIES = (
    *(
        "numpy",
        "scipy.fft",
        "scipy.interpolate",
        "scipy.linalg",
        "scipy.ndimage",
        "scipy.optimize",
        "scipy.sparse.linalg",
    ),
    *(
        "scipy.spatial",
        "scipy.special",
        "scipy.stats",
        "cv2",
        "matplotlib.pyplot",
        "hypothesis",
        "beartype",
        "jaxtyping",
    ),
    *("msgspec", "jinja2", "mcap.reader", "rosbags.typesys", "trimesh", "pyarrow.parquet", "onnxruntime", "torch"),
)


def preload() -> None:
    """Import what most tests need: a forked process then starts at once."""
    for name in _LIBRARIES:
        with suppress(ImportError):
            import_module(name)


@dataclass(frozen=True)
class Package:
    """What is mutated, and the tests that must notice."""

    sources: tuple[str, ...]
    """Patterns below the package's sources."""
    tests: str
    """Folder of its tests."""
    own: str = "**/test_*.py"
    """Pattern of its own tests in it."""
    left_alone: tuple[str, ...] = ()
    """Files that only arrange a page or a plot for the eye."""


def source_files(package: Package) -> list[Path]:
    """Return the files of a package that are mutated."""
    left_alone = {path for pattern in package.left_alone for path in SOURCES.glob(pattern)}
    return sorted({path for pattern in package.sources for path in SOURCES.glob(pattern)} - left_alone)


class SourceTree:
    """A temporary copy of sources and tests, in which one file at a time is mutated."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.on_path = folder, folder / "src"
        self.source = self.on_path / SOURCES.name
        shutil.copytree(SOURCES, self.source, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copytree(ROOT / "tests", folder / "tests")
        shutil.copy(ROOT / "pyproject.toml", folder)
        (folder / "docs").symlink_to(ROOT / "docs")
        compile_dir(self.source, quiet=1)

    def mutate(self, mutation: Mutation) -> None:
        """Write one mutated file, and remove what was compiled of it."""
        path = self.source / mutation.path
        path.write_bytes(mutation.apply((SOURCES / mutation.path).read_bytes()))
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
            compiled.unlink()

    def restore(self, mutation: Mutation) -> None:
        """Put the original back."""
        shutil.copy2(SOURCES / mutation.path, self.source / mutation.path)


@dataclass
class Baseline:
    """What the tests of a package execute, and how long they take, without a mutation."""

    duration_s: dict[str, float] = field(default_factory=dict)
    """Of every test that passes."""
    tests_by_line: dict[str, dict[int, set[str]]] = field(default_factory=dict)
    """Tests that execute a line, by path of the source file."""

    def tests_of(self, mutation: Mutation) -> list[str]:
        """Return the tests that execute the mutated line; of a line that runs at import, those that execute its file."""
        by_line = self.tests_by_line.get(mutation.path, {})
        if mutation.at_import:
            return self._fast_first(set(self.tests_by_file.get(mutation.path, set())))
        lines = next((line for line in mutation.lines if by_line.get(line)), None)
        return self._fast_first(by_line[lines]) if lines else []

    def other_tests_of_file(self, mutation: Mutation, without: list[str]) -> list[str]:
        """Return the other tests that execute the file: a fixture may have run the line for them."""
        return self._fast_first(self.tests_by_file[mutation.path] - set(without))

    @cached_property
    def tests_by_file(self) -> dict[str, set[str]]:
        """Tests that execute something of a file besides its import."""
        return {path: set().union(*lines.values()) for path, lines in self.tests_by_line.items() if lines}

    def _fast_first(self, tests: set[str]) -> list[str]:
        return sorted(tests & self.duration_s.keys(), key=lambda test: (self.duration_s[test], test))


def survives(mutation: Mutation, tree: SourceTree, baseline: Baseline, tests_s: float) -> bool:
    """Return whether no test notices a mutant."""
    covering = baseline.tests_of(mutation)
    chosen = list(covering)
    total_s = sum(baseline.duration_s[test] for test in covering)
    for test in baseline.other_tests_of_file(mutation, covering):
        total_s += baseline.duration_s[test]
        if total_s > tests_s:
            break
        chosen.append(test)
    total_s = sum(baseline.duration_s[test] for test in chosen)
    tree.mutate(mutation)
    try:
        status = _run_forked(lambda: _run_tests(tree, chosen), limit_s=LEAST_LIMIT_S + LIMIT_FACTOR * total_s)
    finally:
        tree.restore(mutation)
    if status == pytest.ExitCode.NO_TESTS_COLLECTED:
        raise SystemExit(f"expected {len(chosen)} tests for {mutation.path}:{mutation.line}, found none of them")
    return status == 0


def run_baseline(tree: SourceTree, package: Package, results: Path) -> Baseline:
    """Return what the tests of a package execute, file by file; what a file of tests executes is kept until something changes."""
    baseline, failed = Baseline(), list[str]()
    for path in sorted((tree.folder / "tests" / package.tests).glob(package.own)):
        read = json.loads(_keep_baseline(tree, path, results).read_text())
        failed += read["failed"]
        baseline.duration_s |= read["duration_s"]
        for source, lines in read["lines"].items():
            for line, tests in lines.items():
                found = baseline.tests_by_line.setdefault(source, {}).setdefault(int(line), set())
                found |= set(tests) - set(read["failed"])
    if failed:
        print(f"left out, as they fail without a mutation: {', '.join(sorted(failed))}")
    return baseline


def _keep_baseline(tree: SourceTree, tests: Path, results: Path) -> Path:
    """Return the file with what one file of tests executes, which is run if it, a helper of it or a source has changed."""
    helpers = [path for path in tests.parent.glob("*.py") if not path.name.startswith("test_")]
    read = [*sorted(SOURCES.rglob("*.py")), *sorted(helpers), tree.folder / "tests" / "conftest.py", tests]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in read)).hexdigest()[:16]
    kept = results / f"baseline_{tests.stem}_{digest}.json"
    if not kept.is_file():
        report = tree.folder / "baseline.json"
        report.unlink(missing_ok=True)
        files = [str(tests.relative_to(tree.folder))]
        if _run_forked(lambda: _run_covered(tree, files, report), limit_s=3600) is None or not report.is_file():
            raise SystemExit(f"expected the tests in {tests} to run, got no result")
        shutil.copy(report, kept)
    return kept


def _run_forked(run: Callable[[], int], limit_s: float) -> int | None:
    """Run a function in a process of its own; return its status, or None where it did not end in time or died."""
    child = os.fork()
    if child == 0:
        status = 70
        try:
            os.setsid()
            resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
            silent = os.open(os.devnull, os.O_RDWR)
            for stream in range(3):
                os.dup2(silent, stream)
            status = run()
        finally:
            os._exit(status)
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            _kill_session(child)
            return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else None
        time.sleep(0.02)
    _kill_session(child)
    os.waitpid(child, 0)
    return None


def _kill_session(leader: int) -> None:
    """Kill what a process has started, and itself."""
    with suppress(ProcessLookupError):
        os.killpg(leader, signal.SIGKILL)


def _run_tests(tree: SourceTree, tests: list[str], *plugins: Any) -> int:
    """Run tests against the copied sources, in this order, until one fails; return the exit status of pytest."""
    sys.path.insert(0, str(tree.on_path))
    os.environ["PYTHONPATH"] = str(tree.on_path)
    os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = str(tree.folder / "hypothesis")
    os.environ.setdefault("NINEDTACT_REAL_DATA", str(ROOT.parent / "shared" / "real"))
    os.chdir(tree.folder)
    files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
    stop = () if plugins else ("-x",)
    arguments = ["-p", "no:cacheprovider", "-p", "no:cov", f"--basetemp={tree.folder / 'work'}", "--hypothesis-seed=0"]
    return int(pytest.main([*arguments, *stop, *files], plugins=[*(plugins or [_ChosenTests(tests)])]))


class _ChosenTests:
    """A plugin that keeps only the chosen tests, in their order."""

    def __init__(self, tests: list[str]) -> None:
        self._place = {test: place for place, test in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted(
            (item for item in items if item.nodeid in self._place), key=lambda item: self._place[item.nodeid]
        )


def _run_covered(tree: SourceTree, files: list[str], report: Path) -> int:
    """Run all tests with coverage, and write what they execute, how long they take and which fail."""
    measured = coverage.Coverage(data_file=None, source=[str(tree.source)], config_file=False)
    recorder = _Recorder(measured)
    measured.start()
    status = _run_tests(tree, files, recorder)
    measured.stop()
    data = measured.get_data()
    lines = {
        str(Path(path).relative_to(tree.source)): {
            line: tests
            for line, contexts in data.contexts_by_lineno(path).items()
            if (tests := [*filter(None, contexts)])
        }
        for path in data.measured_files()
    }
    report.write_text(json.dumps({"duration_s": recorder.duration_s, "failed": recorder.failed, "lines": lines}))
    return status


class _Recorder:
    """A plugin that names the running test to the coverage, and keeps its duration."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self._measured, self.failed = measured, list[str]()
        self.duration_s: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._measured.switch_context(item.nodeid)
        result = yield
        self._measured.switch_context("")
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and report.nodeid not in self.failed:
            self.failed.append(report.nodeid)
            self.duration_s.pop(report.nodeid, None)
        elif report.passed and report.nodeid not in self.failed:
            self.duration_s[report.nodeid] = self.duration_s.get(report.nodeid, 0.0) + report.duration

"""Tests that notice: a random sample of single-operator mutations of each package, and how many its own tests kill.

The tests of a package run once with line coverage. Then each mutant, made in a temporary copy of the sources, meets first the tests
that execute its line, then the other tests that execute its file, fast ones first, until one fails. A mutant is killed by a failing
test, by an error at import, or by not ending in time. Types are not checked at run time, which would kill a few more.
`mutations.py` says what is mutated. Survivors that are equivalent or harmless stand with their reason in `mutants_survivors.toml`;
they count as survivors. A sample is the same for the same sources, tests and seed. Run it with `make mutants`.
"""

import hashlib
import json
import os
import sys
import time
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ["JAXTYPING_DISABLE"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
os.environ["PYTHONDONTWRITEBYTECODE"] = "1"

import tyro
from mutant_runs import ROOT, Baseline, Package, SourceTree, preload, run_baseline, source_files, survives
from mutations import Mutation, find_mutations

SURVIVORS = Path(__file__).with_name("mutants_survivors.toml")
RESULTS = ROOT / "out" / "mutants"
KILLED_SHARE = 0.85
"""Share of the mutants that the tests of each package must kill."""

PACKAGES = {
    "shape": Package(("shape/*.py",), "shape"),
    "mechanics": Package(("mechanics/*.py",), "mechanics"),
    "force": Package(("force/traction/*.py", "force/contact_detection.py"), "force", own="test_*.py"),
    "calibration": Package(
        ("calibration/**/*.py",),
        "calibration",
        left_alone=("calibration/certificate/html_page.py", "calibration/certificate/plot_*.py"),
    ),
    "capture": Package(("capture/**/*.py",), "capture"),
    "recording": Package(("recording/**/*.py",), "recording"),
}


def mutants(
    package: tuple[str, ...] = tuple(PACKAGES),
    per_package: int = 25,
    seed: int = 0,
    within: str = "",
    at: tuple[str, ...] = (),
    again: bool = False,
    tests_s: float = 20.0,
) -> None:
    """Print how many mutants of each package its own tests kill, and every one that survives.

    package: names of the packages. per_package: number of mutants of each. within: only files whose path begins so
    (calibration/board). at: all mutants of these lines (shape/depth.py:51) instead of a sample. again: those that survived the
    last time instead. tests_s: time of the tests that a mutant meets at most, beside those that execute its line.
    """
    require_known(package)
    preload()
    RESULTS.mkdir(parents=True, exist_ok=True)
    reasons = survivor_reasons()
    short = []
    for name in package:
        with TemporaryDirectory(prefix="mutants_") as folder:
            tree = SourceTree(Path(folder))
            baseline = run_baseline(tree, PACKAGES[name], RESULTS)
            possible = [each for each in possible_mutations(name, baseline) if each.path.startswith(within)]
            kept = RESULTS / f"{name}.json"
            chosen = survivors_of(possible, kept) if again else sample(possible, per_package, seed)
            chosen = at_lines(possible, at) if at else chosen
            began = time.monotonic()
            survivors = []
            for mutation in show_progress(chosen):
                if survives(mutation, tree, baseline, tests_s):
                    survivors.append(mutation)
                    print_survivor(mutation, reasons.get(mutation.key))
        kept.write_text(json.dumps([mutation.key for mutation in survivors]))
        share = 1 - len(survivors) / max(len(chosen), 1)
        print(
            f"{name:12s} {len(chosen):4d} mutants {len(chosen) - len(survivors):4d} killed {len(survivors):4d} survivors"
            f" {share:7.1%}   ({time.monotonic() - began:.0f} s)"
        )
        short += [name] if share < KILLED_SHARE else []
    print(
        f"\nat least {KILLED_SHARE:.0%} killed by a package's own tests: {'NOT ' + ', '.join(short) if short else 'all'}"
    )
    sys.exit(bool(short))


def require_known(names: Iterable[str]) -> None:
    """Refuse a package that is not in the table."""
    if unknown := set(names) - set(PACKAGES):
        raise SystemExit(f"expected packages out of {', '.join(PACKAGES)}, got {', '.join(sorted(unknown))}")


def possible_mutations(name: str, baseline: Baseline) -> list[Mutation]:
    """Return the mutations of code that the package's tests execute, and print how many there are."""
    root = ROOT / "src" / "ninedtact"
    everywhere = [mutation for path in source_files(PACKAGES[name]) for mutation in find_mutations(path, root)]
    possible = [mutation for mutation in everywhere if baseline.tests_of(mutation)]
    print(
        f"{name}: {len(everywhere)} mutations, {len(possible)} of them in code that its {len(baseline.duration_s)} tests execute",
        flush=True,
    )
    return possible


def sample(possible: list[Mutation], number: int, seed: int) -> list[Mutation]:
    """Return a random sample, of which most stays the same when a few mutations come or go."""
    return sorted(possible, key=lambda each: hashlib.sha256(repr((seed, each.key)).encode()).digest())[:number]


def at_lines(possible: list[Mutation], lines: tuple[str, ...]) -> list[Mutation]:
    """Return all mutations of some lines."""
    return [mutation for mutation in possible if f"{mutation.path}:{mutation.line}" in lines]


def survivors_of(possible: list[Mutation], kept: Path) -> list[Mutation]:
    """Return the mutations that survived the last time."""
    last = {tuple(key) for key in json.loads(kept.read_text())}
    return [mutation for mutation in possible if mutation.key in last]


def survivor_reasons() -> dict[tuple[str, str, str], str]:
    """Return why known survivors are equivalent or harmless, by the key of the mutation."""
    entries = tomllib.loads(SURVIVORS.read_text(encoding="utf-8"))["survivor"]
    return {(entry["file"], entry["line"], entry["mutated"]): entry["reason"] for entry in entries}


def show_progress(mutations: list[Mutation]) -> Iterator[Mutation]:
    """Yield the mutants, with a line of progress at a terminal."""
    for place, mutation in enumerate(mutations, start=1):
        if sys.stderr.isatty():
            print(
                f"\r{place} of {len(mutations)}: {mutation.path}:{mutation.line}".ljust(80), end="\r", file=sys.stderr
            )
        yield mutation


def print_survivor(mutation: Mutation, reason: str | None) -> None:
    """Print what no test noticed, with the reason if it is known to be harmless."""
    print(f"  {mutation.path}:{mutation.line}  {mutation.original} → {mutation.mutated}")
    print(f"      {mutation.source_line}\n      {'known: ' + reason if reason else 'NOT NOTICED'}", flush=True)


if __name__ == "__main__":
    tyro.cli(mutants)

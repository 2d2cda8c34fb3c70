"""Sources → one data set: cut into parts, made by several processes, checked, put together, and gone on with after a stop.

    sources ──parts──▶ parts/00000.pairs.parquet … ──checks──▶ report.json ──put together──▶ data/, references.parquet, README.md

Every file appears whole or not at all. A build that was killed is run again with the same words: it makes what is
missing and ends with the same data set.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.dataset.card import Contents, card, require_licence
from ninedtact.dataset.check import summed
from ninedtact.dataset.checks import CheckSettings
from ninedtact.dataset.columns import bytes_of, copy_rows, rows_of, six, write_untouched
from ninedtact.dataset.folder import BuildFolder, begin, remove_parts
from ninedtact.dataset.generation.percentiles import lines
from ninedtact.dataset.parts import PartFiles, make_part
from ninedtact.dataset.report import Report, read_report, require_usable, write_report
from ninedtact.dataset.rows import UntouchedImage, writable
from ninedtact.dataset.sources.source import Part, Source
from ninedtact.dataset.workers import as_done


@dataclass(frozen=True)
class BuildSettings:
    """What is done with the sources."""

    checks: CheckSettings = CheckSettings()
    drop: bool = False
    """Leave out the pairs that the checks list."""
    licence: str | None = None
    """Of the data, as Hugging Face names it."""

    def __post_init__(self) -> None:
        require_licence(self.licence)


@dataclass(frozen=True)
class Built:
    """A finished data set."""

    folder: Path
    report: Report
    contents: Contents


def build(
    out: Path,
    sources: Sequence[Source],
    settings: BuildSettings = BuildSettings(),
    workers: int = 1,
    *,
    progress: bool = False,
) -> Built:
    """Make a data set, or go on with one; raises `SourceUnknown`, `FolderTaken`, `NothingUsable`, `FileNotWritten`."""
    folder = BuildFolder(out)
    parts = [part for source in sources for part in source.parts()]
    begin(folder, as_table(sources, settings), sources)
    if not folder.finished:
        made_by_workers(folder, parts, settings, workers, progress)
        put_together(folder, sources, len(parts), settings)
    remove_parts(folder)
    return Built(out, read_report(folder.report), contents_of(folder))


def as_table(sources: Sequence[Source], settings: BuildSettings) -> dict[str, Any]:
    """Plain values by which the build is known again."""
    said = {it.name: f"{it.what}, {it.path.resolve()}, {it.fingerprint()}, {it.statements}" for it in sources}
    named = {f"source {name}": writable(words) for name, words in said.items()}
    return {**asdict(settings), **named}


def made_by_workers(
    folder: BuildFolder, parts: Sequence[Part], settings: BuildSettings, workers: int, progress: bool
) -> None:
    """Make the parts that are missing, in any order."""
    from tqdm import tqdm

    files = [PartFiles(folder.parts, number) for number in range(len(parts))]
    jobs = [(part, file, settings.checks) for part, file in zip(parts, files, strict=True) if not file.done]
    with tqdm(total=len(parts), initial=len(parts) - len(jobs), unit="file", disable=not progress) as bar:
        for _, pairs in as_done(make_part, jobs, workers):
            bar.set_postfix(pairs=pairs, refresh=False)
            bar.update()


def put_together(folder: BuildFolder, sources: Sequence[Source], parts: int, settings: BuildSettings) -> None:
    """Check across parts, and make one data set of them; raises `NothingUsable`, `FileNotWritten`."""
    files = [PartFiles(folder.parts, number) for number in range(parts)]
    checks = [file.check() for file in files]
    report = summed(checks, [file.pairs.name for file in files], settings.drop)
    write_report(folder.report, report)
    require_usable(report, folder.report)
    unwanted = unwanted_rows(report) if settings.drop else {}
    kept = [
        file
        for file, check in zip(files, checks, strict=True)
        if len(check.ids) > len(unwanted.get(file.pairs.name, ()))
    ]
    for number, file in enumerate(kept):
        move_pairs(file.pairs, folder.pairs(number, len(kept)), unwanted.get(file.pairs.name, set()))
    write_untouched(folder.references, untouched_once(files))
    text = card(contents_of(folder), sources, settings.licence, report, version("ninedtact"))
    write_file_atomically(folder.card, text.encode())


def unwanted_rows(report: Report) -> dict[str, set[int]]:
    """The rows of each part that something is against."""
    rows: dict[str, set[int]] = {}
    for finding in report.listed:
        if finding.row is not None:
            rows.setdefault(finding.part, set()).add(finding.row)
    return rows


def move_pairs(part: Path, final: Path, unwanted: set[int]) -> None:
    """A part's pairs to their place, without some; what is there already stays."""
    if final.is_file():
        return
    if unwanted:
        copy_rows(part, final, unwanted)
    else:
        part.replace(final)


def untouched_once(files: Sequence[PartFiles]) -> Iterator[UntouchedImage]:
    """The untouched images of all parts, each one once."""
    told: set[str] = set()
    for file in files:
        for row in rows_of(file.untouched):
            if row["reference"] not in told:
                told.add(row["reference"])
                yield UntouchedImage(row["reference"], bytes_of(row["image"]) or b"", row["sensor"])


def contents_of(folder: BuildFolder) -> Contents:
    """Count what is in the finished files."""
    return contents_in(sorted((folder.path / "data").glob("*.parquet")))


def contents_in(files: Sequence[Path]) -> Contents:
    """Count what is in these files."""
    kinds: Counter[str] = Counter()
    sensors: Counter[str] = Counter()
    objects: Counter[str] = Counter()
    wrenches: dict[bool, list[Any]] = {True: [], False: []}
    for file in files:
        for row in rows_of(file, ("kind", "sensor", "object", "wrench")):
            kind = row.get("kind") or "rule"
            kinds[kind] += 1
            sensors[row.get("sensor") or ""] += 1
            objects[row.get("object") or ""] += 1
            wrenches[kind == "rule"].append(six(row["wrench"]))
    found = np.array(wrenches[True] or wrenches[False], float).reshape(-1, 6)
    finite = found[np.isfinite(found).all(1)]
    table = list(lines(finite)) if len(finite) else ["no finite wrench"]
    return Contents(dict(sorted(kinds.items())), dict(sorted(sensors.items())), dict(sorted(objects.items())), table)

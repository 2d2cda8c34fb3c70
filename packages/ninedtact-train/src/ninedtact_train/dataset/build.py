"""Builds one data set from sources: cuts them into parts, reads these in several processes, checks and combines them.

    sources ──parts──▶ parts/00000.pairs.parquet … ──checks──▶ report.json ──combine──▶ data/, references.parquet, README.md

Every part depends on its source alone, and every file is written completely or not at all. A build that was stopped is run again
with the same arguments: it makes the parts that are missing and ends with the same data set.
"""

import shutil
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from itertools import count
from pathlib import Path
from socket import gethostname
from typing import Annotated, Any

import msgspec
from tyro.conf import arg

from ninedtact.atomic_write import write_file_atomically, write_files_atomically
from ninedtact.calibration.sensor_folder import SENSOR_FILE
from ninedtact.checked_reading import read_regular_file
from ninedtact.errors import FileFormatError, InputError
from ninedtact.parallel_jobs import DaskCluster, Workers, require_workers, run_writing_jobs
from ninedtact_train.dataset.checks import FileCheck, PairCheckSettings, check_pair_file, combine_file_checks
from ninedtact_train.dataset.dataset_card import (
    DatasetStatistics,
    compute_dataset_statistics,
    format_build_card,
    require_licence_name,
)
from ninedtact_train.dataset.fault_report import (
    PairFinding,
    QualityReport,
    read_quality_report,
    require_any_usable_pair,
    write_quality_report,
)
from ninedtact_train.dataset.folder import (
    CARD_FILE,
    REFERENCES_FILE,
    REPORT_FILE,
    SENSOR_FOLDERS,
    SENSORS_FILE,
    begin_or_resume_dataset,
    find_pair_files,
    make_folder,
    pair_file,
    to_json_bytes,
)
from ninedtact_train.dataset.parquet_files import (
    copy_pairs_without_rows,
    escape_invalid_utf8,
    iterate_rows,
    stored_image_bytes,
    write_pair_file,
    write_reference_images_file,
)
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage, SourceItem
from ninedtact_train.dataset.sources.source import Source

_PARTS_FOLDER = "parts"


@dataclass(frozen=True)
class BuildSettings:
    """How a data set is built from its sources; raises `InputError`."""

    checks: Annotated[PairCheckSettings, arg(name="limits")] = PairCheckSettings()
    drop: bool = False
    """Leave out the pairs that have faults."""
    licence: str | None = None
    """Licence of the data, as Hugging Face names it: mit, cc-by-4.0."""

    def __post_init__(self) -> None:
        require_licence_name(self.licence)


@dataclass(frozen=True)
class BuildResult:
    """A data set that was built."""

    folder: Path
    report: QualityReport
    statistics: DatasetStatistics


def build_dataset(
    out: Path,
    sources: Sequence[Source],
    settings: BuildSettings = BuildSettings(),
    workers: Workers = 1,
    *,
    progress: bool = False,
) -> BuildResult:
    """Build a data set from sources, or continue a build that was stopped.

    out: folder of the data set: new, empty, or begun with the same sources and settings. workers: number of processes, or a cluster
    whose workers read the sources at the same paths. Raises `InputError`, `OutputError`, `DatasetError`, `FileNotWritten`.
    """
    require_workers(workers)
    if isinstance(workers, DaskCluster):
        _require_absolute_paths(sources)
    is_built = (out / CARD_FILE).is_file()
    sensors = None if is_built else _collect_sensors(sources)  # refuses before anything is written
    begin_or_resume_dataset(out, _identify_build(sources, settings), [source.path for source in sources])
    if sensors is not None:
        files = _make_parts(out / _PARTS_FOLDER, sources, settings, workers, progress)
        _combine_parts(out, files, settings)
        _save_sensors(out, sensors)
        _write_card(out, sources, settings)
    shutil.rmtree(out / _PARTS_FOLDER, ignore_errors=True)
    statistics = compute_dataset_statistics(find_pair_files(out))
    return BuildResult(out, read_quality_report(out / REPORT_FILE), statistics)


def _identify_build(sources: Sequence[Source], settings: BuildSettings) -> dict[str, Any]:
    described = {
        f"source {source.name}": escape_invalid_utf8(
            f"{source.description}, {source.path.resolve()}, {source.fingerprint()}, {source.conventions}"
        )
        for source in sources
    }
    return {**asdict(settings), **described}


def _make_parts(
    folder: Path, sources: Sequence[Source], settings: BuildSettings, workers: Workers, progress: bool
) -> list["_PartFiles"]:
    from tqdm import tqdm

    make_folder(folder)
    parts = [(source, part) for source in sources for part in source.parts()]
    files = [_PartFiles(folder, number) for number in range(len(parts))]
    jobs = [(*part, file.number, settings.checks) for part, file in zip(parts, files, strict=True) if not file.is_made]
    with tqdm(total=len(parts), initial=len(parts) - len(jobs), unit="file", disable=not progress) as bar:
        for _, pairs in run_writing_jobs(_make_part, folder, jobs, workers):
            bar.set_postfix(pairs=pairs, refresh=False)
            bar.update()
    return files


@dataclass(frozen=True)
class _PartFiles:
    folder: Path
    number: int

    @property
    def pairs(self) -> Path:
        return self.folder / f"{self.number:05d}.pairs.parquet"

    @property
    def references(self) -> Path:
        return self.folder / f"{self.number:05d}.references.parquet"

    @property
    def check(self) -> Path:
        """The result of the part's check, which is written last, and whose name is the last one in the alphabet."""
        return self.folder / f"{self.number:05d}.result.json"

    @property
    def is_made(self) -> bool:
        return self.check.is_file()

    def read_check(self) -> FileCheck:
        try:
            return msgspec.json.decode(read_regular_file(self.check), type=FileCheck)
        except (OSError, ValueError, RecursionError) as trouble:
            raise FileFormatError(
                f"expected the result of a check in {self.check}, got: {trouble}; delete it, and run the command again"
            ) from trouble


def _separate_rows(
    items: Iterable[SourceItem], references: dict[str, ReferenceImage], findings: list[PairFinding]
) -> Iterator[DatasetRow]:
    """Yield the rows of a part; collect its reference images, and findings of rows and of what is rejected."""
    numbers = count()
    for item in items:
        if isinstance(item, ReferenceImage):
            references.setdefault(item.reference_id, item)
            continue
        row = None if isinstance(item, PairFinding) else next(numbers)
        for fault, message in ((item.fault, item.message),) if isinstance(item, PairFinding) else item.faults:
            findings.append(PairFinding(fault, escape_invalid_utf8(item.id), escape_invalid_utf8(message), row))
        if isinstance(item, DatasetRow):
            yield item


def _source_paths(source: Source) -> tuple[Path, ...]:
    stated = (source.conventions.reference, source.conventions.sensor)
    return (source.path, *(path for path in stated if path is not None))


def _require_absolute_paths(sources: Sequence[Source]) -> None:
    """Refuse paths that mean something else in the working folder of a cluster's worker; raises `InputError`."""
    for path in (path for source in sources for path in _source_paths(source)):
        if not path.is_absolute():
            raise InputError(
                expected="absolute paths of sources for a cluster",
                got=f"{path}",
                remedy="give the path at which every worker sees it",
            )


def _make_part(folder: Path, source: Source, part: Any, number: int, settings: PairCheckSettings) -> int:
    """Write the files of one part and return its number of pairs; raises `FileNotWritten`, `InputError`."""
    for path in _source_paths(source):
        if not path.exists():  # on a worker; a reader would list every pair as missing
            raise InputError(
                expected=f"{path} on {gethostname()}",
                got="nothing there",
                remedy="keep sources on a file system that every worker sees",
            )
    files = _PartFiles(folder, number)
    references: dict[str, ReferenceImage] = {}
    findings: list[PairFinding] = []
    write_pair_file(files.pairs, _separate_rows(source.items(part), references, findings))
    write_reference_images_file(files.references, references.values())
    check = check_pair_file(files.pairs, files.references, settings)
    check.findings = [*findings, *check.findings]
    write_file_atomically(files.check, msgspec.json.encode(check))
    return len(check.ids)


def _combine_parts(folder: Path, files: Sequence[_PartFiles], settings: BuildSettings) -> None:
    checks = [file.read_check() for file in files]
    names = [file.pairs.name for file in files] if settings.drop else _name_pair_files(folder, checks)
    report = combine_file_checks(checks, names, settings.drop)
    write_quality_report(folder / REPORT_FILE, _without_places(report) if settings.drop else report)
    require_any_usable_pair(report, folder / REPORT_FILE)
    unwanted = _rows_with_faults(report) if settings.drop else defaultdict(set)
    kept = [
        (file, unwanted[file.pairs.name])
        for file, check in zip(files, checks, strict=True)
        if len(check.ids) > len(unwanted[file.pairs.name])
    ]
    for number, (file, rows) in enumerate(kept):
        target = pair_file(folder, number, len(kept))
        if rows and not target.is_file():
            copy_pairs_without_rows(file.pairs, target, rows)
        elif not target.is_file():
            file.pairs.replace(target)
    write_reference_images_file(folder / REFERENCES_FILE, _unique_references(files))


def _name_pair_files(folder: Path, checks: Sequence[FileCheck]) -> list[str]:
    """Return the name of each part's file in a data set that leaves out no pair; empty for a part without pairs."""
    numbers, total = count(), sum(bool(check.ids) for check in checks)
    return [pair_file(folder, next(numbers), total).name if check.ids else "" for check in checks]


def _without_places(report: QualityReport) -> QualityReport:
    """Return the report of a data set that leaves out all pairs with findings, which are in none of its files."""
    findings = [msgspec.structs.replace(finding, row=None, file="") for finding in report.findings]
    return msgspec.structs.replace(report, findings=findings)


def _write_card(folder: Path, sources: Sequence[Source], settings: BuildSettings) -> None:
    """Write the data set's card, the last file of a build."""
    statistics, report = compute_dataset_statistics(find_pair_files(folder)), read_quality_report(folder / REPORT_FILE)
    card = format_build_card(statistics, sources, settings.licence, report, version("ninedtact"))
    write_file_atomically(folder / CARD_FILE, card.encode())


@dataclass(frozen=True)
class _SourceSensors:
    simulated: list[dict[str, Any]]
    """All parameters of each simulated sensor."""
    folders: dict[str, dict[str, bytes]]
    """The files of each sensor folder by the name of the sensor."""


def _collect_sensors(sources: Sequence[Source]) -> _SourceSensors:
    """Return the simulated sensors and the sensor folders that the sources carry; raises `InputError`, `FileFormatError`.

    Several simulated sensors or calibrations of one name are refused, because the images do not say which one is theirs. Only the
    calibrations of a simulated sensor may differ; they are left out, because it is calibrated again where it is needed.
    """
    simulated: dict[str, dict[str, Any]] = {}
    for table, path in ((table, source.path) for source in sources for table in source.simulated_sensors()):
        if simulated.setdefault(table["name"], table) != table:
            raise InputError(
                expected="one simulated sensor of each name",
                got=f"another {table['name']!r} in {path}",
                remedy="simulate that data set with another --seed, or build a data set of each",
            )
    first: dict[str, tuple[dict[str, bytes], Path]] = {}
    differing = set()
    for name, files, path in (entry for source in sources for entry in source.sensor_folders()):
        known, known_path = first.setdefault(name, (files, path))
        if known.get(SENSOR_FILE) == files.get(SENSOR_FILE):
            continue
        if name not in simulated:
            raise InputError(
                expected=f"one calibration of sensor {name!r}",
                got=f"different ones in {known_path} and {path}",
                remedy="give one with --sensor for all, or build a data set with each",
            )
        differing.add(name)
    folders = {name: files for name, (files, _) in first.items() if name not in differing}
    return _SourceSensors(list(simulated.values()), folders)


def _save_sensors(folder: Path, sensors: _SourceSensors) -> None:
    """Write the parameters of simulated sensors and the sensor folders into a data set; raises `FileNotWritten`."""
    if sensors.simulated:
        write_file_atomically(folder / SENSORS_FILE, to_json_bytes(sensors.simulated))
    entries = [
        (f"{name}/{path}", content)
        for name, files in sensors.folders.items()
        if Path(name).name == name and not (folder / SENSOR_FOLDERS / name).exists()
        for path, content in files.items()
    ]
    if entries:
        write_files_atomically(folder / SENSOR_FOLDERS, entries)


def _rows_with_faults(report: QualityReport) -> defaultdict[str, set[int]]:
    rows = defaultdict(set)
    for finding in report.findings:
        if finding.row is not None:
            rows[finding.file].add(finding.row)
    return rows


def _unique_references(files: Sequence[_PartFiles]) -> Iterator[ReferenceImage]:
    known: set[str] = set()
    for file in files:
        for row in iterate_rows(file.references):
            if row["reference_id"] not in known:
                known.add(row["reference_id"])
                yield ReferenceImage(row["reference_id"], stored_image_bytes(row["image"]) or b"", row["sensor"])

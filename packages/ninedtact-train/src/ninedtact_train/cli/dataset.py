"""ninedtact dataset build, check and show: pairs of image and wrench from any source, for training."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.result_and_interrupt import print_notices, print_result
from ninedtact.cli.shared_options import ClusterOption, JsonOption, WorkersOption
from ninedtact_train.dataset.build import BuildResult, BuildSettings, build_dataset
from ninedtact_train.dataset.checks import PairCheckSettings
from ninedtact_train.dataset.sources.source import SourceConventions

if TYPE_CHECKING:
    from ninedtact_train.dataset.dataset_card import DatasetStatistics

_MOST_NAMES = 8
"""Names of a kind that are printed one by one."""


@dataclass(frozen=True)
class BuildDatasetCommand:
    """Build one data set from any number of sources. After a stop, run the same command again to continue."""

    sources: tyro.conf.Positional[tuple[str, ...]]
    """PATH or NAME=PATH: recordings (.mcap), the original project's Dataset folder, force episodes (.npz), a data set."""
    out: Path
    """Folder for the data set: new, empty, or begun with the same arguments."""
    strict: bool = False
    """Exit with 1 if any fault is found."""
    workers: WorkersOption = 2
    cluster: ClusterOption = None
    conventions: Annotated[SourceConventions, tyro.conf.arg(name="")] = SourceConventions()
    settings: Annotated[BuildSettings, tyro.conf.arg(name="")] = BuildSettings()
    json: JsonOption = False

    def run(self) -> int:
        """Build it and print what is in it; raises `DatasetError`, also with `--strict`."""
        from ninedtact.parallel_jobs import connect_workers
        from ninedtact_train.dataset.fault_report import PairFault, require_no_faults
        from ninedtact_train.dataset.folder import REPORT_FILE, interrupt_as_stopped
        from ninedtact_train.dataset.sources.find_sources import find_sources

        with interrupt_as_stopped(self.out), connect_workers(self.workers, self.cluster) as workers:
            sources = find_sources(self.sources, self.conventions)
            built = build_dataset(self.out, sources, self.settings, workers, progress=not self.json)
        print_result(self.json, _build_to_json_dict(built), _format_build(built))
        print_notices(finding.message for finding in built.report.findings if finding.fault is PairFault.MISSING_END)
        if self.strict:
            require_no_faults(built.report, self.out / REPORT_FILE)
        return 0


@dataclass(frozen=True)
class CheckDatasetCommand:
    """Check every pair of a data set. Nothing is changed: `build --drop` makes a data set without the pairs that are listed."""

    folder: tyro.conf.Positional[Path]
    """The data set."""
    report: Path | None = None
    """File for the list of faults, JSON; check.json in the data set if not given."""
    strict: bool = False
    """Exit with 1 if any fault is found."""
    workers: WorkersOption = 2
    limits: PairCheckSettings = PairCheckSettings()
    json: JsonOption = False

    def run(self) -> int:
        """Check the pairs, write the list and print the counts; raises `DatasetError`, also with `--strict`."""
        from ninedtact.atomic_write import require_new_file, require_place_for_file
        from ninedtact_train.dataset.checks import check_dataset
        from ninedtact_train.dataset.fault_report import (
            require_any_usable_pair,
            require_no_faults,
            write_quality_report,
        )

        path = self.report or self.folder / "check.json"
        require_new_file(self.report, "--report")
        if self.folder.is_dir():  # a data set that is not there is said next
            require_place_for_file(path)
        report = check_dataset(self.folder, self.limits, self.workers, progress=not self.json)
        write_quality_report(path, report)
        figures = {
            "folder": str(self.folder),
            "pairs": report.pairs,
            "without_fault": report.without_fault,
            "faults": report.counts,
            "report": str(path),
        }
        listed = [f"{path} lists every finding"] if report.findings else []
        print_result(self.json, figures, [*report.summary_lines(), *listed])
        require_any_usable_pair(report, path)
        if self.strict:
            require_no_faults(report, path)
        return 0


@dataclass(frozen=True)
class ShowDatasetCommand:
    """Count the pairs of a data set, compare their wrenches with real ones, and draw some pairs."""

    folder: tyro.conf.Positional[Path]
    """The data set."""
    preview: Path | None = None
    """File for an image of some pairs, PNG; preview.png in the data set if not given."""
    pairs: int = 24
    """How many pairs are drawn, evenly spread from the lightest to the heaviest load; 0 for none."""
    json: JsonOption = False

    def run(self) -> int:
        """Count the pairs, draw some, and print the counts."""
        from ninedtact_train.dataset.dataset_card import compute_dataset_statistics
        from ninedtact_train.dataset.folder import find_pair_files

        statistics = compute_dataset_statistics(find_pair_files(self.folder))
        preview = self._draw_preview() if self.pairs > 0 else None
        figures = {
            "folder": str(self.folder),
            "pairs": statistics.pairs,
            "kinds": statistics.kinds,
            "sensors": statistics.sensors,
            "objects": statistics.objects,
            "percentiles": list(statistics.percentile_lines()),
            "preview": None if preview is None else str(preview),
        }
        return print_result(self.json, figures, _format_contents(self.folder, statistics, preview))

    def _draw_preview(self) -> Path:
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact_train.dataset.preview_image import render_preview

        path = self.preview or self.folder / "preview.png"
        write_file_atomically(path, render_preview(self.folder, self.pairs))
        return path


DatasetCommand = (
    Annotated[BuildDatasetCommand, tyro.conf.subcommand("build")]
    | Annotated[CheckDatasetCommand, tyro.conf.subcommand("check")]
    | Annotated[ShowDatasetCommand, tyro.conf.subcommand("show")]
)
"""The subcommands of `ninedtact dataset`."""
DESCRIPTION = "Data sets for training force estimation: built from any source, checked, shown."


def _build_to_json_dict(built: "BuildResult") -> dict[str, object]:
    return {
        "folder": str(built.folder),
        "pairs": built.statistics.pairs,
        "kinds": built.statistics.kinds,
        "sensors": len(built.statistics.sensors),
        "objects": built.statistics.object_count,
        "checked": built.report.pairs,
        "without_fault": built.report.without_fault,
        "faults": built.report.counts,
        "dropped": built.report.dropped,
    }


def _format_build(built: "BuildResult") -> Iterator[str]:
    statistics = built.statistics
    counted = f"{len(statistics.sensors)} sensors, {statistics.object_count} objects"
    yield f"{built.folder}: {statistics.pairs} pairs ({statistics.kind_counts_text()}), {counted}"
    yield from built.report.summary_lines()
    yield from statistics.percentile_lines()


def _format_contents(folder: Path, statistics: "DatasetStatistics", preview: Path | None) -> Iterator[str]:
    yield f"{folder}: {statistics.pairs} pairs"
    for what in ("kinds", "sensors", "objects"):
        yield f"{what}: {_format_counts(getattr(statistics, what))}"
    yield from statistics.percentile_lines()
    if preview:
        yield f"{preview} shows some pairs: red darker, green brighter than the reference image, the arrow the shear force"


def _format_counts(counts: Mapping[str, int]) -> str:
    """Return the most frequent names with their counts, and how many more there are."""
    by_count = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    more = f" and {len(by_count) - _MOST_NAMES} more" if len(by_count) > _MOST_NAMES else ""
    return ", ".join(f"{count} {name or 'unnamed'}" for name, count in by_count[:_MOST_NAMES]) + more

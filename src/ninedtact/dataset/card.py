"""The data set card, README.md, for people and Hugging Face: contents of the data set, meaning of its columns, and origin."""

import json
import re
from collections.abc import Iterator, Sequence

from ninedtact.dataset.folder import REPORT_FILE
from ninedtact.dataset.generation.settings import GenerationSettings
from ninedtact.dataset.quality_report import QualityReport
from ninedtact.dataset.schema import PAIR_COLUMNS, to_utf8
from ninedtact.dataset.sources.source import Source
from ninedtact.dataset.statistics import DatasetStatistics
from ninedtact.errors import InputError

_LICENCE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")
_FRAME = (
    "Torques are about the centre of the skin without contact. Sensor frame: x along columns, y along rows, z outward through "
    "the skin."
)


class LicenceImpossible(InputError):
    """Raised for text that is not the name of a licence."""


def require_licence(licence: str | None) -> None:
    """Raise `LicenceImpossible` for text that cannot be the name of a licence."""
    if licence is not None and not _LICENCE.fullmatch(licence):
        raise LicenceImpossible(
            f"expected a licence as Hugging Face names it, such as mit or cc-by-nc-4.0, got {licence!r}; correct it"
        )


def format_build_card(
    statistics: DatasetStatistics, sources: Sequence[Source], licence: str | None, report: QualityReport, version: str
) -> str:
    """Return the card of a data set that was built from sources."""
    lines = [
        *_format_header("9DTact, images and wrenches", ("tactile-sensing", "robotics"), licence),
        "# Images and wrenches of 9DTact sensors",
        "",
        f"Built by `ninedtact dataset build` {version}: {statistics.pairs} pairs ({statistics.kind_counts_text()}) of "
        f"{len(statistics.sensors)} sensors and {statistics.object_count} objects.",
        "Licence: " + (licence or "not stated; ask the authors of the sources before you pass the data on."),
        "",
        *_format_column_table(),
        "",
        _FRAME,
        "",
        "## Sources",
        "",
    ]
    for source in sources:
        lines.append(f"- `{source.name}`: {source.description}, from `{to_utf8(source.path.resolve().name)}`")
        lines += [f"  - {statement}" for statement in source.statement_lines()]
    lines.append("")
    for source in sources:
        for warning in source.warnings:
            lines += [warning, ""]
    lines += ["## Checks", "", *_indent(report.summary_lines()), "", f"`{REPORT_FILE}` lists every finding.", ""]
    return "\n".join([*lines, *_format_percentile_section(statistics)])


def format_generation_card(
    settings: GenerationSettings, statistics: DatasetStatistics, version: str, device: str
) -> str:
    """Return the card of a data set that was generated with simulated sensors."""
    machine = "the same machine" if device == "cpu" else f"the same machine with `--device {device}`"
    lines = [
        *_format_header(
            "9DTact twin, images and wrenches", ("tactile-sensing", "robotics", "simulation"), licence=None
        ),
        "# Images and wrenches of simulated 9DTact sensors",
        "",
        f"Made by `ninedtact simulate dataset` {version}: {settings.pairs} pairs ({statistics.kind_counts_text()}) of "
        f"{settings.sensors} sensors and {len(settings.selected_objects)} objects. It contains no real image.",
        f"Images are {settings.size[0]} x {settings.size[1]} pixels and "
        f"{settings.design.sensing_area.width_mm:g} mm across. `light_touch` means |Fz| < {settings.light_below_n:g} N. There are "
        "ten steps a second. The parameters of every sensor are in `sensors.json`.",
        "",
        *_format_column_table(),
        "",
        _FRAME,
        "`wrench` is exact, as computed by the contact mechanics; a real force/torque sensor adds noise.",
        "",
        *_format_percentile_section(statistics),
        "## To make it again",
        "",
        f"The same version with these settings gives the same bytes on {machine}:",
        "",
        f"    {json.dumps(settings.to_json_dict())}",
        "",
    ]
    return "\n".join(lines)


def _format_header(title: str, tags: Sequence[str], licence: str | None) -> Iterator[str]:
    """Yield the YAML header that Hugging Face reads."""
    yield from ("---", f"pretty_name: {title}")
    if licence:
        yield f"license: {licence.lower()}"
    yield from (f"tags: [{', '.join(tags)}]", "configs:")
    for name, path in (("default", "data/train-*.parquet"), ("references", "references.parquet")):
        yield from (f"- config_name: {name}", "  data_files:", "  - split: train", f"    path: {path}")
    yield from ("---", "")


def _format_column_table() -> Iterator[str]:
    yield from ("| column | meaning |", "|---|---|")
    yield from (f"| {column.name} | {column.meaning} |" for column in PAIR_COLUMNS)


def _format_percentile_section(statistics: DatasetStatistics) -> Iterator[str]:
    yield from ("## Percentiles", "", *_indent(statistics.percentile_lines()), "")


def _indent(lines: Iterator[str]) -> Iterator[str]:
    yield from (f"    {line}".rstrip() for line in lines)

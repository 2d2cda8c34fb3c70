"""What a data set says of itself: its statistics, which are counts of kinds, sensors and objects, and percentiles of its
wrenches beside those of real ones; and its card, README.md, for people and Hugging Face: contents of the data set, meaning of
its columns, and origin.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import ForceTorqueMount
from ninedtact.errors import InputError
from ninedtact.quantities import NO_OBJECT, WRENCH_AXES, Wrench
from ninedtact.simulation.object_motions import HZ
from ninedtact_train.dataset.folder import REPORT_FILE
from ninedtact_train.dataset.generation.settings import GenerationSettings, SequenceSettings
from ninedtact_train.dataset.parquet_files import escape_invalid_utf8, read_columns, wrench_array
from ninedtact_train.dataset.schema import PAIR_COLUMNS, TRUTH_COLUMNS, Column

if TYPE_CHECKING:
    from ninedtact_train.dataset.fault_report import QualityReport
    from ninedtact_train.dataset.sources.source import Source

_RANKS = (5, 50, 95)
_FORCE_SENSOR_MM = ForceTorqueMount().origin_mm
REAL_PERCENTILES = np.array(
    [
        (-1.064, 0.146, 1.442),
        (-1.894, -0.414, 1.007),
        (-10.829, -6.965, -2.110),
        (-0.0489, 0.0134, 0.0769),
        (-0.0528, 0.0047, 0.0679),
        (-0.0079, 0.0002, 0.0076),
    ]
)
"""Percentiles 5, 50 and 95 of 10,000 real wrenches on 175 objects, N and N·m about 35 mm below the skin (docs/references.md)."""

_Percentiles = Float[Array, "6 3"]


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """Counts of the pairs of a data set by kind, sensor and object, and the percentiles of their wrenches."""

    kinds: dict[str, int]
    sensors: dict[str, int]
    objects: dict[str, int]
    rule_wrenches: Float[Array, "n 6"]
    """The finite wrenches of the pairs that the sampling rule kept, or of all pairs if it kept none; about the skin's centre."""

    @property
    def pairs(self) -> int:
        """Number of pairs of all kinds."""
        return sum(self.kinds.values())

    @property
    def object_count(self) -> int:
        """Number of different objects; the absence of an object is not counted."""
        return len(set(self.objects) - {NO_OBJECT})

    @property
    def percentiles(self) -> _Percentiles:
        """Percentiles 5, 50 and 95 of every axis about the paper's force/torque sensor; raises `IndexError` without wrenches."""
        to_force_sensor = Wrench(np.zeros(3), np.zeros(3)).shift_matrix(np.array(_FORCE_SENSOR_MM))
        return np.asarray(np.percentile(self.rule_wrenches @ to_force_sensor.T, _RANKS, axis=0).T)

    @property
    def differences_from_real_percentiles(self) -> _Percentiles:
        """Differences of the percentiles from the real ones, as parts of each axis's real span from 5 to 95."""
        return (self.percentiles - REAL_PERCENTILES) / (REAL_PERCENTILES[:, 2:] - REAL_PERCENTILES[:, :1])

    def kind_counts_text(self) -> str:
        """Return the counts by kind as one phrase."""
        return ", ".join(f"{count} {kind}" for kind, count in self.kinds.items())

    def percentile_lines(self) -> Iterator[str]:
        """Yield a table of the percentiles beside the real ones as lines of text."""
        if not len(self.rule_wrenches):
            yield "no finite wrench"
            return
        errors_percent = 100 * self.differences_from_real_percentiles
        pairs = "pairs by the rule" if "rule" in self.kinds else "pairs of all kinds"
        yield (
            f"{len(self.rule_wrenches)} {pairs}, N and N·m about {-_FORCE_SENSOR_MM[2]:g} mm below the skin; "
            "percentiles 5, 50, 95:"
        )
        yield f"    {'this data set':28}{'real':28}difference, % of the real span"
        for axis, ours, real, errors in zip(
            WRENCH_AXES, self.percentiles, REAL_PERCENTILES, errors_percent, strict=True
        ):
            decimals = 2 if axis.startswith("F") else 4
            ours_text, real_text = ("".join(f"{value:9.{decimals}f}" for value in values) for values in (ours, real))
            yield f"{axis} {ours_text} {real_text}  {''.join(f'{value:+5.0f}' for value in errors)}"


def compute_dataset_statistics(pair_files: Sequence[Path]) -> DatasetStatistics:
    """Count what is in the files of pairs of a data set; raises `FileFormatError`."""
    table = read_columns(pair_files, ("kind", "sensor", "object", "wrench"))
    kinds = [kind or "rule" for kind in table["kind"].to_pylist()]
    wrenches = wrench_array(table).astype(float)
    by_rule = np.array([kind == "rule" for kind in kinds], bool)
    wrenches = wrenches[by_rule] if by_rule.any() else wrenches
    sensors, objects = ([name or "" for name in table[column].to_pylist()] for column in ("sensor", "object"))
    finite = wrenches[np.isfinite(wrenches).all(1)]
    by_kind, by_sensor, by_object = (dict(sorted(Counter(names).items())) for names in (kinds, sensors, objects))
    return DatasetStatistics(by_kind, by_sensor, by_object, finite)


_LICENCE = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")
_FRAME = (
    "Torques are about the centre of the skin without contact. Sensor frame: x along columns, y along rows, z outward through "
    "the skin."
)


def require_licence_name(licence: str | None) -> None:
    """Raise `InputError` for text that cannot be the name of a licence."""
    if licence is not None and not _LICENCE.fullmatch(licence):
        raise InputError(
            expected="a licence as Hugging Face names it, such as mit or cc-by-nc-4.0",
            got=f"{licence!r}",
            remedy="correct it",
        )


def format_build_card(
    statistics: DatasetStatistics,
    sources: "Sequence[Source]",
    licence: str | None,
    report: "QualityReport",
    version: str,
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
        lines.append(
            f"- `{source.name}`: {source.description}, from `{escape_invalid_utf8(source.path.resolve().name)}`"
        )
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


def format_sequences_card(settings: SequenceSettings, statistics: DatasetStatistics, version: str) -> str:
    """Return the card of a data set of sequences."""
    lines = [
        *_format_header("9DTact twin, sequences", ("tactile-sensing", "robotics", "simulation", "slip"), licence=None),
        "# Sequences of simulated 9DTact sensors with true motion and slip",
        "",
        f"Made by `ninedtact simulate sequences` {version}: {settings.sequences} sequences of {HZ:g} images per second, "
        f"{statistics.pairs} images of {len(statistics.sensors)} sensors and {statistics.object_count} objects. Each file is one "
        "sequence, and `step` counts its images. It contains no real image. Hold out whole sensors and objects with "
        "`ninedtact train --held-out sensor_and_object`.",
        "",
        *_format_column_table((*PAIR_COLUMNS, *TRUTH_COLUMNS)),
        "",
        _FRAME,
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


def _format_column_table(columns: Sequence[Column] = PAIR_COLUMNS) -> Iterator[str]:
    yield from ("| column | meaning |", "|---|---|")
    yield from (f"| {column.name} | {column.meaning} |" for column in columns)


def _format_percentile_section(statistics: DatasetStatistics) -> Iterator[str]:
    yield from ("## Percentiles", "", *_indent(statistics.percentile_lines()), "")


def _indent(lines: Iterator[str]) -> Iterator[str]:
    yield from (f"    {line}".rstrip() for line in lines)

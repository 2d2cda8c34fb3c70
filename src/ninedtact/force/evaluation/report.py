"""Reports of an evaluation: a text table for a terminal, and a folder with an HTML page, figures and JSON.

Tables give forces in N and torques in N·mm; the JSON file gives N and N·m.
"""

import json
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.force.evaluation.evaluation import (
    PAPER_OBJECT_SPLIT_MAE,
    PAPER_OBJECT_SPLIT_STD,
    GroupScores,
    WrenchEvaluation,
    force_torque_means,
    published_scores_about_torque_point,
)
from ninedtact.force.evaluation.plots import plot_evaluation
from ninedtact.force.evaluation.predictions import AXES, Six

_FORCE_DECIMALS, _TORQUE_DECIMALS, _RATIO_DECIMALS = 4, 2, 3
_DISPLAY_SCALE = np.array([1, 1, 1, 1e3, 1e3, 1e3, 1, 1e3])
"""From N and N·m to N and N·mm: six axes, then the means of forces and of torques."""
_ScoreKind = Literal["error", "signed", "ratio"]
"""An error has a unit and means over forces and torques; a signed score has a unit only; a ratio has neither."""
_SCORE_ROWS: dict[str, tuple[str, _ScoreKind]] = {
    "MAE": ("mae", "error"),
    "Std of |error|": ("std", "error"),
    "RMSE": ("rmse", "error"),
    "bias": ("bias", "signed"),
    "R²": ("r2", "ratio"),
    "slope": ("slope", "ratio"),
    "slope with offset": ("slope_with_offset", "ratio"),
    "skill": ("skill", "ratio"),
    "MAE of the median": ("median_mae", "error"),
}
"""Label of each row, the field of `AxisScores`, and its kind."""
_HEADINGS = (*AXES, "mean F", "mean T")
_UNDEFINED = "–"
_WORST_OBJECTS = 10
"""Number of objects whose scores are shown on the page; the JSON file has all of them."""


@dataclass(frozen=True)
class _ReportRow:
    """One row of a report's table: a label and its formatted cells."""

    name: str
    cells: tuple[str, ...]
    is_published: bool = False


def format_evaluation_report(evaluation: WrenchEvaluation) -> Iterator[str]:
    """Yield the lines of a report for a terminal, N and N·mm."""
    yield f"{_pair_count_text(evaluation)}; N and N·mm, torques {_torque_reference_text(evaluation)}"
    yield from _format_table("", list(_score_rows(evaluation)))
    yield from _format_table("by true |Fz|: MAE", list(_group_rows(evaluation.by_load)))
    if rows := list(_coverage_rows(evaluation)):
        yield from _format_table(f"truth inside {evaluation.predictions.distribution} intervals", rows)
    if no_contact := evaluation.no_contact:
        yield (
            f"no contact, {no_contact.pairs} pairs: |F| {no_contact.mean_force_n:.3f} N on average, "
            f"{no_contact.largest_force_n:.3f} N at most"
        )
    for what, groups in (("objects", evaluation.by_object), ("sensors", evaluation.by_sensor)):
        if groups:
            yield _best_and_worst_text(what, groups)
    yield published_scores_about_torque_point(evaluation.predictions.about_mm).what


def write_evaluation_report(out: Path, evaluation: WrenchEvaluation) -> Iterator[tuple[str, Path]]:
    """Write page, figures and JSON, each atomically, and yield kind and path of each; raises `FileNotWritten`."""
    out.mkdir(parents=True, exist_ok=True)
    figures = dict(plot_evaluation(evaluation))
    contents = {f"{name}.png": content for name, content in figures.items()}
    contents["evaluation.json"] = json.dumps(evaluation.to_json_dict(), indent=1, ensure_ascii=False).encode()
    contents["evaluation.html"] = _render_html(evaluation, figures).encode()
    for name, content in contents.items():
        write_file_atomically(out / name, content)
        yield name.removesuffix(".png"), out / name


def _render_html(evaluation: WrenchEvaluation, figures: dict[str, bytes]) -> str:
    """Return one HTML document with the images embedded, which loads no other files and runs no scripts."""
    # jinja2 is slow to import, and only this function needs it.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    pages = Environment(
        loader=PackageLoader("ninedtact.force.evaluation", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return pages.get_template("evaluation.html.jinja").render(
        evaluation=evaluation,
        pair_count=_pair_count_text(evaluation),
        torque_reference=_torque_reference_text(evaluation),
        published=published_scores_about_torque_point(evaluation.predictions.about_mm),
        headings=_HEADINGS,
        scores=[*_score_rows(evaluation)],
        object_split=[_ReportRow("MAE", PAPER_OBJECT_SPLIT_MAE), _ReportRow("Std of |error|", PAPER_OBJECT_SPLIT_STD)],
        loads=[*_group_rows(evaluation.by_load)],
        coverage=[*_coverage_rows(evaluation)],
        sensors=[*_group_rows(evaluation.by_sensor)],
        worst=[*_group_rows(sorted(evaluation.by_object, key=lambda group: -group.mae[:3].mean())[:_WORST_OBJECTS])],
        images={name: b64encode(content).decode() for name, content in figures.items()},
    )


def _score_rows(evaluation: WrenchEvaluation) -> Iterator[_ReportRow]:
    """Yield all scores, each followed by the published network's score where it is known."""
    published = published_scores_about_torque_point(evaluation.predictions.about_mm)
    for name, (field, kind) in _SCORE_ROWS.items():
        yield _ReportRow(name, _format_cells(getattr(evaluation.scores, field), kind))
        if hasattr(published, field):
            yield _ReportRow("published", _format_cells(getattr(published, field), kind), is_published=True)


def _coverage_rows(evaluation: WrenchEvaluation) -> Iterator[_ReportRow]:
    """Yield the part of the pairs inside each interval."""
    for coverage in evaluation.coverage:
        yield _ReportRow(f"in {coverage.share:.0%} interval", _format_cells(coverage.covered, "ratio"))


def _group_rows(groups: Sequence[GroupScores]) -> Iterator[_ReportRow]:
    """Yield error and bias of each group with its number of pairs."""
    for group in groups:
        yield _ReportRow(f"{group.name}, {group.pairs} pairs", _format_cells(group.mae, "error"))
        yield _ReportRow("  bias", _format_cells(group.bias, "signed"))


def _format_cells(six: Sequence[float] | Six, kind: _ScoreKind) -> tuple[str, ...]:
    """Return the cells of six numbers and, for errors, of their means over forces and torques."""
    if kind == "ratio":
        return tuple(_format_number(value, _RATIO_DECIMALS) for value in six)
    means = force_torque_means(np.array(six))
    values = [*six, means.force_n, means.torque_nm] if kind == "error" else [*six]
    decimals = [_FORCE_DECIMALS] * 3 + [_TORQUE_DECIMALS] * 3 + [_FORCE_DECIMALS, _TORQUE_DECIMALS]
    cells = zip(values, _DISPLAY_SCALE, decimals, strict=False)
    return tuple(_format_number(value * scale, places, kind == "signed") for value, scale, places in cells)


def _format_number(value: float, decimals: int, is_signed: bool = False) -> str:
    """Format a number with a true minus sign; a dash stands for NaN."""
    if np.isnan(value):
        return _UNDEFINED
    return f"{value:{'+' if is_signed else ''}.{decimals}f}".replace("-", "\N{MINUS SIGN}")


def _format_table(title: str, rows: Sequence[_ReportRow]) -> Iterator[str]:
    """Yield the lines of a table: a heading, then the rows in columns."""
    width = max(20, len(title), *(len(row.name) + 2 * row.is_published for row in rows))
    yield f"{title:<{width}}" + "".join(f"{heading:>9}" for heading in _HEADINGS)
    for row in rows:
        name = f"  {row.name}" if row.is_published else row.name
        yield f"{name:<{width}}" + "".join(f"{cell:>9}" for cell in row.cells)


def _pair_count_text(evaluation: WrenchEvaluation) -> str:
    """Return the numbers of pairs, objects and sensors in words."""
    words = f"{evaluation.pairs} pairs"
    for what, groups in (("object", evaluation.by_object), ("sensor", evaluation.by_sensor)):
        if groups:
            words += f", {len(groups)} {what}{'s' if len(groups) > 1 else ''}"
    return words


def _torque_reference_text(evaluation: WrenchEvaluation) -> str:
    """Return the point of the torques in words."""
    point = evaluation.predictions.about_mm
    if point is None:
        return "about the point of the predictions file"
    return "about " + ("the skin's centre" if not any(point) else "({:g}, {:g}, {:g}) mm".format(*point))


def _best_and_worst_text(what: str, groups: Sequence[GroupScores]) -> str:
    """Return the best and the worst of the objects or sensors by the mean error of the forces."""
    order = sorted(groups, key=lambda group: force_torque_means(group.mae).force_n)
    best, worst = (f"{group.name} {force_torque_means(group.mae).force_n:.3f} N" for group in (order[0], order[-1]))
    return f"{what}, mean error of the forces: best {best}, worst {worst}"

"""The figures as rows of words: for a terminal and for a page.

An evaluation → a folder: one page that needs nothing else, its figures as PNG, and all numbers as JSON.
"""

import json
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.force.evaluation.evaluation import GroupScores, WrenchEvaluation, force_torque_means
from ninedtact.force.evaluation.plots import plot_evaluation
from ninedtact.force.evaluation.predictions import AXES, Six
from ninedtact.force.evaluation.published_results import (
    PAPER_OBJECT_SPLIT_MAE,
    PAPER_OBJECT_SPLIT_STD,
    published_scores_about,
)

FORCE_PLACES, TORQUE_PLACES, PLAIN_PLACES = 4, 5, 3
Kind = Literal["error", "signed", "plain"]
"""An error has a unit and means over forces and torques; what is signed has a unit only; what is plain has neither."""
ROWS: dict[str, tuple[str, Kind]] = {
    "MAE": ("mae", "error"),
    "Std of |error|": ("std", "error"),
    "RMSE": ("rmse", "error"),
    "bias": ("bias", "signed"),
    "R²": ("r2", "plain"),
    "slope": ("slope", "plain"),
    "slope with offset": ("slope_with_offset", "plain"),
    "skill": ("skill", "plain"),
    "MAE of the median": ("median_mae", "error"),
}
"""What a row is called, where it is found, and how it is written."""
HEADINGS = (*AXES, "mean F", "mean T")
NO_ANSWER = "–"


@dataclass(frozen=True)
class _ReportRow:
    """One line of a table."""

    name: str
    cells: tuple[str, ...]
    is_published: bool = False


def _score_rows(evaluation: WrenchEvaluation) -> Iterator[_ReportRow]:
    """All scores, each with the published network's below it where that is known."""
    peer = published_scores_about(evaluation.predictions.about_mm)
    for name, (field, kind) in ROWS.items():
        yield _ReportRow(name, _format_cells(getattr(evaluation.scores, field), kind))
        if hasattr(peer, field):
            yield _ReportRow("published", _format_cells(getattr(peer, field), kind), is_published=True)


def _coverage_rows(evaluation: WrenchEvaluation) -> Iterator[_ReportRow]:
    """GroupScores of the pairs inside each interval."""
    for found in evaluation.coverage:
        yield _ReportRow(f"in {found.share:.0%} interval", _format_cells(found.covered, "plain"))


def _group_rows(parts: Sequence[GroupScores]) -> Iterator[_ReportRow]:
    """Error and bias of each part, and how many pairs it has."""
    for part in parts:
        yield _ReportRow(f"{part.name}, {part.pairs} pairs", _format_cells(part.mae, "error"))
        yield _ReportRow("  bias", _format_cells(part.bias, "signed"))


def _format_cells(six: Sequence[float] | Six, kind: Kind) -> tuple[str, ...]:
    """Six numbers and, of errors, the means over forces and torques."""
    both = force_torque_means(np.array(six))
    values = [*six, both.force_n, both.torque_nm] if kind == "error" else [*six]
    places = [FORCE_PLACES] * 3 + [TORQUE_PLACES] * 3 + [FORCE_PLACES, TORQUE_PLACES]
    return tuple(
        _format_number(value, PLAIN_PLACES if kind == "plain" else at, kind == "signed")
        for value, at in zip(values, places[: len(values)], strict=True)
    )


def _format_number(value: float, places: int, is_signed: bool = False) -> str:
    """With a true minus sign; a dash where there is no answer."""
    if np.isnan(value):
        return NO_ANSWER
    return f"{value:{'+' if is_signed else ''}.{places}f}".replace("-", "\N{MINUS SIGN}")


def format_evaluation_report(evaluation: WrenchEvaluation) -> Iterator[str]:
    """All of it for a terminal."""
    yield f"{_pair_count_text(evaluation)}; N and N·m, torques {_torque_reference_text(evaluation)}"
    yield from _format_table("", list(_score_rows(evaluation)))
    yield from _format_table("by true |Fz|: MAE", list(_group_rows(evaluation.by_load)))
    if rows := list(_coverage_rows(evaluation)):
        yield from _format_table(f"truth inside {evaluation.predictions.distribution} intervals", rows)
    if nothing := evaluation.untouched:
        yield (
            f"nothing touches, {nothing.pairs} pairs: |F| {nothing.mean_force_n:.3f} N on average, "
            f"{nothing.largest_force_n:.3f} N at most"
        )
    for what, parts in (("objects", evaluation.by_object), ("sensors", evaluation.by_sensor)):
        if parts:
            yield _best_and_worst_text(what, parts)
    yield published_scores_about(evaluation.predictions.about_mm).what


def _format_table(title: str, rows: Sequence[_ReportRow]) -> Iterator[str]:
    """Rows below a heading, in columns."""
    width = max(20, len(title), *(len(row.name) + 2 * row.is_published for row in rows))
    yield f"{title:<{width}}" + "".join(f"{heading:>9}" for heading in HEADINGS)
    for row in rows:
        name = f"  {row.name}" if row.is_published else row.name
        yield f"{name:<{width}}" + "".join(f"{cell:>9}" for cell in row.cells)


def _pair_count_text(evaluation: WrenchEvaluation) -> str:
    """How many pairs, of how many objects and sensors."""
    words = f"{evaluation.pairs} pairs"
    for what, parts in (("object", evaluation.by_object), ("sensor", evaluation.by_sensor)):
        if parts:
            words += f", {len(parts)} {what}{'s' if len(parts) > 1 else ''}"
    return words


def _torque_reference_text(evaluation: WrenchEvaluation) -> str:
    """The point of the torques in words."""
    point = evaluation.predictions.about_mm
    if point is None:
        return "about the point that they were given about"
    return "about " + ("the skin's centre" if not any(point) else "({:g}, {:g}, {:g}) mm".format(*point))


def _best_and_worst_text(what: str, parts: Sequence[GroupScores]) -> str:
    """Best and worst of the objects or sensors by the mean error of the forces."""
    order = sorted(parts, key=lambda part: force_torque_means(part.mae).force_n)
    best, worst = (f"{part.name} {force_torque_means(part.mae).force_n:.3f} N" for part in (order[0], order[-1]))
    return f"{what}, mean error of the forces: best {best}, worst {worst}"


_WORST_OBJECTS = 10
"""Objects whose figures stand in the page; all are in the JSON."""


def write_evaluation_report(out: Path, evaluation: WrenchEvaluation) -> Iterator[tuple[str, Path]]:
    """Write all files, each whole (`FileNotWritten`); kind and path of each."""
    out.mkdir(parents=True, exist_ok=True)
    drawn = dict(plot_evaluation(evaluation))
    contents = {f"{name}.png": content for name, content in drawn.items()}
    contents["evaluation.json"] = json.dumps(evaluation.to_json_dict(), indent=1, ensure_ascii=False).encode()
    contents["evaluation.html"] = _render_html(evaluation, drawn).encode()
    for name, content in contents.items():
        write_file_atomically(out / name, content)
        yield name.removesuffix(".png"), out / name


def _render_html(evaluation: WrenchEvaluation, drawn: dict[str, bytes]) -> str:
    """One HTML document: images are inside it, it loads and runs nothing."""
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
        counted=_pair_count_text(evaluation),
        about=_torque_reference_text(evaluation),
        published=published_scores_about(evaluation.predictions.about_mm),
        headings=HEADINGS,
        scores=[*_score_rows(evaluation)],
        unseen=[_ReportRow("MAE", PAPER_OBJECT_SPLIT_MAE), _ReportRow("Std of |error|", PAPER_OBJECT_SPLIT_STD)],
        loads=[*_group_rows(evaluation.by_load)],
        coverage=[*_coverage_rows(evaluation)],
        sensors=[*_group_rows(evaluation.by_sensor)],
        worst=[*_group_rows(sorted(evaluation.by_object, key=lambda part: -part.mae[:3].mean())[:_WORST_OBJECTS])],
        images={name: b64encode(content).decode() for name, content in drawn.items()},
    )

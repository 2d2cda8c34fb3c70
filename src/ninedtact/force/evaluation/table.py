"""The figures as rows of words: for a terminal and for a page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ninedtact.force.evaluation.evaluation import Evaluation
from ninedtact.force.evaluation.parts import Part
from ninedtact.force.evaluation.predictions import AXES, Six
from ninedtact.force.evaluation.published import published_about
from ninedtact.force.evaluation.scores import means

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
class Row:
    """One line of a table."""

    name: str
    cells: tuple[str, ...]
    is_published: bool = False


def score_rows(evaluation: Evaluation) -> Iterator[Row]:
    """All scores, each with the published network's below it where that is known."""
    peer = published_about(evaluation.predictions.about_mm)
    for name, (field, kind) in ROWS.items():
        yield Row(name, cells(getattr(evaluation.scores, field), kind))
        if hasattr(peer, field):
            yield Row("published", cells(getattr(peer, field), kind), is_published=True)


def coverage_rows(evaluation: Evaluation) -> Iterator[Row]:
    """Part of the pairs inside each interval."""
    for found in evaluation.coverage:
        yield Row(f"in {found.share:.0%} interval", cells(found.covered, "plain"))


def part_rows(parts: Sequence[Part]) -> Iterator[Row]:
    """Error and bias of each part, and how many pairs it has."""
    for part in parts:
        yield Row(f"{part.name}, {part.pairs} pairs", cells(part.mae, "error"))
        yield Row("  bias", cells(part.bias, "signed"))


def cells(six: Sequence[float] | Six, kind: Kind) -> tuple[str, ...]:
    """Six numbers and, of errors, the means over forces and torques."""
    both = means(np.array(six))
    values = [*six, both.force_n, both.torque_nm] if kind == "error" else [*six]
    places = [FORCE_PLACES] * 3 + [TORQUE_PLACES] * 3 + [FORCE_PLACES, TORQUE_PLACES]
    return tuple(
        number(value, PLAIN_PLACES if kind == "plain" else at, kind == "signed")
        for value, at in zip(values, places[: len(values)], strict=True)
    )


def number(value: float, places: int, is_signed: bool = False) -> str:
    """With a true minus sign; a dash where there is no answer."""
    if np.isnan(value):
        return NO_ANSWER
    return f"{value:{'+' if is_signed else ''}.{places}f}".replace("-", "\N{MINUS SIGN}")


def lines(evaluation: Evaluation) -> Iterator[str]:
    """All of it for a terminal."""
    yield f"{counted(evaluation)}; N and N·m, torques {about(evaluation)}"
    yield from block("", list(score_rows(evaluation)))
    yield from block("by true |Fz|: MAE", list(part_rows(evaluation.by_load)))
    if rows := list(coverage_rows(evaluation)):
        yield from block(f"truth inside {evaluation.predictions.distribution} intervals", rows)
    if nothing := evaluation.untouched:
        yield (
            f"nothing touches, {nothing.pairs} pairs: |F| {nothing.mean_force_n:.3f} N on average, "
            f"{nothing.largest_force_n:.3f} N at most"
        )
    for what, parts in (("objects", evaluation.by_object), ("sensors", evaluation.by_sensor)):
        if parts:
            yield worst_of(what, parts)
    yield published_about(evaluation.predictions.about_mm).what


def block(title: str, rows: Sequence[Row]) -> Iterator[str]:
    """Rows below a heading, in columns."""
    width = max(20, len(title), *(len(row.name) + 2 * row.is_published for row in rows))
    yield f"{title:<{width}}" + "".join(f"{heading:>9}" for heading in HEADINGS)
    for row in rows:
        name = f"  {row.name}" if row.is_published else row.name
        yield f"{name:<{width}}" + "".join(f"{cell:>9}" for cell in row.cells)


def counted(evaluation: Evaluation) -> str:
    """How many pairs, of how many objects and sensors."""
    words = f"{evaluation.pairs} pairs"
    for what, parts in (("object", evaluation.by_object), ("sensor", evaluation.by_sensor)):
        if parts:
            words += f", {len(parts)} {what}{'s' if len(parts) > 1 else ''}"
    return words


def about(evaluation: Evaluation) -> str:
    """The point of the torques in words."""
    point = evaluation.predictions.about_mm
    if point is None:
        return "about the point that they were given about"
    return "about " + ("the skin's centre" if not any(point) else "({:g}, {:g}, {:g}) mm".format(*point))


def worst_of(what: str, parts: Sequence[Part]) -> str:
    """Best and worst of the objects or sensors by the mean error of the forces."""
    order = sorted(parts, key=lambda part: means(part.mae).force_n)
    best, worst = (f"{part.name} {means(part.mae).force_n:.3f} N" for part in (order[0], order[-1]))
    return f"{what}, mean error of the forces: best {best}, worst {worst}"

"""Reports of an evaluation: a text table for a terminal, and a folder with an HTML page, figures and JSON. Figures of training
curves.

Tables give forces in N and torques in N·mm; the JSON file gives N and N·m. Figures show predicted against true, error by load,
coverage, and error by object and sensor. matplotlib is slow to import, so it is imported when a figure is drawn; its global
state is not changed.
"""

import json
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.page_template import render_page
from ninedtact.quantities import WRENCH_AXES
from ninedtact_train.evaluation.evaluation import (
    PAPER_OBJECT_SPLIT_MAE,
    PAPER_OBJECT_SPLIT_STD,
    GroupScores,
    WrenchEvaluation,
    force_torque_means,
    interval_coverage,
    published_scores_about_torque_point,
)
from ninedtact_train.evaluation.predictions import FORCES, TORQUES, Six

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 130
_INK, _PALE_INK, _RULE = "#22262b", "#6b7280", "#c2410c"
_COLOURS = ("#0072b2", "#d55e00", "#009e73")
"""Colours of x, y and z, which colour-blind readers can distinguish."""
_MILLI = 1e3
_SHARES = np.linspace(0.05, 0.95, 19)
_MAX_NAMED = 30
"""Largest number of groups that are named below their bars; of more, only the worst are."""
_WORST_NAMED = 6


def _plot_evaluation(evaluation: WrenchEvaluation) -> Iterator[tuple[str, bytes]]:
    yield "scatter", _plot_predicted_against_true(evaluation)
    if evaluation.by_load:
        yield "load", _plot_error_by_load(evaluation)
    if evaluation.coverage:
        yield "coverage", _plot_interval_coverage(evaluation)
    for name, groups in (("objects", evaluation.by_object), ("sensors", evaluation.by_sensor)):
        if len(groups) > 1:
            yield name, _plot_error_by_group(groups, name)


def _plot_predicted_against_true(evaluation: WrenchEvaluation) -> bytes:
    """Plot predicted against true for each axis; darker hexagons hold more pairs."""
    from matplotlib.colors import LogNorm

    figure = _new_figure(10.5, 7.2)
    for axis, axes in enumerate(figure.subplots(2, 3).flat):
        factor, unit = (1.0, "N") if axis < 3 else (_MILLI, "N·mm")
        predictions = evaluation.predictions
        true, predicted = (factor * six[:, axis] for six in (predictions.truth, predictions.predicted))
        low, high = min(true.min(), predicted.min()), max(true.max(), predicted.max())
        margin = 0.03 * (high - low) or 1.0
        low, high = low - margin, high + margin
        axes.hexbin(
            true, predicted, gridsize=60, extent=(low, high, low, high), mincnt=1, cmap="Blues", norm=LogNorm(0.3)
        )
        slope = evaluation.scores.slope[axis]
        axes.plot([low, high], [low, high], color=_PALE_INK, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.plot([low, high], [slope * low, slope * high], color=_RULE, linewidth=1.2, label=f"slope {slope:.2f}")
        axes.set(xlim=(low, high), ylim=(low, high), aspect="equal")
        title = f"{WRENCH_AXES[axis]}, skill {evaluation.scores.skill[axis]:.3f}"
        _style_axes(axes, title, f"true ({unit})", f"predicted ({unit})")
    return _encode_png(figure)


def _plot_error_by_load(evaluation: WrenchEvaluation) -> bytes:
    figure = _new_figure(10.5, 4.2)
    names = [f"{group.name}\n{group.pairs}" for group in evaluation.by_load]
    for axes, which, factor, unit in zip(
        figure.subplots(1, 2), (FORCES, TORQUES), (1.0, _MILLI), ("N", "N·mm"), strict=True
    ):
        at = np.arange(len(names))
        for number, colour in enumerate(_COLOURS):
            mae, bias = (
                [factor * getattr(group, what)[which][number] for group in evaluation.by_load]
                for what in ("mae", "bias")
            )
            left = at + (number - 1) * 0.27
            axes.bar(left, mae, 0.25, color=colour, label=WRENCH_AXES[which][number])
            axes.plot(left, bias, "_", color=_INK, markersize=7, markeredgewidth=1.6)
        axes.plot([], [], "_", color=_INK, markersize=7, markeredgewidth=1.6, label="bias")
        axes.axhline(0, color=_INK, linewidth=0.6)
        axes.set_xticks(at, names)
        _style_axes(axes, "", "true |Fz|, pairs", f"mean absolute error and bias ({unit})")
        _place_legend_above(axes)
    return _encode_png(figure)


def _plot_interval_coverage(evaluation: WrenchEvaluation) -> bytes:
    figure = _new_figure(5.2, 5.0)
    axes = figure.subplots()
    found = np.array([interval_coverage(evaluation.predictions, share) for share in _SHARES]).T
    axes.plot([0, 1], [0, 1], color=_PALE_INK, linewidth=0.8, linestyle=(0, (4, 3)))
    for axis, (name, inside) in enumerate(zip(WRENCH_AXES, found, strict=True)):
        style = "-" if axis < 3 else "--"
        axes.plot(_SHARES, inside, style, color=_COLOURS[axis % 3], linewidth=1.5, label=name)
    axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    title = f"above the diagonal: errors claimed too large ({evaluation.predictions.distribution})"
    _style_axes(axes, title, "share that the interval claims", "share of pairs inside")
    return _encode_png(figure)


def _plot_error_by_group(groups: Sequence[GroupScores], what: str) -> bytes:
    """Plot the mean absolute errors of forces and of torques of each group, ordered by the force's."""
    order = sorted(groups, key=lambda group: group.mae[FORCES].mean())
    figure = _new_figure(10.5, 5.4)
    at, few = np.arange(len(order)), len(order) <= _MAX_NAMED
    both = figure.subplots(2, 1, sharex=True)
    for axes, which, factor, unit in zip(both, (FORCES, TORQUES), (1.0, _MILLI), ("N", "N·mm"), strict=True):
        below = np.zeros(len(order))
        for number, colour in enumerate(_COLOURS):
            share = np.array([factor * group.mae[which][number] / 3 for group in order])
            axes.bar(at, share, 0.85, below, color=colour, label=WRENCH_AXES[which][number])
            below += share
        _style_axes(axes, "", "", f"mean of three errors ({unit})")
        _place_legend_above(axes)
    words = f"{len(order)} {what}"
    if few:
        both[1].set_xticks(at, [group.name for group in order], rotation=60, ha="right", rotation_mode="anchor")
    else:
        both[1].set_xticks([])
        words += (
            f"; the worst of them, from the right: {', '.join(group.name for group in order[: -_WORST_NAMED - 1 : -1])}"
        )
    both[1].set_xlabel(words, color=_INK, size=9)
    both[0].margins(x=0.01)
    return _encode_png(figure)


def _new_figure(width_in: float, height_in: float) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), dpi=_DPI, facecolor="white", layout="constrained")


def _style_axes(axes: "Axes", title: str, x_label: str, y_label: str) -> None:
    axes.set_title(title, size=9.5, color=_INK)
    axes.set_xlabel(x_label, size=9, color=_INK)
    axes.set_ylabel(y_label, size=9, color=_INK)
    axes.tick_params(colors=_INK, labelsize=8, width=0.6, length=3)
    axes.spines[:].set(color="#9ca3af", linewidth=0.6)
    axes.legend(fontsize=8, frameon=False, labelcolor=_INK)


def _place_legend_above(axes: "Axes") -> None:
    axes.legend(
        fontsize=8, frameon=False, labelcolor=_INK, ncols=4, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2
    )


def _encode_png(figure: "Figure") -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def plot_training_curves(
    epochs: Sequence[Mapping[str, float]], validation_loss: str, median_mae: Sequence[float], best_epoch: int
) -> bytes:
    """Plot the losses and the validation error of every epoch, and return the figure as a PNG.

    epochs: metrics of each epoch (`epoch`, `train_loss`, `mae_Fx` … `mae_Tz` and the one that `validation_loss` names).
    median_mae: validation error, by axis, of always predicting the median.
    """
    figure = _new_figure(9.0, 3.8)
    left, right = figure.subplots(1, 2)
    numbers = [row["epoch"] for row in epochs]
    left.plot(numbers, [row["train_loss"] for row in epochs], color=_PALE_INK, label="training, augmented")
    left.plot(numbers, [row[validation_loss] for row in epochs], color=_COLOURS[0], label="validation")
    for number, (axis, alone) in enumerate(zip(WRENCH_AXES, median_mae, strict=True)):
        error = np.array([row[f"mae_{axis}"] for row in epochs]) / alone
        right.plot(numbers, error, "-" if number < 3 else "--", color=_COLOURS[number % 3], label=axis)
    right.set_ylim(bottom=0)
    for axes, y_label in (
        (left, "mean absolute error (units of the labels)"),
        (right, "validation error / error of the median (1 − skill)"),
    ):
        axes.axvline(best_epoch, color=_PALE_INK, linewidth=0.8, linestyle=":", label=f"best epoch: {best_epoch}")
        _style_axes(axes, "", "epoch", y_label)
    return _encode_png(figure)


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
_HEADINGS = (*WRENCH_AXES, "mean F", "mean T")
_UNDEFINED = "–"
_WORST_OBJECTS = 10
"""Number of objects whose scores are shown on the page; the JSON file has all of them."""


@dataclass(frozen=True)
class _ReportRow:
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
    figures = dict(_plot_evaluation(evaluation))
    contents = {f"{name}.png": content for name, content in figures.items()}
    contents["evaluation.json"] = json.dumps(evaluation.to_json_dict(), indent=1, ensure_ascii=False).encode()
    contents["evaluation.html"] = _render_html(evaluation, figures).encode()
    for name, content in contents.items():
        write_file_atomically(out / name, content)
        yield name.removesuffix(".png"), out / name


def _render_html(evaluation: WrenchEvaluation, figures: dict[str, bytes]) -> str:
    """Return one HTML document with the images embedded, which loads no other files and runs no scripts."""
    return render_page(
        "ninedtact_train.evaluation",
        "evaluation.html.jinja",
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
    for share, covered in evaluation.coverage.items():
        yield _ReportRow(f"in {share:.0%} interval", _format_cells(covered, "ratio"))


def _group_rows(groups: Sequence[GroupScores]) -> Iterator[_ReportRow]:
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
    width = max(20, len(title), *(len(row.name) + 2 * row.is_published for row in rows))
    yield f"{title:<{width}}" + "".join(f"{heading:>9}" for heading in _HEADINGS)
    for row in rows:
        name = f"  {row.name}" if row.is_published else row.name
        yield f"{name:<{width}}" + "".join(f"{cell:>9}" for cell in row.cells)


def _pair_count_text(evaluation: WrenchEvaluation) -> str:
    words = f"{evaluation.pairs} pairs"
    for what, groups in (("object", evaluation.by_object), ("sensor", evaluation.by_sensor)):
        if groups:
            words += f", {len(groups)} {what}{'s' if len(groups) > 1 else ''}"
    return words


def _torque_reference_text(evaluation: WrenchEvaluation) -> str:
    point = evaluation.predictions.about_mm
    if point is None:
        return "about the point of the predictions file"
    return "about " + ("the skin's centre" if not any(point) else "({:g}, {:g}, {:g}) mm".format(*point))


def _best_and_worst_text(what: str, groups: Sequence[GroupScores]) -> str:
    order = sorted(groups, key=lambda group: force_torque_means(group.mae).force_n)
    best, worst = (f"{group.name} {force_torque_means(group.mae).force_n:.3f} N" for group in (order[0], order[-1]))
    return f"{what}, mean error of the forces: best {best}, worst {worst}"

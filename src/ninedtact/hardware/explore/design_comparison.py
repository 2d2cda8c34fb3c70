"""Comparison of explored designs as text, CSV and a plot."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO, StringIO
from math import ceil
from typing import TYPE_CHECKING, Any

from ninedtact.hardware.explore.design_sweep import ExploredDesign

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PREDICTION_COLUMNS = (
    ("depth_range_mm", "deep mm", "depth range, mm"),
    ("force_range_n", "load N", "force range, N"),
    ("signal_per_n", "grey/N", "signal at 1 N, grey levels"),
    ("depth_noise_mm", "noise mm", "depth noise of a pixel, mm"),
    ("mm_per_px", "mm/px", "mm per pixel"),
    ("blur_mm", "blur mm", "blur, mm"),
    ("view_radius_mm", "view mm", "radius of view, mm"),
    ("ratio_mm", "D/A mm", "volume over area, mm"),
    ("cost_usd", "cost $", "cost, $ (estimated)"),
)
"""Field, heading and title of each predicted quantity."""
CALIBRATION_COLUMNS = (
    ("depth_error_mm", "err mm", "error of depth after calibration, mm"),
    ("load_error_fraction", "err load", "error of the load by physics, of the load"),
)
"""Field, heading and title of the errors after a simulated calibration."""
NAME_WIDE = 34


def _columns_of(found: Sequence[ExploredDesign]) -> tuple[tuple[str, str, str], ...]:
    """Return the columns that any of the designs has."""
    return (
        (*PREDICTION_COLUMNS, *CALIBRATION_COLUMNS)
        if any(each.calibration_errors for each in found)
        else PREDICTION_COLUMNS
    )


def format_comparison_table(found: Sequence[ExploredDesign]) -> Iterator[str]:
    """Yield the comparison as lines of text."""
    shown = _columns_of(found)
    yield f"{'design':{NAME_WIDE}}" + "".join(f"{heading:>9}" for _, heading, _ in shown) + "  size mm"
    for each in found:
        names = [name for name, _, _ in shown]
        yield f"{each.name:{NAME_WIDE}}" + (
            _format_design_values(each, names) if each.prediction else f" refused: {each.refusal}"
        )
        if each.calibration_failure:
            yield f"{'':{NAME_WIDE}} not calibrated: {each.calibration_failure}"


def _format_design_values(each: ExploredDesign, names: Sequence[str]) -> str:
    """Return the values of one design in columns."""
    assert each.prediction is not None
    table = each.to_json_dict()
    values = "".join(f"{_format_number(table[name]) if name in table else '-':>9}" for name in names)
    return values + "  " + " x ".join(f"{side:.1f}" for side in each.prediction.size_mm)


def _format_number(value: float) -> str:
    """Return a number with three digits."""
    return f"{value:.3f}" if value < 1 else f"{value:.2f}" if value < 10 else f"{value:.1f}"


def comparison_to_csv(found: Sequence[ExploredDesign]) -> bytes:
    """Return all fields of all designs as CSV."""
    rows = [_flatten_row(each.to_json_dict()) for each in found]
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _flatten_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return one number a column: size_mm of three becomes size_mm_1, size_mm_2, size_mm_3."""
    several = {name: value for name, value in row.items() if isinstance(value, tuple | list)}
    split = {f"{name}_{number}": one for name, value in several.items() for number, one in enumerate(value, 1)}
    return {name: value for name, value in row.items() if name not in several} | split


def plot_comparison(found: Sequence[ExploredDesign]) -> bytes:
    """Return a PNG with one panel of bars for each quantity and one bar for each design."""
    # matplotlib is slow to import, and only this function needs it; its global state is never touched.
    from matplotlib.figure import Figure

    possible, shown = [each for each in found if each.prediction], _columns_of(found)
    tall = 0.55 * ceil(len(shown) / 3) * (1 + 0.55 * max(len(possible), 2))
    drawn = Figure(figsize=(14, tall), dpi=110, facecolor="white", layout="constrained")
    panels = drawn.subplots(ceil(len(shown) / 3), 3, sharey=True, squeeze=False).ravel()
    tables = [each.to_json_dict() for each in possible]
    for axes, (name, _, title) in zip(panels, shown, strict=False):
        _draw_bars(axes, [each.name for each in possible], [table.get(name, 0.0) for table in tables], title)
    panels[0].invert_yaxis()
    for spare in panels[len(shown) :]:
        spare.axis("off")
    buffer = BytesIO()
    drawn.savefig(buffer, format="png")
    return buffer.getvalue()


def _draw_bars(axes: "Axes", names: list[str], values: list[float], title: str) -> None:
    """Draw the bars of one quantity."""
    drawn = axes.barh(names, values, color="#4477aa", height=0.62)
    labels = [_format_number(value) if value else "not calibrated" for value in values]
    axes.bar_label(drawn, labels, padding=3, fontsize=8, color="#333333")
    axes.set_title(title, fontsize=10, loc="left")
    axes.margins(x=0.2)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)

"""Several sensors on one page: their states, their wrenches in one table and one plot, and the grip force of opposing ones.

Sensors oppose each other in pairs, in the order in which they are named: the first and the second, the third and the fourth. The
grip force of a pair is the mean of their normal forces −F_z. The readings of the sensors are each the newest, on one clock.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array
from viser import GuiApi, GuiEvent, Icon, uplot

from ninedtact.studio.page_cards import (
    BAND_OPACITY,
    CURVE_POINTS,
    DIM,
    LEAST_N,
    LEAST_NMM,
    PALE,
    TONES,
    component_curve_and_error_band,
    warning_badge_html,
)
from ninedtact.studio.page_controller import PageMoment, SensorMoment
from ninedtact.studio.sensor_poller import HISTORY_S, SensorPhase
from ninedtact.studio.viewer import Side, ViewerPage, is_user_event
from ninedtact.studio.wrench_history import WrenchSourceSnapshot, WrenchWithUncertainty

SENSOR_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
"""Blue, vermilion, green and purple of Okabe and Ito, one for each sensor; a fifth begins again."""
GRIP_COLOUR = "#e69f00"
PLOT_EVERY = 3
"""Number of moments after which the curves are redrawn."""
_NORMAL = "normal force −Fz, and grip (N)"
_COMPONENTS = {_NORMAL: (2, -1.0)} | {
    f"{letter}{axis} ({unit})": (first + number, scale)
    for letter, unit, first, scale in (("F", "N", 0, 1.0), ("T", "N·mm", 3, 1e3))
    for number, axis in enumerate("xyz")
}
"""What the plot can show: number of the component, and its factor."""


@dataclass(frozen=True)
class GripForce:
    """The mean of the normal forces of two opposing sensors, from one kind of source."""

    fingers: tuple[str, str]
    source: str
    """The head of the column: true, measured or estimated."""
    force_n: float | None
    """Positive where both are pressed; None where a sensor is lost or its force unknown."""
    std_n: float
    """One standard deviation: the mean of both, because errors of the method are common to them; NaN where none is stated."""
    missing: str = ""
    """Which sensor has no force."""


def grip_forces(moments: Sequence[SensorMoment]) -> Iterator[GripForce]:
    """Yield the grip force of every pair of opposing sensors, by each kind of source that both have."""
    for one, other in zip(moments[::2], moments[1::2], strict=False):
        for first in one.wrenches:
            for second in other.wrenches:
                if first.name == second.name:
                    yield _grip_force(one, other, first, second)


def _grip_force(
    one: SensorMoment, other: SensorMoment, first: WrenchSourceSnapshot, second: WrenchSourceSnapshot
) -> GripForce:
    fingers, samples = (one.name, other.name), (first.sample, second.sample)
    known = [_has_force(moment, sample) for moment, sample in zip((one, other), samples, strict=True)]
    if samples[0] is None or samples[1] is None or not all(known):
        missing = ", ".join(name for name, is_known in zip(fingers, known, strict=True) if not is_known)
        return GripForce(fingers, first.name, None, np.nan, missing)
    force_n = -float(samples[0].wrench.force_n[2] + samples[1].wrench.force_n[2]) / 2
    return GripForce(fingers, first.name, force_n, float(samples[0].std[2] + samples[1].std[2]) / 2)


def _has_force(moment: SensorMoment, sample: WrenchWithUncertainty | None) -> bool:
    """Return whether the normal force of a sensor is current and known."""
    return sample is not None and not moment.status.is_past and not np.isinf(sample.std[2])


def group_status_html(moments: Sequence[SensorMoment]) -> str:
    """Return the state of every sensor as HTML, with its maximum indentation and contact area."""
    return "".join(map(_sensor_status_html, moments))


def _sensor_status_html(moment: SensorMoment) -> str:
    measures = ""
    if moment.view is not None:
        summary = moment.view.summary
        measures = f"{summary.max_indentation_mm:.2f} mm, {summary.contact_area_mm2:.1f} mm²"
    return (
        f'<div role="status" style="margin:0.3em 0.5em;padding:0.3em 0.8em;border-radius:6px;color:#fff;font-size:0.9em;'
        f'line-height:1.35;background:{TONES[moment.status.tone]}"><b>{escape(moment.name)}</b>: '
        f'{escape(moment.status.sentence)} <span style="float:right;white-space:nowrap;'
        f'font-variant-numeric:tabular-nums">{measures}</span><span style="display:block;clear:both"></span></div>'
    )


def group_wrench_table_html(moments: Sequence[SensorMoment]) -> str:
    """Return the grip forces, then the wrench of every sensor from every source as a row, with errors and warnings, as HTML."""
    if not any(moment.wrenches for moment in moments):
        return ""
    units = "".join(
        f'<th style="text-align:right;font-weight:600">{letter}<sub>{axis}</sub></th>'
        for letter in "FT"
        for axis in "xyz"
    )
    rows = "".join(_sensor_rows_html(number, moment) for number, moment in enumerate(moments))
    lines: dict[str, list[str]] = {}
    for moment in moments:
        for source in moment.wrenches:
            for line in (*([str(source.trouble)] if source.trouble else []), *source.notices):
                lines.setdefault(line, []).append(moment.name)
    below = "".join(
        f'<div style="font-size:0.8em;color:{TONES["busy"]}">{escape(", ".join(names))}: {escape(line)}</div>'
        for line, names in lines.items()
    )
    meaning = dict.fromkeys(f"{one.name}: {one.meaning}" for moment in moments for one in moment.wrenches)
    return (
        '<div style="margin:0.3em 0.9em">'
        + "".join(map(_grip_html, grip_forces(moments)))
        + '<table style="width:100%;border-collapse:collapse;font-size:0.8em;font-variant-numeric:tabular-nums">'
        + f'<tr><th style="text-align:left">N, N·mm</th>{units}</tr>{rows}</table>{below}'
        + f'<div style="font-size:0.75em;{DIM}">{escape("; ".join(meaning))}; about the centre of each skin</div></div>'
    )


def _grip_html(grip: GripForce) -> str:
    """Return one grip force as HTML."""
    said = f"unknown without {grip.missing}"
    if grip.force_n is not None:
        said = f"{round(grip.force_n, 2) + 0.0:.2f} N".replace("-", "\N{MINUS SIGN}")
        said += f' <span style="font-size:0.75em;{DIM}">± {grip.std_n:.2f}</span>' if np.isfinite(grip.std_n) else ""
    title = "mean of the normal forces −Fz of both; ± is one standard deviation"
    return (
        f'<div title="{title}" style="display:flex;justify-content:space-between;align-items:baseline;gap:0.5em">'
        f'<span style="font-size:0.85em"><span style="color:{GRIP_COLOUR}">■</span> grip force '
        f"{escape(' and '.join(grip.fingers))}, {escape(grip.source)}</span>"
        f'<span style="font-size:1.1em;font-weight:600;white-space:nowrap;'
        f'font-variant-numeric:tabular-nums">{said}</span></div>'
    )


def _sensor_rows_html(number: int, moment: SensorMoment) -> str:
    """Return the wrenches of one sensor as rows of the table."""
    known = [one for one in moment.wrenches if one.sample is not None]
    warnings = dict.fromkeys(warning for one in known if one.sample for warning in one.sample.warnings)
    badges = "".join(map(warning_badge_html, warnings))
    head = (
        f'<tr><td colspan="7" style="padding-top:0.3em"><span style="color:{colour_of_sensor(number)}">■</span> '
        f"<b>{escape(moment.name)}</b> {badges}</td></tr>"
    )
    pale = PALE if moment.status.is_past else 1
    return head + "".join(_source_row_html(one, pale) for one in known)


def _source_row_html(source: WrenchSourceSnapshot, opacity: float) -> str:
    """Return one wrench as a row of the table: each component over its standard deviation."""
    if source.sample is None:
        return ""
    cells = "".join(
        f'<td style="text-align:right;vertical-align:top">{_component_html(source.sample, number)}</td>'
        for number in range(6)
    )
    return f'<tr style="opacity:{opacity}"><td style="vertical-align:top">{escape(source.name)}</td>{cells}</tr>'


def _component_html(sample: WrenchWithUncertainty, number: int) -> str:
    scale = (1.0, 1e3)[number // 3]
    std = scale * sample.std[number]
    if np.isinf(std):
        return "?"
    value = f"{round(scale * sample.wrench.six[number], 2) + 0.0:+.2f}".replace("-", "\N{MINUS SIGN}")
    return value + (f'<br><span style="font-size:0.85em;{DIM}">±{std:.2f}</span>' if np.isfinite(std) else "")


def colour_of_sensor(number: int) -> str:
    """Return the colour of a sensor in table and plot."""
    return SENSOR_COLOURS[number % len(SENSOR_COLOURS)]


def is_curve_redraw_due(viewer: ViewerPage, moment: PageMoment, moments: int) -> bool:
    """Return whether curves are redrawn: from time to time, and with every moment of a recording, but not while frozen."""
    return not viewer.is_frozen and (
        moments % PLOT_EVERY == 0 or moment.sensors[0].sensor.phase is SensorPhase.RECORDED
    )


class SensorGroupCurvesPanel:
    """One component of the wrench of all sensors over the last seconds, with the grip force beside the normal forces."""

    title, icon = "Wrenches, last seconds", Icon.CHART_LINE
    side: Side = "lower left"

    def __init__(self, viewer: ViewerPage) -> None:
        self._viewer, self._moments, self._shown = viewer, 0, _NORMAL

    def build(self, gui: GuiApi) -> None:
        """Add the choice of the component, and the plot."""
        sensors = self._viewer.controller.sensors
        names = [(number, one.name, source) for number, one in enumerate(sensors) for source in one.wrenches]
        choice = gui.add_dropdown("component", tuple(_COMPONENTS), initial_value=_NORMAL)
        choice.on_update(self._choose)
        series, bands = [uplot.Series(label="s ago")], []
        for number, name, source in names:
            colour, dash = colour_of_sensor(number), () if source.states_errors else (5.0, 4.0)
            label = f"{name} {source.name}"
            series.append(uplot.Series(label=label, stroke=colour, width=1.5, dash=dash))
            if source.states_errors:
                bands.append(uplot.Band(series=(len(series), len(series) + 1), fill=colour + BAND_OPACITY))
                series += [uplot.Series(label=f"{label} {sign} std", width=0) for sign in ("+", "−")]
        pairs = list(zip(sensors[::2], sensors[1::2], strict=False))
        self._grips = [
            (2 * number, source.name)
            for number, (one, other) in enumerate(pairs)
            for source in one.wrenches
            if source.name in {each.name for each in other.wrenches}
        ]
        series += [
            uplot.Series(
                label=f"grip {source}", stroke=GRIP_COLOUR, width=2.0, dash=() if source == "estimated" else (5.0, 4.0)
            )
            for _, source in self._grips
        ]
        self._sizes = [3 if source.states_errors else 1 for *_, source in names]
        self._columns = [(number, source.name) for number, _, source in names]
        self._plot = gui.add_uplot(
            (np.zeros(2),) * len(series),
            tuple(series),
            bands=tuple(bands),
            scales={"x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)), "y": uplot.Scale()},
            legend=uplot.Legend(show=False),
            height=240,
        )
        self._legend = gui.add_html("")

    def update(self, moment: PageMoment) -> None:
        """Redraw the curves from time to time, and not while they are frozen."""
        self._moments += 1
        self._legend.content = self._legend_html(moment.sensors)
        if is_curve_redraw_due(self._viewer, moment, self._moments):
            self._draw(moment.sensors)

    def _choose(self, event: GuiEvent[Any]) -> None:
        if is_user_event(event) and event.target.value in _COMPONENTS:
            self._shown = str(event.target.value)
            if self._viewer.moment is not None:
                self._draw(self._viewer.moment.sensors)

    def _draw(self, moments: Sequence[SensorMoment]) -> None:
        """Draw the chosen component of every source."""
        axis, scale = _COMPONENTS[self._shown]
        at_s, absent = np.linspace(-HISTORY_S, 0.0, CURVE_POINTS), np.full(CURVE_POINTS, np.nan)
        values: dict[tuple[int, str], Float64[Array, " n"]] = {}
        curves: list[Float64[Array, " n"]] = []
        for column, size in zip(self._columns, self._sizes, strict=True):
            source = _find_source(moments, *column)
            found = [] if source is None else list(component_curve_and_error_band(source, at_s, axis, scale))
            values[column] = found[0] if found else absent
            curves += found if len(found) == size else [absent] * size
        with_grip = self._shown == _NORMAL
        curves += [
            (values[number, source] + values[number + 1, source]) / 2 if with_grip else absent
            for number, source in self._grips
        ]
        largest = max((float(np.nanmax(np.abs(curve), initial=0.0)) for curve in curves), default=0.0)
        half = max(1.1 * largest, LEAST_N if axis < 3 else LEAST_NMM)
        self._plot.data = (at_s, *curves)
        low = -0.1 * half if with_grip else -half
        self._plot.scales = {
            "x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)),
            "y": uplot.Scale(range=(low, half)),
        }

    def _legend_html(self, moments: Sequence[SensorMoment]) -> str:
        """Return the colours of the sensors as HTML."""
        colours = [(moment.name, colour_of_sensor(number)) for number, moment in enumerate(moments)]
        colours += [("grip force", GRIP_COLOUR)] if self._grips and self._shown == _NORMAL else []
        parts = (f'<span style="color:{colour}">■</span> {escape(name)}' for name, colour in colours)
        dashed = "; true and measured are dashed" if any(size == 1 for size in self._sizes) else ""
        return f'<div style="margin:0 0.9em;font-size:0.85em">{" ".join(parts)}{dashed}</div>'


def _find_source(moments: Sequence[SensorMoment], number: int, name: str) -> WrenchSourceSnapshot | None:
    """Return a source of wrenches of one sensor; None where the moment has none, as that of another recording."""
    found = moments[number].wrenches if number < len(moments) else ()
    return next((source for source in found if source.name == name), None)

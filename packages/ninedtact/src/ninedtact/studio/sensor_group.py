"""Several sensors on one page: their states, their wrenches in one table and one plot, and the grip force of opposing ones.

Sensors oppose each other in pairs, in the order in which they are named: the first and the second, the third and the fourth. The
grip force of a pair is the mean of their normal forces −F_z. The readings of the sensors are each the newest, on one clock.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array
from viser import GuiApi, GuiEvent, Icon, uplot

from ninedtact.studio.page_cards import (
    BAND_OPACITY,
    CURVE_POINTS,
    LEAST_N,
    LEAST_NMM,
    card_html,
    component_curve_and_error_band,
    format_component,
    format_max_indentation,
    format_signed_hundredths,
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
    states = [(moment.name, moment.status.sentence, moment.status.tone, _format_measures(moment)) for moment in moments]
    return card_html("group_status", sensors=states)


def _format_measures(moment: SensorMoment) -> str:
    if moment.view is None:
        return ""
    summary = moment.view.summary
    return f"{format_max_indentation(summary)} mm, {summary.contact_area_mm2:.1f} mm²"


def group_wrench_table_html(moments: Sequence[SensorMoment]) -> str:
    """Return the grip forces, then the wrench of every sensor from every source as a row, with errors and warnings, as HTML."""
    if not any(moment.wrenches for moment in moments):
        return ""
    names_of_notice: dict[str, list[str]] = {}
    for moment in moments:
        for source in moment.wrenches:
            for notice in (*([str(source.trouble)] if source.trouble else []), *source.notices):
                names_of_notice.setdefault(notice, []).append(moment.name)
    return card_html(
        "group_wrench_table",
        grips=[(grip, *_format_grip(grip)) for grip in grip_forces(moments)],
        grip_colour=GRIP_COLOUR,
        sensors=[_sensor_rows(number, moment) for number, moment in enumerate(moments)],
        notices=[f"{', '.join(names)}: {notice}" for notice, names in names_of_notice.items()],
        meaning=dict.fromkeys(f"{one.name}: {one.meaning}" for moment in moments for one in moment.wrenches),
    )


def _format_grip(grip: GripForce) -> tuple[str, str]:
    """Return a grip force and its standard deviation, which may be empty."""
    if grip.force_n is None:
        return f"unknown without {grip.missing}", ""
    return f"{format_signed_hundredths(grip.force_n)} N", f"{grip.std_n:.2f}" if np.isfinite(grip.std_n) else ""


def _sensor_rows(number: int, moment: SensorMoment) -> tuple[object, ...]:
    """Return what the table says of one sensor: name, colour, whether it is past, warnings, and the wrench of each source."""
    known = [(source.name, source.sample) for source in moment.wrenches if source.sample is not None]
    warnings = dict.fromkeys(warning for _, sample in known for warning in sample.warnings)
    wrenches = [(name, [format_component(sample, axis, "?") for axis in range(6)]) for name, sample in known]
    return moment.name, colour_of_sensor(number), moment.status.is_past, warnings, wrenches


def colour_of_sensor(number: int) -> str:
    """Return the colour of a sensor in table and plot."""
    return SENSOR_COLOURS[number % len(SENSOR_COLOURS)]


def is_curve_redraw_due(viewer: ViewerPage, moment: PageMoment, moments: int) -> bool:
    """Return whether curves are redrawn: from time to time, and with every moment of a recording, but not while frozen."""
    return not viewer.is_frozen and (
        moments % PLOT_EVERY == 0 or moment.sensors[0].snapshot.phase is SensorPhase.RECORDED
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
        return card_html("sensor_legend", colours=colours, are_some_dashed=any(size == 1 for size in self._sizes))


def _find_source(moments: Sequence[SensorMoment], number: int, name: str) -> WrenchSourceSnapshot | None:
    """Return a source of wrenches of one sensor; None where the moment has none, as that of another recording."""
    found = moments[number].wrenches if number < len(moments) else ()
    return next((source for source in found if source.name == name), None)

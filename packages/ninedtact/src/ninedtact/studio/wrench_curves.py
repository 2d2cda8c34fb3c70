"""The curves of the wrenches over the last seconds: of one sensor beside the table of its wrenches, or of all sensors of a page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array
from viser import GuiApi, GuiEvent, Icon, uplot

from ninedtact.live.sensor_poller import HISTORY_S
from ninedtact.live.wrench_history import WrenchSourceSnapshot
from ninedtact.shape.coloured_height_map import round_up_to_1_2_5
from ninedtact.studio.page_cards import COLOURS, card_html, wrench_meaning_html, wrench_table_html
from ninedtact.studio.page_controller import PageMoment, SensorMoment
from ninedtact.studio.sensor_group import GRIP_COLOUR, colour_of_sensor
from ninedtact.studio.viewer import Side, ViewerPage, on_user_change

Curve = Float64[Array, " n"]
LEAST_N, LEAST_NMM = 2.0, 5.0
"""Smallest half range of the curves, so that noise stays small."""
CURVE_POINTS = 400
"""Number of points of a curve over the last seconds."""
_BAND_OPACITY = "22"
"""Opacity of the band of one standard deviation, in hexadecimal."""
_DASH = (5.0, 4.0)
_NO_TICKS = uplot.Axis_Ticks(show=False)
_NORMAL = "normal force −Fz, and grip (N)"
_COMPONENTS = {_NORMAL: (2, -1.0)} | {
    f"{letter}{axis} ({unit})": (first + number, scale)
    for letter, unit, first, scale in (("F", "N", 0, 1.0), ("T", "N·mm", 3, 1e3))
    for number, axis in enumerate("xyz")
}
"""What the plot of several sensors can show: number of the component, and its factor."""


def component_curve_and_error_band(moment: WrenchSourceSnapshot, at_s: Curve, axis: int, unit: float) -> list[Curve]:
    """Return one component of a source over the last seconds, and its upper and lower end where errors are stated.

    Beyond the samples the component is NaN. The ends meet there, because uPlot would fill some of what is between NaNs.
    """
    sampled_s, values, stds = moment.history[0], moment.history[1 + axis] * unit, moment.history[7 + axis] * abs(unit)
    if not sampled_s.size:
        return [np.full(at_s.shape, np.nan)] * (3 if moment.states_errors else 1)
    stds = np.where(np.isfinite(stds), stds, 0.0)
    ends = (values + stds, values - stds) if moment.states_errors else ()
    bands = [np.interp(at_s, sampled_s, end, left=values[0], right=values[-1]) for end in ends]
    return [np.interp(at_s, sampled_s, values, left=np.nan, right=np.nan), *bands]


@dataclass(frozen=True)
class PlottedCurve:
    """How one component of one source of wrenches is drawn."""

    label: str
    colour: str
    is_dashed: bool = False
    has_band: bool = False
    """Whether a band of one standard deviation is drawn too."""
    width: float = 1.5


class LastSecondsPlot:
    """A plot of curves over the last seconds."""

    at_s = np.linspace(-HISTORY_S, 0.0, CURVE_POINTS)
    """The times of all curves, in seconds before now (negative)."""

    def __init__(self, gui: GuiApi, curves: Sequence[PlottedCurve], height: int, title: str = "") -> None:
        series, bands = [uplot.Series(label="s ago")], []
        for one in curves:
            dash = _DASH if one.is_dashed else ()
            series.append(uplot.Series(label=one.label, stroke=one.colour, width=one.width, dash=dash))
            if one.has_band:
                bands.append(uplot.Band(series=(len(series), len(series) + 1), fill=one.colour + _BAND_OPACITY))
                series += [uplot.Series(label=f"{one.label} {sign} std", width=0) for sign in ("+", "−")]
        self._sizes = [3 if one.has_band else 1 for one in curves]
        self._plot = gui.add_uplot(
            (np.zeros(2),) * len(series),
            tuple(series),
            bands=tuple(bands),
            scales={"x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)), "y": uplot.Scale()},
            axes=(uplot.Axis(size=26, ticks=_NO_TICKS), uplot.Axis(ticks=_NO_TICKS)),
            legend=uplot.Legend(show=False),
            title=title or None,
            height=height,
        )

    def draw(self, curves: Sequence[Sequence[Curve]], least: float, low: float = -1.0) -> None:
        """Draw all curves, each with its band. least: half range at least. low: lower end of the range, in upper ends."""
        absent = np.full(CURVE_POINTS, np.nan)
        shown = [
            one
            for found, size in zip(curves, self._sizes, strict=True)
            for one in (found if len(found) == size else [absent] * size)
        ]
        largest = max((float(np.nanmax(np.abs(one), initial=0.0)) for one in shown), default=0.0)
        # Both ends of such a range, and zero, are marked with their numbers.
        half = 1.25 * round_up_to_1_2_5(max(largest, least))
        self._plot.data = (self.at_s, *shown)
        self._plot.scales = {
            "x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)),
            "y": uplot.Scale(range=(low * half, half)),
        }


class WrenchAndCurvesPanel:
    """The wrenches of one sensor: the table of this moment, where `StatusPanel` does not show it, and curves of the last seconds.

    Where there are several sources, wrenches without stated errors (true, measured) are drawn dashed.
    """

    title, icon = "Wrench", Icon.CHART_LINE
    side: Side = "lower left"

    def __init__(self, viewer: ViewerPage) -> None:
        self._viewer = viewer

    def build(self, gui: GuiApi) -> None:
        """Add the table and the plots."""
        self._table = gui.add_html("", visible=not self._viewer.is_tall)
        self._sources = self._viewer.controller.sensors[0].wrenches
        parts = (("force (N)", "F", 0, 1.0, LEAST_N), ("torque (N·mm)", "T", 3, 1e3, LEAST_NMM))
        self._plots = [
            (LastSecondsPlot(gui, self._curves(letter), 112, f"{title}: x orange, y green, z blue"), first, unit, least)
            for title, letter, first, unit, least in parts
        ]
        self._meaning = gui.add_html("")

    def _curves(self, letter: str) -> list[PlottedCurve]:
        are_several = len(self._sources) > 1
        return [
            PlottedCurve(
                f"{letter}_{axis} {one.name}", colour, are_several and not one.states_errors, one.states_errors
            )
            for one in self._sources
            for axis, colour in COLOURS.items()
        ]

    def update(self, moment: PageMoment) -> None:
        """Show the wrenches of this moment; redraw the curves from time to time, and not while they are frozen."""
        sensor = moment.sensors[0]  # a recording may have several, or no wrenches
        self._meaning.content = wrench_meaning_html(sensor.wrenches, has_curves=True) if sensor.wrenches else ""
        if not self._viewer.is_tall:
            self._table.content = wrench_table_html(sensor.wrenches, sensor.status.is_past) if sensor.wrenches else ""
        if not self._viewer.redraws_curves or not sensor.wrenches:
            return
        for plot, first, unit, least in self._plots:
            plot.draw(
                [
                    component_curve_and_error_band(source, plot.at_s, axis, unit)
                    for source in sensor.wrenches[: len(self._sources)]
                    for axis in range(first, first + 3)
                ],
                least,
            )


class SensorGroupCurvesPanel:
    """One component of the wrench of all sensors over the last seconds, with the grip force beside the normal forces."""

    title, icon = "Wrenches, last seconds", Icon.CHART_LINE
    side: Side = "lower left"

    def __init__(self, viewer: ViewerPage) -> None:
        self._viewer, self._shown = viewer, _NORMAL

    def build(self, gui: GuiApi) -> None:
        """Add the choice of the component, and the plot."""
        sensors = self._viewer.controller.sensors
        choice = gui.add_dropdown("component", tuple(_COMPONENTS), initial_value=_NORMAL)
        on_user_change(choice, self._choose)
        self._columns = [(number, one.name) for number, sensor in enumerate(sensors) for one in sensor.wrenches]
        curves = [
            PlottedCurve(
                f"{sensor.name} {one.name}", colour_of_sensor(number), not one.states_errors, one.states_errors
            )
            for number, sensor in enumerate(sensors)
            for one in sensor.wrenches
        ]
        self._grips = list(_grips(self._columns, len(sensors)))
        curves += [
            PlottedCurve(f"grip {source}", GRIP_COLOUR, source != "estimated", width=2.0) for _, source in self._grips
        ]
        self._are_some_dashed = any(one.is_dashed for one in curves)
        self._plot = LastSecondsPlot(gui, curves, 240)
        self._legend = gui.add_html("")

    def update(self, moment: PageMoment) -> None:
        """Redraw the curves from time to time, and not while they are frozen."""
        colours = [(one.name, colour_of_sensor(number)) for number, one in enumerate(moment.sensors)]
        colours += [("grip force", GRIP_COLOUR)] if self._grips and self._shown == _NORMAL else []
        self._legend.content = card_html("sensor_legend", colours=colours, are_some_dashed=self._are_some_dashed)
        if self._viewer.redraws_curves:
            self._draw(moment.sensors)

    def _choose(self, event: GuiEvent[Any]) -> None:
        if event.target.value in _COMPONENTS:
            self._shown = str(event.target.value)
            if self._viewer.moment is not None:
                self._draw(self._viewer.moment.sensors)

    def _draw(self, moments: Sequence[SensorMoment]) -> None:
        """Draw the chosen component of every source; one that a moment has not, as of another recording, is left out."""
        axis, scale = _COMPONENTS[self._shown]
        found = {(number, source.name): source for number, one in enumerate(moments) for source in one.wrenches}
        curves: dict[tuple[int, str], list[Curve]] = {}
        for column in self._columns:
            source = found.get(column)
            curves[column] = (
                [] if source is None else component_curve_and_error_band(source, self._plot.at_s, axis, scale)
            )
        with_grip = self._shown == _NORMAL
        fingers = [(curves[number, source], curves[number + 1, source]) for number, source in self._grips]
        grips = [[(one[0] + other[0]) / 2] if with_grip and one and other else [] for one, other in fingers]
        least = LEAST_N if axis < 3 else LEAST_NMM
        self._plot.draw([*curves.values(), *grips], least, -0.1 if with_grip else -1.0)


def _grips(columns: Sequence[tuple[int, str]], sensors: int) -> Iterator[tuple[int, str]]:
    """Yield the first finger of each two opposing sensors and the name of a source, for each source that both have."""
    for number, source in columns:
        if number % 2 == 0 and number + 1 < sensors and (number + 1, source) in columns:
            yield number, source

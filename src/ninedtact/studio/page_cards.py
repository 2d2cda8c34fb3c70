"""The cards of the live page: measured values, status and wrenches as HTML, which follows the light or dark theme; and the marks
of labels on the time slider."""

from collections.abc import Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array
from viser import GuiApi, GuiUplotHandle, uplot

from ninedtact.quantities import DISPLAY_FACTORS, DISPLAY_UNITS, WRENCH_AXES
from ninedtact.shape.coloured_height_map import ColourScale
from ninedtact.shape.measures import ShapeSummary
from ninedtact.studio.page_controller import SensorStatusMessage
from ninedtact.studio.page_recorder import RecorderState
from ninedtact.studio.reading_view import HeightProfile
from ninedtact.studio.scene_3d import ARC_DEG_PER_NMM, MM_PER_N, format_signed_tenths
from ninedtact.studio.sensor_poller import HISTORY_S
from ninedtact.studio.skin_fields import NO_CONTACT, SLIP, STICK
from ninedtact.studio.wrench_history import WrenchHistory, WrenchSourceSnapshot, WrenchWithUncertainty

if TYPE_CHECKING:  # a page without recordings does not need its libraries
    from ninedtact.studio.recording_player import RecordingPlayer

TONES = {"live": "#2b8a3e", "busy": "#b7791f", "held": "#1c6fb7", "lost": "#c92a2a", "warned": "#c92a2a"}
DIM = "color:var(--mantine-color-dimmed)"
PALE = 0.35
"""Opacity of numbers that are not current."""
NOTABLE_SHARE = 0.01
"""Share of the contact beyond the calibrated range from which the page shows a warning."""


def status_html(status: SensorStatusMessage) -> str:
    """Return the state of the sensor as HTML, in its colour."""
    return (
        f'<div role="status" style="margin:0.5em;padding:0.5em 0.8em;border-radius:6px;color:#fff;font-weight:600;'
        f'font-size:0.95em;line-height:1.35;background:{TONES[status.tone]}">{escape(status.sentence)}</div>'
    )


def shape_summary_html(summary: ShapeSummary, is_past: bool) -> str:
    """Return maximum indentation, contact area, contact centre and a warning as HTML."""
    x_y = summary.contact_centre_mm
    where = (
        "nothing touches"
        if x_y is None
        else f"centre at x {format_signed_tenths(x_y[0])}, y {format_signed_tenths(x_y[1])} mm"
    )
    beyond = summary.extrapolated_share
    warning = f"{beyond:.0%} of the contact lies beyond the calibrated range" if beyond > NOTABLE_SHARE else "&nbsp;"
    return (
        f'<div style="opacity:{PALE if is_past else 1}">'
        '<div style="display:flex;gap:0.6em;margin:0.2em 0.5em">'
        + _large_number_html("maximum indentation", f"{summary.max_indentation_mm:.2f}", "mm")
        + _large_number_html("contact area", f"{summary.contact_area_mm2:.1f}", "mm²")
        + "</div>"
        + f'<div style="margin:0 0.9em;font-size:0.85em;{DIM}">{where}</div>'
        + f'<div style="margin:0 0.9em;font-size:0.85em;color:{TONES["busy"]}">{warning}</div></div>'
    )


def _large_number_html(name: str, number: str, unit: str) -> str:
    """Return one large number with its name and unit as HTML."""
    return (
        '<div style="flex:1;padding:0.4em 0.6em;border:1px solid var(--mantine-color-default-border);'
        f'border-radius:6px"><div style="font-size:0.8em;{DIM}">{name}</div><div style="white-space:nowrap">'
        f'<span style="font-size:1.7em;font-weight:600;font-variant-numeric:tabular-nums">{number}</span>'
        f' <span style="{DIM}">{unit}</span></div></div>'
    )


def name_value_table_html(rows: dict[str, str]) -> str:
    """Return a table of names and values as HTML."""
    cells = "".join(
        f'<tr><td style="{DIM};padding:0.1em 1em 0.1em 0">{escape(name)}</td>'
        f'<td style="font-variant-numeric:tabular-nums">{escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    return f'<table style="margin:0.2em 0.9em;font-size:0.9em;border-collapse:collapse">{cells}</table>'


def height_legend_html(scale: ColourScale) -> str:
    """Return the colours of heights with their mm as HTML."""
    colours = ",".join("#" + bytes(colour).hex() for colour in scale.table[1::6].tolist())
    ends = [
        format_signed_tenths(-scale.pressed_mm),
        format_signed_tenths(-scale.pressed_mm / 2),
        "0 mm",
        f"+{scale.bulged_mm:g}",
    ]
    zero = 100 * scale.pressed_mm / (scale.pressed_mm + scale.bulged_mm)
    texts = "".join(
        f'<span style="position:absolute;left:{place:.1f}%;transform:translateX({shift}%)">{text}</span>'
        for text, place, shift in zip(ends, (0, zero / 2, zero, 100), (0, -50, -50, -100), strict=True)
    )
    return (
        f'<div style="margin:0 0.7em"><div style="height:10px;border-radius:3px;background:linear-gradient(90deg,'
        f'{colours})"></div><div style="position:relative;height:1.6em;font-size:0.8em;{DIM}">{texts}</div></div>'
    )


def magnitude_legend_html(name: str, end_mpa: float) -> str:
    """Return the colours of pressure or shear with the MPa at their end as HTML."""
    levels = cv2.applyColorMap(np.arange(0, 256, 17, dtype=np.uint8)[None], cv2.COLORMAP_CIVIDIS)[0, :, ::-1]
    colours = ",".join("#" + bytes(colour).hex() for colour in levels.tolist())
    return (
        f'<div style="margin:0 0.7em"><div style="height:10px;border-radius:3px;background:linear-gradient(90deg,{colours})">'
        f'</div><div style="display:flex;justify-content:space-between;font-size:0.8em;{DIM}"><span>0</span>'
        f"<span>{escape(name)}</span><span>{end_mpa:g} MPa</span></div></div>"
    )


def sticking_legend_html() -> str:
    """Return the colours of stick and slip as HTML."""
    parts = (("sticks", STICK), ("slips", SLIP), ("no contact", NO_CONTACT))
    return (
        '<div style="margin:0 0.7em;font-size:0.8em">'
        + " ".join(
            f'<span style="display:inline-block;width:0.9em;height:0.9em;background:#{bytes(bgr[::-1]).hex()}"></span> {name}'
            for name, bgr in parts
        )
        + "</div>"
    )


def profile_summary_html(profile: HeightProfile) -> str:
    """Return the heights at both ends and the lowest point of a line as HTML."""
    rows = {"A": _format_height(profile, 0), "B": _format_height(profile, -1)}
    if np.isfinite(profile.height_mm).any():
        lowest = int(np.nanargmin(profile.height_mm))
        rows[f"lowest, {profile.distance_mm[lowest]:.1f} mm from A"] = _format_height(profile, lowest)
    return name_value_table_html(rows)


def _format_height(profile: HeightProfile, number: int) -> str:
    """Return the height at one point of a line, with the true one where it is known."""
    height = profile.height_mm[number]
    seen = f"{height:+.2f} mm" if np.isfinite(height) else "out of view"
    true = "" if profile.true_mm is None else f" (true {profile.true_mm[number]:+.2f} mm)"
    return (seen + true).replace("-", "\N{MINUS SIGN}")


COLOURS = {"x": "#d55e00", "y": "#009e73", "z": "#0072b2"}
"""Vermilion, green and blue of Okabe and Ito, which colour-blind readers can distinguish."""
LEAST_N, LEAST_NMM = 2.0, 4.0
"""Smallest half range of the curves, so that noise stays small."""
CURVE_POINTS = 400
"""Number of points of a curve over the last seconds."""
BAND_OPACITY = "22"
"""Opacity of the band of one standard deviation, in hexadecimal."""


class WrenchCurves:
    """The last seconds of the wrenches of all sources, on top of each other in two plots.

    Where there are several sources, wrenches without stated errors (true, measured) are drawn dashed.
    """

    def __init__(self, gui: GuiApi, sources: Sequence[WrenchHistory]) -> None:
        self._forces = _add_curves(gui, "force (N)", "F", LEAST_N, sources)
        self._torques = _add_curves(gui, "torque (N·mm)", "T", LEAST_NMM, sources)
        gui.add_html(f'<div style="margin:0 0.9em;font-size:0.75em;{DIM}">{escape(_describe_lines(sources))}</div>')

    def draw(self, moments: Sequence[WrenchSourceSnapshot]) -> None:
        """Draw the last seconds of every source."""
        at_s = np.linspace(-HISTORY_S, 0.0, CURVE_POINTS)
        for plot, first, unit, least in ((self._forces, 0, 1.0, LEAST_N), (self._torques, 3, 1e3, LEAST_NMM)):
            curves = [curve for moment in moments for curve in _curves_of(moment, at_s, first, unit)]
            largest = max((float(np.nanmax(np.abs(curve), initial=0.0)) for curve in curves), default=0.0)
            plot.data = (at_s, *curves)
            plot.scales = _curve_scales(max(largest * 1.1, least))


def wrench_table_html(moments: Sequence[WrenchSourceSnapshot], is_past: bool) -> str:
    """Return the wrenches in columns, with warnings, as HTML."""
    known = [moment for moment in moments if moment.sample is not None]
    head = "".join(
        f'<th style="text-align:right;font-weight:600" title="{escape(moment.meaning)}">{escape(moment.name)}</th>'
        for moment in known
    )
    rows = "".join(_component_row_html(number, known) for number in range(6))
    warnings = [warning for moment in known if moment.sample for warning in moment.sample.warnings]
    badges = "".join(warning_badge_html(warning) for warning in warnings)
    lines = [(TONES["lost"], str(moment.trouble)) for moment in moments if moment.trouble is not None]
    lines += [(TONES["busy"], notice) for moment in moments for notice in moment.notices]
    below = "".join(f'<div style="font-size:0.85em;color:{colour}">{escape(line)}</div>' for colour, line in lines)
    return (
        f'<div style="margin:0.3em 0.9em;line-height:1.35;opacity:{PALE if is_past else 1}">'
        f'<table style="width:100%;font-variant-numeric:tabular-nums"><tr><th style="text-align:left">wrench</th>{head}</tr>{rows}'
        f"</table>{badges}{below}</div>"
    )


def wrench_meaning_html(moments: Sequence[WrenchSourceSnapshot]) -> str:
    """Return what the columns of wrenches mean, and the scale of the arrow, as HTML."""
    meaning = "; ".join(f"{moment.name}: {moment.meaning}" for moment in moments)
    scale = f"about the skin's centre; arrow {MM_PER_N:g} mm per N, arc {ARC_DEG_PER_NMM:g}° per N·mm of twist"
    return f'<div style="margin:0.3em 0.9em;font-size:0.75em;{DIM}">{escape(meaning)}; {scale}</div>'


def explained_wrench_table_html(moments: Sequence[WrenchSourceSnapshot], is_past: bool) -> str:
    """Return the wrenches in columns, with warnings and what the columns mean, as HTML; empty without wrenches."""
    return wrench_table_html(moments, is_past) + wrench_meaning_html(moments) if moments else ""


def _component_row_html(number: int, moments: Sequence[WrenchSourceSnapshot]) -> str:
    """Return one component of every wrench as a row of a table, with one standard deviation where it is known."""
    letter, axis = WRENCH_AXES[number][0], WRENCH_AXES[number][1]
    unit, scale = DISPLAY_UNITS[number], DISPLAY_FACTORS[number]
    cells = "".join(
        f'<td style="text-align:right;white-space:nowrap">{_format_component(moment.sample, number, scale)}</td>'
        for moment in moments
        if moment.sample is not None
    )
    name = f'<td style="color:{COLOURS[axis]};font-weight:600">{letter}<sub style="line-height:0">{axis}</sub>'
    return f'<tr>{name} <span style="font-weight:400;{DIM}">{unit}</span></td>{cells}</tr>'


def _format_component(sample: WrenchWithUncertainty, number: int, scale: float) -> str:
    """Return a component and its standard deviation; nothing is known where the standard deviation is infinite."""
    std = scale * sample.std[number]
    if np.isinf(std):
        return "unknown"
    value = f"{scale * sample.wrench.six[number]:+.2f}".replace("-", "\N{MINUS SIGN}")
    return value + (f' <span style="{DIM}">± {std:.2f}</span>' if np.isfinite(std) else "")


def warning_badge_html(text: str) -> str:
    """Return a warning as a badge."""
    return (
        f'<span style="display:inline-block;margin:0.1em 0.3em 0.1em 0;padding:0.1em 0.6em;border-radius:1em;color:#fff;'
        f'font-size:0.8em;background:{TONES["busy"]}">{escape(text)}</span>'
    )


def _add_curves(gui: GuiApi, title: str, letter: str, half: float, sources: Sequence[WrenchHistory]) -> GuiUplotHandle:
    """Add a plot of three curves of each source, with a band of one standard deviation where it is stated."""
    series, bands = [uplot.Series(label="s ago")], []
    for source in sources:
        dash = (5.0, 4.0) if len(sources) > 1 and not source.states_errors else ()
        for axis, colour in COLOURS.items():
            label = f"{letter}_{axis} {source.name}"
            series.append(uplot.Series(label=label, stroke=colour, width=1.5, dash=dash))
            if source.states_errors:
                bands.append(uplot.Band(series=(len(series), len(series) + 1), fill=colour + BAND_OPACITY))
                series += [uplot.Series(label=f"{label} {sign} std", width=0) for sign in ("+", "−")]
    return gui.add_uplot(
        (np.zeros(2),) * len(series),
        tuple(series),
        bands=tuple(bands),
        scales=_curve_scales(half),
        legend=uplot.Legend(show=False),
        title=f"{title}: x orange, y green, z blue",
        height=150,
    )


def _describe_lines(sources: Sequence[WrenchHistory]) -> str:
    """Return how the curves of each source are drawn, as `_add_curves` does."""
    solid = "solid, with a band of one standard deviation"
    dashed = "dashed" if len(sources) > 1 else "solid"
    return "; ".join(f"{source.name}: {solid if source.states_errors else dashed}" for source in sources)


def _curves_of(
    moment: WrenchSourceSnapshot, at_s: Float64[Array, " n"], first: int, unit: float
) -> Iterator[Float64[Array, " n"]]:
    """Yield what `_add_curves` draws of one source: each axis, and its upper and lower end where errors are stated."""
    for axis in range(first, first + 3):
        yield from component_curve_and_error_band(moment, at_s, axis, unit)


def component_curve_and_error_band(
    moment: WrenchSourceSnapshot, at_s: Float64[Array, " n"], axis: int, unit: float
) -> Iterator[Float64[Array, " n"]]:
    """Yield one component of a source over the last seconds, and its upper and lower end where errors are stated.

    Beyond the samples the component is NaN. The ends meet there, because uPlot would fill some of what is between NaNs.
    """
    sampled_s, values, stds = moment.history[0], moment.history[1 + axis] * unit, moment.history[7 + axis] * abs(unit)
    stds = np.where(np.isfinite(stds), stds, 0.0)
    if not sampled_s.size:
        yield from (np.full(at_s.shape, np.nan) for _ in range(3 if moment.states_errors else 1))
        return
    yield np.interp(at_s, sampled_s, values, left=np.nan, right=np.nan)
    for end in (values + stds, values - stds) if moment.states_errors else ():
        yield np.interp(at_s, sampled_s, end, left=values[0], right=values[-1])


def _curve_scales(half: float) -> dict[str, uplot.Scale]:
    """Return the axes of the curves: the last seconds, and values about zero."""
    return {"x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)), "y": uplot.Scale(range=(-half, half))}


def recorder_html(state: RecorderState) -> str:
    """Return length, size, drops and labels of the recording, and why it ended."""
    if state.path is None:
        return ""
    said = f"{state.seconds:.1f} s, {state.written_bytes / 1e6:.1f} MB, {state.dropped} images dropped"
    if state.is_running:  # labels of a recording that has ended are added to its file
        said += f", {state.labels} labels"
    begun = "recording" if state.is_running else "recorded"
    trouble = f'<div style="color:{TONES["lost"]}">{escape(state.trouble)}</div>' if state.trouble else ""
    return f'<div role="log" style="margin:0.2em 0.9em;font-size:0.85em">{begun} {escape(state.path.name)}: {said}{trouble}</div>'


_MARK_LETTERS, _MARK_ROOM = 10, 0.2
"""Number of letters of a label that are drawn on the time slider, and the share of it that they take."""


def time_slider_marks(player: "RecordingPlayer") -> Iterator[tuple[float, str | None]]:
    """Yield what is drawn on the time slider: its end, and both ends of every label, with its name where there is room for it."""
    duration_s, free_s = player.duration_s, 0.0
    room_s = _MARK_ROOM * duration_s
    ends = [(player.span_s(span)[end], "" if end else span.label) for span in player.spans for end in (0, 1)]
    for at_s, label in sorted((min(max(at_s, 0.0), duration_s), label) for at_s, label in ends):
        has_room = bool(label) and free_s <= at_s <= duration_s - room_s
        free_s = at_s + room_s if has_room else free_s
        yield at_s, label[:_MARK_LETTERS] if has_room else None
    yield duration_s, f"{duration_s:.1f} s"

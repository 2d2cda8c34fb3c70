"""The cards of the live page: measured values, status and wrenches as HTML, which follows the light or dark theme."""

from html import escape

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array
from viser import GuiUplotHandle, ViserServer, uplot

from ninedtact.quantities import Wrench, WrenchEstimate
from ninedtact.shape.coloured_height_map import ColourScale
from ninedtact.shape.measures import ShapeSummary
from ninedtact.studio.displayed_reading import SensorStatus
from ninedtact.studio.scene_3d import ARC_DEG_PER_NMM, MM_PER_N, format_signed_tenths
from ninedtact.studio.sensor_poller import HISTORY_S
from ninedtact.studio.wrench_poller import WrenchSnapshot

TONES = {"live": "#2b8a3e", "busy": "#b7791f", "held": "#1c6fb7", "lost": "#c92a2a", "warned": "#c92a2a"}
DIM = "color:var(--mantine-color-dimmed)"
PALE = 0.35
"""Opacity of numbers that are not current."""
NOTABLE_SHARE = 0.01
"""Share of the contact beyond the calibrated range from which the page shows a warning."""


def status_html(status: SensorStatus) -> str:
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


def colour_legend_html(scale: ColourScale) -> str:
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


COLOURS = {"x": "#c92a2a", "y": "#2b8a3e", "z": "#1c6fb7"}
LEAST_N, LEAST_NMM = 2.0, 4.0
"""Smallest half range of the curves, so that noise stays small."""


class WrenchCard:
    """The six components of one wrench source on the page, and their last seconds as curves."""

    def __init__(self, server: ViserServer) -> None:
        self._text = server.gui.add_html("")
        self._forces = _add_curves(server, "force (N)", "F", LEAST_N)
        self._torques = _add_curves(server, "torque (N·mm)", "T", LEAST_NMM)

    def show_numbers(self, moment: WrenchSnapshot, is_past: bool, estimate: WrenchEstimate | None = None) -> None:
        """Show the six components; those of an estimate with their standard deviations and warnings."""
        self._text.content = wrench_html(moment, is_past, estimate)

    def draw_curves(self, moment: WrenchSnapshot) -> None:
        """Draw the last seconds as curves."""
        at_s, forces, torques = moment.history[0], moment.history[1:4], 1e3 * moment.history[4:7]
        for plot, values, least in ((self._forces, forces, LEAST_N), (self._torques, torques, LEAST_NMM)):
            plot.data = (at_s, *values)
            plot.scales = _curve_scales(max(float(np.abs(values).max(initial=0)) * 1.1, least))


def wrench_html(moment: WrenchSnapshot, is_past: bool, estimate: WrenchEstimate | None = None) -> str:
    """Return the six components and the scale of the arrow as HTML.

    estimate: the estimate that the wrench belongs to; its standard deviations and warnings are shown.
    """
    std = None if estimate is None else estimate.std
    rows = "" if moment.wrench is None else "".join(_axis_row_html(axis, moment.wrench, std) for axis in "xyz")
    warnings = "" if estimate is None else ", ".join(estimate.warnings)
    lines = [(TONES["busy"], warnings), (TONES["lost"], str(moment.trouble or ""))]
    lines += [(TONES["busy"], notice) for notice in moment.notices]
    below = "".join(
        f'<div style="font-size:0.85em;color:{colour}">{escape(line)}</div>' for colour, line in lines if line
    )
    scale = f"about the skin's centre; arrow {MM_PER_N:g} mm per N, arc {ARC_DEG_PER_NMM:g}° per N·mm of twist"
    return (
        f'<div style="margin:0.3em 0.9em;opacity:{PALE if is_past else 1}"><b>{escape(moment.name)}</b>'
        f'<table style="width:100%;font-variant-numeric:tabular-nums">{rows}</table>{below}'
        f'<div style="font-size:0.75em;{DIM}">{scale}</div></div>'
    )


def _axis_row_html(axis: str, wrench: Wrench, std: Float64[Array, "6"] | None) -> str:
    """Return force and torque along one axis as a row of a table, with one standard deviation of each where they are known."""
    number = "xyz".index(axis)
    stds = (np.nan, np.nan) if std is None else (std[number], 1e3 * std[3 + number])
    force, torque = (
        f"{value:+.2f}".replace("-", "\N{MINUS SIGN}") + (f" ± {error:.2f}" if np.isfinite(error) else "")
        for value, error in zip((wrench.force_n[number], 1e3 * wrench.torque_nm[number]), stds, strict=True)
    )
    name = f'<td style="color:{COLOURS[axis]};font-weight:600">{{}}<sub>{axis}</sub></td>'
    value = '<td style="text-align:right">{} <span style="' + DIM + '">{}</span></td>'
    return f"<tr>{name.format('F')}{value.format(force, 'N')}<td>&ensp;</td>{name.format('T')}{value.format(torque, 'N·mm')}</tr>"


def _add_curves(server: ViserServer, title: str, letter: str, half: float) -> GuiUplotHandle:
    """Add a plot of three curves over the last seconds."""
    lines = (uplot.Series(label=f"{letter}_{axis}", stroke=colour, width=1.5) for axis, colour in COLOURS.items())
    return server.gui.add_uplot(
        (np.zeros(2),) * 4,
        (uplot.Series(label="s ago"), *lines),
        scales=_curve_scales(half),
        legend=uplot.Legend(show=False),
        title=f"{title}: x red, y green, z blue",
        height=160,
    )


def _curve_scales(half: float) -> dict[str, uplot.Scale]:
    """Return the axes of the curves: the last seconds, and values about zero."""
    return {"x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)), "y": uplot.Scale(range=(-half, half))}

"""The figures of the page as small pieces of HTML, which follow the light or dark theme of the page."""

from html import escape

from ninedtact.shape.image.palette import ColourScale
from ninedtact.shape.measures import ShapeSummary
from ninedtact.studio.ruler import signed
from ninedtact.studio.status import Status

TONES = {"live": "#2b8a3e", "busy": "#b7791f", "held": "#1c6fb7", "lost": "#c92a2a"}
DIM = "color:var(--mantine-color-dimmed)"
PALE = 0.35
"""Opacity of figures that are not of the present."""
NOTABLE_SHARE = 0.01
"""Part of the contact beyond the calibrated range from which on it is said."""


def status_card(status: Status) -> str:
    """The sentence about everything else, in its colour."""
    return (
        f'<div role="status" style="margin:0.5em;padding:0.5em 0.8em;border-radius:6px;color:#fff;font-weight:600;'
        f'font-size:0.95em;line-height:1.35;background:{TONES[status.tone]}">{escape(status.sentence)}</div>'
    )


def figures_card(summary: ShapeSummary, is_past: bool) -> str:
    """The two figures that a person looks for, and what to hold against them."""
    x_y = summary.contact_centre_mm
    where = "nothing touches" if x_y is None else f"centre at x {signed(x_y[0])}, y {signed(x_y[1])} mm"
    beyond = summary.extrapolated_share
    warning = f"{beyond:.0%} of the contact lies beyond the calibrated range" if beyond > NOTABLE_SHARE else "&nbsp;"
    return (
        f'<div style="opacity:{PALE if is_past else 1}">'
        '<div style="display:flex;gap:0.6em;margin:0.2em 0.5em">'
        + figure("deepest", f"{summary.max_indentation_mm:.2f}", "mm")
        + figure("contact", f"{summary.contact_area_mm2:.1f}", "mm²")
        + "</div>"
        + f'<div style="margin:0 0.9em;font-size:0.85em;{DIM}">{where}</div>'
        + f'<div style="margin:0 0.9em;font-size:0.85em;color:{TONES["busy"]}">{warning}</div></div>'
    )


def figure(name: str, number: str, unit: str) -> str:
    """One large number."""
    return (
        '<div style="flex:1;padding:0.4em 0.6em;border:1px solid var(--mantine-color-default-border);'
        f'border-radius:6px"><div style="font-size:0.8em;{DIM}">{name}</div><div style="white-space:nowrap">'
        f'<span style="font-size:1.7em;font-weight:600;font-variant-numeric:tabular-nums">{number}</span>'
        f' <span style="{DIM}">{unit}</span></div></div>'
    )


def rows_card(rows: dict[str, str]) -> str:
    """Names and values below each other."""
    cells = "".join(
        f'<tr><td style="{DIM};padding:0.1em 1em 0.1em 0">{escape(name)}</td>'
        f'<td style="font-variant-numeric:tabular-nums">{escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    return f'<table style="margin:0.2em 0.9em;font-size:0.9em;border-collapse:collapse">{cells}</table>'


def legend_card(scale: ColourScale) -> str:
    """The colours of heights with mm below them."""
    colours = ",".join("#" + bytes(colour).hex() for colour in scale.table[1::6].tolist())
    ends = [signed(-scale.pressed_mm), signed(-scale.pressed_mm / 2), "0 mm", f"+{scale.bulged_mm:g}"]
    zero = 100 * scale.pressed_mm / (scale.pressed_mm + scale.bulged_mm)
    texts = "".join(
        f'<span style="position:absolute;left:{place:.1f}%;transform:translateX({shift}%)">{text}</span>'
        for text, place, shift in zip(ends, (0, zero / 2, zero, 100), (0, -50, -50, -100), strict=True)
    )
    return (
        f'<div style="margin:0 0.7em"><div style="height:10px;border-radius:3px;background:linear-gradient(90deg,'
        f'{colours})"></div><div style="position:relative;height:1.6em;font-size:0.8em;{DIM}">{texts}</div></div>'
    )

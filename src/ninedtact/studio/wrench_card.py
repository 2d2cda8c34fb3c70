"""A wrench on the page: six numbers, and their last seconds as curves."""

from html import escape

import numpy as np
from viser import GuiUplotHandle, ViserServer, uplot

from ninedtact.quantities import Wrench
from ninedtact.studio.arrows import ARC_DEG_PER_MNM, MM_PER_N
from ninedtact.studio.cards import DIM, PALE, TONES
from ninedtact.studio.history import HISTORY_S
from ninedtact.studio.wrench_loop import WrenchMoment

COLOURS = {"x": "#c92a2a", "y": "#2b8a3e", "z": "#1c6fb7"}
LEAST_N, LEAST_MNM = 2.0, 4.0
"""Half of the curves' range at least, so that noise stays small."""


class WrenchCard:
    """One source of wrenches on the page."""

    def __init__(self, server: ViserServer) -> None:
        self._text = server.gui.add_html("")
        self._forces = curves(server, "force (N)", "F", LEAST_N)
        self._torques = curves(server, "torque (mN·m)", "T", LEAST_MNM)

    def tell(self, moment: WrenchMoment, is_past: bool) -> None:
        """The numbers."""
        self._text.content = card(moment, is_past)

    def draw(self, moment: WrenchMoment) -> None:
        """The curves."""
        at_s, forces, torques = moment.history[0], moment.history[1:4], 1e3 * moment.history[4:7]
        for plot, values, least in ((self._forces, forces, LEAST_N), (self._torques, torques, LEAST_MNM)):
            plot.data = (at_s, *values)
            plot.scales = scales(max(float(np.abs(values).max(initial=0)) * 1.1, least))


def card(moment: WrenchMoment, is_past: bool) -> str:
    """Six numbers in a small table, and how the scene shows them."""
    rows = "" if moment.wrench is None else "".join(row(axis, moment.wrench) for axis in "xyz")
    trouble = (
        "" if moment.trouble is None else f'<div style="color:{TONES["lost"]}">{escape(str(moment.trouble))}</div>'
    )
    scale = f"about the skin's centre; arrow {MM_PER_N:g} mm per N, arc {ARC_DEG_PER_MNM:g}° per mN·m of twist"
    return (
        f'<div style="margin:0.3em 0.9em;opacity:{PALE if is_past else 1}"><b>{escape(moment.name)}</b>'
        f'<table style="width:100%;font-variant-numeric:tabular-nums">{rows}</table>{trouble}'
        f'<div style="font-size:0.75em;{DIM}">{scale}</div></div>'
    )


def row(axis: str, wrench: Wrench) -> str:
    """Force and torque along one axis."""
    number = "xyz".index(axis)
    force, torque = (
        f"{value:+.2f}".replace("-", "\N{MINUS SIGN}")
        for value in (wrench.force_n[number], 1e3 * wrench.torque_nm[number])
    )
    name = f'<td style="color:{COLOURS[axis]};font-weight:600">{{}}<sub>{axis}</sub></td>'
    value = '<td style="text-align:right">{} <span style="' + DIM + '">{}</span></td>'
    return f"<tr>{name.format('F')}{value.format(force, 'N')}<td>&ensp;</td>{name.format('T')}{value.format(torque, 'mN·m')}</tr>"


def curves(server: ViserServer, title: str, letter: str, half: float) -> GuiUplotHandle:
    """Three curves over the last seconds."""
    lines = (uplot.Series(label=f"{letter}_{axis}", stroke=colour, width=1.5) for axis, colour in COLOURS.items())
    return server.gui.add_uplot(
        (np.zeros(2),) * 4,
        (uplot.Series(label="s ago"), *lines),
        scales=scales(half),
        legend=uplot.Legend(show=False),
        title=f"{title}: x red, y green, z blue",
        height=160,
    )


def scales(half: float) -> dict[str, uplot.Scale]:
    """The last seconds, and values about zero."""
    return {"x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)), "y": uplot.Scale(range=(-half, half))}

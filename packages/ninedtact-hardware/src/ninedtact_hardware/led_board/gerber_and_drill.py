"""Fabrication layers of the LED board as Gerber files (RS-274X with X2 attributes) and drill files (Excellon).

A layer consists of flashes, strokes and filled areas. Gerber files are in millimetres with six decimals (Ucamco, Gerber Layer
Format Specification). One drill file has the plated holes, another the unplated ones; slots are milled from end to end.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from shapely import affinity

from ninedtact_hardware.led_board.board_outline_and_holes import OutlineSegment, PointMm, outline_segments
from ninedtact_hardware.led_board.complete_layout import (
    SIDES,
    BoardLayout,
    distinct_ring_vertices,
    merge_polygon_holes,
    pad_polygon,
    split_polygons,
)
from ninedtact_hardware.led_board.components import BoardPad, BoardSide, DrilledHole
from ninedtact_hardware.led_board.silkscreen import PEN_MM, place_designators

THERMAL_PASTE_MM = 0.55
"""Side of the five paste windows on the driver's thermal pad: with paste on the whole pad, the driver floats."""
THERMAL_WINDOWS = (0.0, 0.0), (0.7, 0.0), (0.0, 0.7), (-0.7, 0.0), (0.0, -0.7)
"""Offsets of the windows from the pad's middle: between the vias, which would draw off the solder."""


def thermal_pad_paste_windows(pad: BoardPad) -> list[PointMm]:
    """Return the centres of the stencil's windows on the driver's large thermal pad."""
    return [(pad.at_mm[0] + dx, pad.at_mm[1] + dy) for dx, dy in THERMAL_WINDOWS]


def pad_contour(pad: BoardPad, margin_mm: float = 0.0) -> list[PointMm]:
    """Return the contour of a pad, enlarged by a margin, relative to the pad's centre."""
    shape = pad_polygon(pad)
    (outer,) = split_polygons(shape.buffer(margin_mm) if margin_mm else shape)
    return distinct_ring_vertices(affinity.translate(outer, -pad.at_mm[0], -pad.at_mm[1]).exterior)


FIRST_APERTURE = 10
OUTLINE_PEN_MM = 0.1
"""Pen of the outline; its middle is the edge."""


@dataclass
class _GerberPlot:
    """Plot commands as they are added, and the apertures that they need."""

    commands: list[str] = field(default_factory=list)
    apertures: list[str] = field(default_factory=list)
    macros: list[str] = field(default_factory=list)

    def flash_circle(self, at: PointMm, diameter_mm: float) -> None:
        """Flash a circle."""
        self._flash(f"C,{diameter_mm:.6f}", at)

    def flash_rectangle(self, at: PointMm, width_mm: float, height_mm: float) -> None:
        """Flash a rectangle."""
        self._flash(f"R,{width_mm:.6f}X{height_mm:.6f}", at)

    def flash_pad(self, pad: BoardPad, margin_mm: float = 0.0) -> None:
        """Flash a pad, enlarged by a margin: a rectangle, or a polygon if it has rounded corners or cutouts."""
        if pad.land.corner_mm or pad.cutouts:
            self._flash(self._polygon_aperture(pad_contour(pad, margin_mm)), pad.at_mm)
        else:
            self.flash_rectangle(pad.at_mm, pad.size_mm[0] + 2 * margin_mm, pad.size_mm[1] + 2 * margin_mm)

    def draw_stroke(self, width_mm: float, points: Sequence[PointMm]) -> None:
        """Draw a line with a round pen."""
        self._choose(f"C,{width_mm:.6f}")
        self._draw_path(points)

    def fill_area(self, contour: Sequence[PointMm]) -> None:
        """Fill a contour, whose holes are reached through cuts of no width."""
        self.commands.append("G36*")
        self._draw_path((*contour, contour[0]))
        self.commands.append("G37*")

    def draw_outline_segment(self, edge: OutlineSegment) -> None:
        """Draw a segment of the outline."""
        if edge.centre_mm is None:
            self.draw_stroke(OUTLINE_PEN_MM, (edge.start_mm, edge.end_mm))
            return
        self._choose(f"C,{OUTLINE_PEN_MM:.6f}")
        i, j = (centre - start for centre, start in zip(edge.centre_mm, edge.start_mm, strict=True))
        arc = f"{_gerber_coordinates(edge.end_mm)}I{_nanometres(i)}J{_nanometres(j)}D01*"
        self.commands += [f"{_gerber_coordinates(edge.start_mm)}D02*", "G02*", arc, "G01*"]

    def to_text(self, function: str, polarity: str) -> str:
        """Return the Gerber file of a layer with this function and polarity."""
        shapes = [f"%AMSHAPE{number}*{body}%" for number, body in enumerate(self.macros)]
        apertures = [f"%ADD{FIRST_APERTURE + number}{template}*%" for number, template in enumerate(self.apertures)]
        head = [
            f"%TF.FileFunction,{function}*%",
            f"%TF.FilePolarity,{polarity}*%",
            "%TF.SameCoordinates,ninedtact-led-board*%",
        ]
        setup = ["%FSLAX46Y46*%", "%MOMM*%", "%LPD*%"]
        return "\n".join([*head, *setup, *shapes, *apertures, "G75*", "G01*", *self.commands, "M02*", ""])

    def _flash(self, template: str, at: PointMm) -> None:
        self._choose(template)
        self.commands.append(f"{_gerber_coordinates(at)}D03*")

    def _choose(self, template: str) -> None:
        """Select an aperture, which is defined once."""
        if template not in self.apertures:
            self.apertures.append(template)
        self.commands.append(f"D{FIRST_APERTURE + self.apertures.index(template)}*")

    def _polygon_aperture(self, contour: Sequence[PointMm]) -> str:
        """Return the name of the aperture of a polygon, which is defined once."""
        corners = ",".join(f"{x:.6f},{y:.6f}" for x, y in (*contour, contour[0]))
        body = f"4,1,{len(contour)},{corners},0*"
        if body not in self.macros:
            self.macros.append(body)
        return f"SHAPE{self.macros.index(body)}"

    def _draw_path(self, points: Sequence[PointMm]) -> None:
        """Move to the first point and draw through the others."""
        first, *others = map(_gerber_coordinates, points)
        self.commands += [f"{first}D02*", *(f"{place}D01*" for place in others)]


def _gerber_coordinates(place: PointMm) -> str:
    """Return a point as Gerber coordinates."""
    return f"X{_nanometres(place[0])}Y{_nanometres(place[1])}"


def _nanometres(length_mm: float) -> int:
    """Return a length in millionths of a millimetre."""
    return round(length_mm * 1e6)


def _plot_copper(plot: _GerberPlot, layout: BoardLayout, side: BoardSide) -> None:
    """Plot pour, tracks, pads and vias."""
    for piece in layout.pours[side]:
        plot.fill_area(merge_polygon_holes(piece))
    for track in layout.routes.tracks:
        if track.side == side:
            plot.draw_stroke(track.width_mm, track.points)
    for pad in layout.pads:
        if side in pad.sides:
            plot.flash_pad(pad)
    for via in layout.routes.vias:
        plot.flash_circle(via.at_mm, via.diameter_mm)


def _plot_mask(plot: _GerberPlot, layout: BoardLayout, side: BoardSide) -> None:
    """Plot the openings of the solder mask: all pads, a little larger; vias stay covered."""
    for pad in layout.pads:
        if side in pad.sides:
            plot.flash_pad(pad, layout.board.rules.mask_margin_mm)


def _plot_paste(plot: _GerberPlot, layout: BoardLayout, side: BoardSide) -> None:
    """Plot the openings of the stencil: whole pads, then the windows of the thermal pad."""
    soldered = [pad for pad in layout.pads if pad.sides == (side,)]
    for pad in soldered:
        if pad.land.paste:
            plot.flash_pad(pad)
    for window in (window for pad in soldered if not pad.land.paste for window in thermal_pad_paste_windows(pad)):
        plot.flash_rectangle(window, THERMAL_PASTE_MM, THERMAL_PASTE_MM)


def _plot_silkscreen(plot: _GerberPlot, layout: BoardLayout, side: BoardSide) -> None:
    """Plot a bar at each cathode and at pin 1 of the driver, and the designators for which there is space."""
    for part in layout.parts:
        if part.side == side and part.part.footprint.mark_mm:
            plot.draw_stroke(PEN_MM, [part.to_board_frame(end) for end in part.part.footprint.mark_mm])
    for line in (line for word in place_designators(layout, side) for line in word.lines):
        plot.draw_stroke(PEN_MM, line)


LAYER_PREFIX: dict[BoardSide, str] = {"top": "F", "bottom": "B"}
GERBER_LAYERS: tuple[tuple[str, str, str, Callable[[_GerberPlot, BoardLayout, BoardSide], None]], ...] = (
    ("Cu", "Copper,L{number},{side}", "Positive", _plot_copper),
    ("Mask", "Soldermask,{side}", "Negative", _plot_mask),
    ("Paste", "Paste,{side}", "Positive", _plot_paste),
    ("Silkscreen", "Legend,{side}", "Positive", _plot_silkscreen),
)
"""For each layer: the file's name, the Gerber function, the polarity, and what plots it."""


def format_gerber_and_drill_files(layout: BoardLayout) -> dict[str, str]:
    """Return Gerbers and drill files by the end of their names."""
    files = {}
    for number, side in enumerate(SIDES, start=1):
        for suffix, function, polarity, plot_layer in GERBER_LAYERS:
            plot = _GerberPlot()
            plot_layer(plot, layout, side)
            layer_function = function.format(number=number, side="Top" if side == "top" else "Bot")
            files[f"{LAYER_PREFIX[side]}_{suffix}.gbr"] = plot.to_text(layer_function, polarity)
    files["Edge_Cuts.gbr"] = format_gerber_outline(outline_segments(layout.board.outline))
    files["PTH.drl"] = _format_drill_file(layout.holes, plated=True)
    files["NPTH.drl"] = _format_drill_file(layout.holes, plated=False)
    return files


def format_gerber_outline(edges: Sequence[OutlineSegment]) -> str:
    """Return the milled edge as a Gerber file."""
    plot = _GerberPlot()
    for edge in edges:
        plot.draw_outline_segment(edge)
    return plot.to_text("Profile,NP", "Positive")


def _format_drill_file(holes: tuple[DrilledHole, ...], plated: bool) -> str:
    """Return the drill file of the plated or the unplated holes, tools in order of size."""
    chosen = [hole for hole in holes if hole.plated == plated]
    sizes = sorted({hole.width_mm for hole in chosen})
    kind = "Plated,1,2,PTH" if plated else "NonPlated,1,2,NPTH"
    lines = ["M48", f"; #@! TF.FileFunction,{kind}", "FMAT,2", "METRIC,TZ"]
    lines += [f"T{number}C{size:.3f}" for number, size in enumerate(sizes, start=1)]
    lines += ["%", "G05"]
    for number, size in enumerate(sizes, start=1):
        lines += [f"T{number}", *(line for hole in chosen if hole.width_mm == size for line in _hole_commands(hole))]
    return "\n".join([*lines, "T0", "M30", ""])


def _hole_commands(hole: DrilledHole) -> list[str]:
    """Return the commands of one hole; of a slot: to its start, tool down, along, tool up, and back to drilling."""
    if hole.start_mm == hole.end_mm:
        return [_drill_coordinates(hole.start_mm)]
    return [f"G00{_drill_coordinates(hole.start_mm)}", "M15", f"G01{_drill_coordinates(hole.end_mm)}", "M16", "G05"]


def _drill_coordinates(place: PointMm) -> str:
    """Return a point as drill coordinates with decimal points."""
    return f"X{place[0]:.4f}Y{place[1]:.4f}"

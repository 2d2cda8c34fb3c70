"""Fabrication layers of the LED board as Gerber files (RS-274X with X2 attributes) and drill files (Excellon).

A layer consists of flashes, strokes and filled areas. Gerber files are in millimetres with six decimals (Ucamco, Gerber Layer
Format Specification). One drill file has the plated holes, another the unplated ones; slots are milled from end to end.
"""

from dataclasses import dataclass, field
from typing import Literal

from shapely import affinity
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.board_outline_and_holes import OutlineSegment, PointMm
from ninedtact.hardware.led_board.complete_layout import (
    BoardLayout,
    distinct_ring_vertices,
    merge_polygon_holes,
    pad_polygon,
    split_polygons,
)
from ninedtact.hardware.led_board.components import BoardPad, BoardSide, DrilledHole
from ninedtact.hardware.led_board.silkscreen import PEN_MM, place_designators

BoardLayer = Literal["copper", "mask", "paste", "silk"]
THERMAL_PASTE_MM = 0.55
"""Side of the five paste windows on the driver's thermal pad: with paste on the whole pad, the driver floats."""
THERMAL_WINDOWS = (0.0, 0.0), (0.7, 0.0), (0.0, 0.7), (-0.7, 0.0), (0.0, -0.7)
"""Offsets of the windows from the pad's middle: between the vias, which would draw off the solder."""


@dataclass(frozen=True)
class _FlashedDisc:
    """A flashed circle."""

    at_mm: PointMm
    diameter_mm: float


@dataclass(frozen=True)
class _FlashedRectangle:
    """A flashed rectangle."""

    at_mm: PointMm
    size_mm: PointMm


@dataclass(frozen=True)
class FlashedPolygon:
    """A flashed polygon; its points are relative to where it is flashed."""

    at_mm: PointMm
    points: tuple[PointMm, ...]


@dataclass(frozen=True)
class _DrawnStroke:
    """A line drawn with a round pen."""

    width_mm: float
    points: tuple[PointMm, ...]


@dataclass(frozen=True)
class _FilledArea:
    """A filled contour; holes are reached through cuts of no width."""

    points: tuple[PointMm, ...]


PlottedShape = _FlashedDisc | _FlashedRectangle | FlashedPolygon | _DrawnStroke | _FilledArea


def list_layer_shapes(layout: BoardLayout, layer: BoardLayer, side: BoardSide) -> tuple[PlottedShape, ...]:
    """Return the shapes of one layer of one side."""
    return {"copper": _copper_shapes, "mask": _mask_shapes, "paste": _paste_shapes, "silk": _silkscreen_shapes}[layer](
        layout, side
    )


def _copper_shapes(layout: BoardLayout, side: BoardSide) -> tuple[PlottedShape, ...]:
    """Return the shapes of pour, tracks, pads and vias."""
    areas = [_FilledArea(merge_polygon_holes(piece)) for piece in layout.pours[side]]
    strokes = [_DrawnStroke(track.width_mm, track.points) for track in layout.routes.tracks if track.side == side]
    flashes = [flashed_pad_shape(pad, 0.0) for pad in layout.pads if side in pad.sides]
    return (*areas, *strokes, *flashes, *(_FlashedDisc(via.at_mm, via.diameter_mm) for via in layout.routes.vias))


def _mask_shapes(layout: BoardLayout, side: BoardSide) -> tuple[PlottedShape, ...]:
    """Return the openings of the solder mask: all pads, a little larger; vias stay covered."""
    margin = layout.board.rules.mask_margin_mm
    return tuple(flashed_pad_shape(pad, margin) for pad in layout.pads if side in pad.sides)


def _paste_shapes(layout: BoardLayout, side: BoardSide) -> tuple[PlottedShape, ...]:
    """Return the openings of the stencil."""
    whole = [flashed_pad_shape(pad, 0.0) for pad in layout.pads if pad.sides == (side,) and pad.land.paste]
    split = [pad for pad in layout.pads if pad.sides == (side,) and not pad.land.paste]
    return (*whole, *(window for pad in split for window in thermal_pad_paste_openings(pad)))


def thermal_pad_paste_openings(pad: BoardPad) -> tuple[_FlashedRectangle, ...]:
    """Return the openings of the stencil for the driver's large thermal pad."""
    x, y = pad.at_mm
    return tuple(
        _FlashedRectangle((x + dx, y + dy), (THERMAL_PASTE_MM, THERMAL_PASTE_MM)) for dx, dy in THERMAL_WINDOWS
    )


def _silkscreen_shapes(layout: BoardLayout, side: BoardSide) -> tuple[PlottedShape, ...]:
    """Return a bar at each cathode and at pin 1 of the driver, and the designators for which there is space."""
    marks = [(part, part.part.footprint.mark_mm) for part in layout.parts if part.side == side]
    bars = [_DrawnStroke(PEN_MM, tuple(part.to_board_frame(end) for end in mark)) for part, mark in marks if mark]
    return (*bars, *(_DrawnStroke(PEN_MM, line) for word in place_designators(layout, side) for line in word.lines))


def flashed_pad_shape(pad: BoardPad, margin_mm: float) -> _FlashedRectangle | FlashedPolygon:
    """Return a pad, enlarged by a margin, as a flashed shape."""
    if not pad.land.corner_mm and not pad.cutouts:
        return _FlashedRectangle(pad.at_mm, (pad.size_mm[0] + 2 * margin_mm, pad.size_mm[1] + 2 * margin_mm))
    shape: BaseGeometry = pad_polygon(pad)
    (outer,) = split_polygons(shape.buffer(margin_mm) if margin_mm else shape)
    at_origin = affinity.translate(outer, -pad.at_mm[0], -pad.at_mm[1])
    return FlashedPolygon(pad.at_mm, tuple(distinct_ring_vertices(at_origin.exterior)))


FIRST_APERTURE = 10
OUTLINE_PEN_MM = 0.1
"""Pen of the outline; its middle is the edge."""


@dataclass
class _GerberPlot:
    """Plot commands as they are added, and the apertures that they need."""

    commands: list[str] = field(default_factory=list)
    apertures: list[str] = field(default_factory=list)
    macros: list[str] = field(default_factory=list)

    def choose(self, template: str) -> None:
        """Select an aperture, which is defined once."""
        if template not in self.apertures:
            self.apertures.append(template)
        self.commands.append(f"D{FIRST_APERTURE + self.apertures.index(template)}*")

    def macro(self, points: tuple[PointMm, ...]) -> str:
        """Return the name of the aperture of a shape, which is defined once."""
        corners = ",".join(f"{x:.6f},{y:.6f}" for x, y in (*points, points[0]))
        body = f"4,1,{len(points)},{corners},0*"
        if body not in self.macros:
            self.macros.append(body)
        return f"SHAPE{self.macros.index(body)}"

    def draw(self, shape: PlottedShape) -> None:
        """Add the commands of one shape."""
        match shape:
            case _FlashedDisc(at, diameter):
                self.choose(f"C,{diameter:.6f}")
                self.commands.append(f"{_gerber_coordinates(at)}D03*")
            case _FlashedRectangle(at, (width, height)):
                self.choose(f"R,{width:.6f}X{height:.6f}")
                self.commands.append(f"{_gerber_coordinates(at)}D03*")
            case FlashedPolygon(at, points):
                self.choose(self.macro(points))
                self.commands.append(f"{_gerber_coordinates(at)}D03*")
            case _DrawnStroke(width, points):
                self.choose(f"C,{width:.6f}")
                self.commands += _path_commands(points)
            case _FilledArea(points):
                self.commands += ["G36*", *_path_commands((*points, points[0])), "G37*"]

    def trace(self, edge: OutlineSegment) -> None:
        """Add the commands of a segment of the outline."""
        self.choose(f"C,{OUTLINE_PEN_MM:.6f}")
        self.commands.append(f"{_gerber_coordinates(edge.start_mm)}D02*")
        if edge.centre_mm is None:
            self.commands.append(f"{_gerber_coordinates(edge.end_mm)}D01*")
            return
        i, j = (centre - start for centre, start in zip(edge.centre_mm, edge.start_mm, strict=True))
        self.commands += ["G02*", f"{_gerber_coordinates(edge.end_mm)}I{_nanometres(i)}J{_nanometres(j)}D01*", "G01*"]

    def text(self, function: str, polarity: str = "Positive") -> str:
        """Return the Gerber file."""
        shapes = [f"%AMSHAPE{number}*{body}%" for number, body in enumerate(self.macros)]
        apertures = [f"%ADD{FIRST_APERTURE + number}{template}*%" for number, template in enumerate(self.apertures)]
        head = [
            f"%TF.FileFunction,{function}*%",
            f"%TF.FilePolarity,{polarity}*%",
            "%TF.SameCoordinates,ninedtact-led-board*%",
        ]
        setup = ["%FSLAX46Y46*%", "%MOMM*%", "%LPD*%"]
        return "\n".join([*head, *setup, *shapes, *apertures, "G75*", "G01*", *self.commands, "M02*", ""])


def format_gerber_layer(shapes: tuple[PlottedShape, ...], function: str, polarity: str = "Positive") -> str:
    """Return a layer as a Gerber file."""
    plot = _GerberPlot()
    for shape in shapes:
        plot.draw(shape)
    return plot.text(function, polarity)


def format_gerber_outline(edges: tuple[OutlineSegment, ...]) -> str:
    """Return the milled edge as a Gerber file."""
    plot = _GerberPlot()
    for edge in edges:
        plot.trace(edge)
    return plot.text("Profile,NP")


def _path_commands(points: tuple[PointMm, ...]) -> list[str]:
    """Return the commands that move to the first point and draw through the others."""
    return [f"{_gerber_coordinates(points[0])}D02*", *(f"{_gerber_coordinates(point)}D01*" for point in points[1:])]


def _gerber_coordinates(place: PointMm) -> str:
    """Return a point as Gerber coordinates."""
    return f"X{_nanometres(place[0])}Y{_nanometres(place[1])}"


def _nanometres(length_mm: float) -> int:
    """Return a length in millionths of a millimetre."""
    return round(length_mm * 1e6)


def format_drill_file(holes: tuple[DrilledHole, ...], plated: bool) -> str:
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

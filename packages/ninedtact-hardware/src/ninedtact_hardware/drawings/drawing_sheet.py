"""A dimensioned drawing on an A3 sheet in third-angle projection, as SVG and PDF. One unit of the axes is one mm of paper.

The sheet shows the top view, the front view below it, the right view beside the front view, and the section A–A above the right
view. A column of notes lists material, tolerance, fits, holes, and dimensions by their names in the design file.

matplotlib is slow to import, so it is imported when a sheet is drawn; its global state is never touched.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from build123d import Axis

from ninedtact_hardware.assembly_dimensions import XY
from ninedtact_hardware.clearances import fits_of_part
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.drawings.part_geometry import (
    CornerRadius,
    Polyline,
    ProjectedView,
    RoundFeatures,
    find_corner_radii,
    find_face_positions,
    find_feature_heights,
    find_round_features,
    project_section,
    project_view,
)
from ninedtact_hardware.materials import MATERIAL_OF_PART
from ninedtact_hardware.parts.part_catalogue import BuiltPart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, HIDDEN, NOTE, BARE = "#111111", "#999999", "#1f4e9e", "#e4e4e4"
TEXT_MM = 2.6
"""Least distance between two labels."""
TITLE_MM = 15.0
"""Distance of a view's title above it, clear of its width."""
CUT_MM, BELOW_MM = 4.5, 18.0
"""How far a section line stands out above a view, and below it, where positions are labelled."""
LOOK_MM = 6.0
"""Length of the arrows that show the viewing direction of a section."""


@dataclass(frozen=True)
class _DimensionedView:
    """One view whose box has its lower left corner at `at`, in mm of paper."""

    axes: "Axes"
    view: ProjectedView
    scale: float
    at: tuple[float, float]

    def paper(self, x: float, y: float) -> tuple[float, float]:
        """Return the position on the sheet of a point of the part."""
        low = self.view.box[0]
        return self.at[0] + (x - low[0]) * self.scale, self.at[1] + (y - low[1]) * self.scale

    def draw_edges(self) -> None:
        """Draw cut faces hatched, hidden edges dashed and visible edges above them."""
        from matplotlib.collections import LineCollection

        self._draw_section_faces()
        for lines, colour, width, style in (
            (self.view.hidden, HIDDEN, 0.35, (0, (5, 3))),
            (self.view.visible, INK, 0.8, "-"),
        ):
            on_paper = [np.array(self.at) + (line - self.view.box[0]) * self.scale for line in lines]
            self.axes.add_collection(LineCollection(on_paper, colors=colour, linewidths=width, linestyles=style))

    def _draw_section_faces(self) -> None:
        """Hatch the cut faces, their holes left open."""
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path

        for face in self.view.cut:
            path = Path.make_compound_path(
                *(Path([self.paper(*place) for place in _close_polyline(line)]) for line in face)
            )
            self.axes.add_patch(PathPatch(path, facecolor=BARE, edgecolor=HIDDEN, hatch="////", linewidth=0))
            self.axes.add_patch(PathPatch(path, facecolor="none", edgecolor=INK, linewidth=0.8))

    def draw_title(self, title: str) -> None:
        """Write the title above the view."""
        (left, _), (right, high) = self.view.box
        x, y = self.paper((left + right) / 2, high)
        self.axes.text(x, y + TITLE_MM, title, fontsize=8, color=INK, ha="center", weight="bold")

    def draw_section_line(self, name: str) -> None:
        """Draw the line x = 0 along which another view is cut, with its name and an arrow in viewing direction (−x) at
        both ends."""
        (_, low), (_, high) = self.view.box
        (x, bottom), (_, top) = self.paper(0, low), self.paper(0, high)
        self.axes.plot([x, x], (bottom - 1, top + CUT_MM), color=INK, linewidth=0.5, linestyle=(0, (12, 3, 2, 3)))
        self.axes.plot([x, x], (bottom - BELOW_MM, bottom - BELOW_MM + 2), color=INK, linewidth=0.5)
        style = {"arrowstyle": "-|>", "color": INK, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
        for end in (bottom - BELOW_MM, top + CUT_MM):
            self.axes.annotate("", (x, end), (x + LOOK_MM, end), arrowprops=style)
            self.axes.text(x + LOOK_MM + 1, end, name, fontsize=8, color=INK, ha="left", va="center", weight="bold")

    def draw_overall_dimensions(self) -> None:
        """Draw the overall width above the view and the overall height at its right."""
        (left, low), (right, high) = self.view.box
        (x0, y0), (x1, y1) = self.paper(left, low), self.paper(right, high)
        self._draw_dimension_line((x0, y1 + 8), (x1, y1 + 8), f"{right - left:.2f}", 0)
        self._draw_dimension_line((x1 + 8, y0), (x1 + 8, y1), f"{high - low:.2f}", 90)

    def _draw_dimension_line(
        self, start: tuple[float, float], end: tuple[float, float], text: str, turned: int
    ) -> None:
        """Draw a dimension line with its number."""
        style = {"arrowstyle": "<->", "color": NOTE, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
        self.axes.annotate("", end, start, arrowprops=style)
        middle = (start[0] + end[0]) / 2 - (1.2 if turned else 0), (start[1] + end[1]) / 2 + (0 if turned else 1.2)
        anchor = ("right", "center") if turned else ("center", "bottom")
        self.axes.text(*middle, text, fontsize=7, color=NOTE, rotation=turned, ha=anchor[0], va=anchor[1])

    def draw_round_callouts(self, found: Sequence[RoundFeatures], corners: Sequence[CornerRadius] = ()) -> None:
        """Draw one leader per diameter and radius, in the order of their positions so that they do not cross."""
        (_, low), (right, high) = self.view.box
        x = self.paper(right, low)[0] + 16
        style = {"arrowstyle": "-|>", "color": NOTE, "linewidth": 0.5, "shrinkB": 0}
        callouts = [*((max(each.positions), _round_feature_label(each)) for each in found)]
        callouts += [(each.place, f"R{each.radius_mm:.2f}") for each in corners]
        highest_first = sorted(callouts, key=lambda each: (-each[0][1], -each[0][0]))
        for number, (place, text) in enumerate(highest_first):
            y = self.paper(right, high)[1] - 3 - 6 * number
            self.axes.annotate(text, self.paper(*place), (x, y), fontsize=7, color=NOTE, arrowprops=style, va="center")

    def draw_vertical_positions(self, places: Sequence[float], name: str, zero: float = 0.0) -> None:
        """Label the position of every flat face across the sheet's upward axis, beside the view."""
        x = self.paper(*self.view.box[0])[0]
        for place, text_y in _spread_labels((place, self.paper(0, place)[1]) for place in places):
            y = self.paper(0, place)[1]
            self.axes.plot([x - 1, x - 4, x - 7], [y, y, text_y], color=NOTE, linewidth=0.4)
            text = f"{name} {place - zero:.2f}"
            self.axes.text(x - 7.5, text_y, text, fontsize=6, color=NOTE, ha="right", va="center")

    def draw_horizontal_positions(self, places: Sequence[float], name: str) -> None:
        """Label the position of every flat face across the sheet's horizontal axis, below the view."""
        y = self.paper(*self.view.box[0])[1]
        for place, text_x in _spread_labels((place, self.paper(place, 0)[0]) for place in places):
            x = self.paper(place, 0)[0]
            self.axes.plot([x, x, text_x], [y - 1, y - 3, y - 5], color=NOTE, linewidth=0.4)
            text = f"{name} {place:.2f}"
            self.axes.text(text_x, y - 5.5, text, fontsize=6, color=NOTE, ha="center", va="top", rotation=90)


def _round_feature_label(found: RoundFeatures) -> str:
    """Return number and diameter of round features, and the pitch of a grid."""
    pitch = f", pitch {found.grid[2]:.2f}" if found.grid else ""
    return f"{len(found.positions)} x ⌀{found.diameter_mm:.2f}{pitch}"


def _close_polyline(line: Polyline) -> list[tuple[float, float]]:
    """Return the points of a polyline with the first one repeated at the end."""
    return [(float(x), float(y)) for x, y in (*line, line[0])]


def _spread_labels(wanted: Iterable[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """Yield positions with those of their labels, which are moved on where they would overlap the one before."""
    last = float("-inf")
    for place, text in wanted:
        last = max(text, last + TEXT_MM)
        yield place, last


PLATE = ("moulds.beyond_mm", "moulds.corner_radius_mm", "moulds.hole_mm", "moulds.hole_inset_mm", "moulds.pairs_mm")
PINS = ("pin_board.rows", "pin_board.cols", "pin_board.pitch_mm", "pin_board.pin_diameter_mm")
DIMENSIONS_OF_PART = {
    "sensor_base": ("base",),
    "sensor_shell": ("shell",),
    "isolation_ring": ("ring",),
    "acrylic_window": ("window",),
    "calibration_board": ("pin_frame", *PINS),
    "base_board": (*PLATE, "moulds.base_mm", "moulds.shell_screw_mm"),
    "first_mould": (*PLATE, "gel.thickness_mm", "gels.rim_radius_mm"),
    "second_mould": (*PLATE, "gel.thickness_mm", "gels.rim_radius_mm", "gels.black_top_mm", "gels.black_side_mm"),
}
"""Tables of the design file, or single keys of them, whose dimensions are listed for each part."""
TOLERANCES = {
    "printed": "± 0.15; what has to fit is listed below: try it",
    "cut": "± 0.10; sheets vary: measure the thickness",
}
"""Tolerances by manufacturing method, as such shops usually keep them; no shop was contacted."""


@dataclass(frozen=True)
class NoteLine:
    """One line of the column of notes."""

    text: str
    heading: bool = False


def build_drawing_notes(design: HardwareDesign, part: BuiltPart) -> list[NoteLine]:
    """Return all notes of a part: manufacturing, fits, round features and dimensions."""
    return [
        *_manufacturing_notes(part),
        *_fit_notes(design, part.name),
        *_round_feature_notes(part),
        *_dimension_notes(design, part.name),
    ]


def _manufacturing_notes(part: BuiltPart) -> Iterator[NoteLine]:
    """Yield material, manufacturing method and tolerance."""
    yield NoteLine(f"{MATERIAL_OF_PART[part.name].name}, {part.method}")
    yield NoteLine(f"tolerance {TOLERANCES[part.method]}")


def _fit_notes(design: HardwareDesign, part: str) -> Iterator[NoteLine]:
    """List the faces that must fit other parts, each with its nominal clearance per side."""
    if found := fits_of_part(design, part):
        yield NoteLine("fits: clearance on each side", heading=True)
        yield from (NoteLine(f"{each.clearance_mm:.3f}  {each.faces}") for each in found)


def _round_feature_notes(part: BuiltPart) -> Iterator[NoteLine]:
    """Yield the holes and pins, if there are any."""
    if found := [*find_round_features(part.solid)]:
        yield NoteLine("round, about z (diameter: places x, y)", heading=True)
        yield from (NoteLine(text) for each in found for text in _hole_callout(each))


def _hole_callout(found: RoundFeatures) -> Iterator[str]:
    """Yield the callout of holes or pins of one diameter in lines that fit the column; a grid by columns, rows and
    pitch."""
    head = f"{len(found.positions)} x ⌀{found.diameter_mm:.2f}: "
    if found.grid:
        columns, rows, pitch = found.grid
        (low_x, low_y), (high_x, high_y) = min(found.positions), max(found.positions)
        yield f"{head}{columns} columns x {rows} rows, pitch {pitch:.2f}"
        yield f"      x from {low_x:g} to {high_x:g}, y from {low_y:g} to {high_y:g}"
        return
    places = [f"({x:g}, {y:g})" for x, y in found.positions]
    for start in range(0, len(places), 4):
        yield (head if start == 0 else "      ") + " ".join(places[start : start + 4])


def _dimension_notes(design: HardwareDesign, part: str) -> Iterator[NoteLine]:
    """Yield each dimension as `name value`, named as in the design file without its `hardware.`."""
    yield NoteLine("dimensions of the design", heading=True)
    for name in DIMENSIONS_OF_PART[part]:
        table, _, only = name.partition(".")
        found = getattr(design, table, None) or getattr(design.sensor, table)
        names = [only] if only else [field.name for field in fields(found)]
        yield from (NoteLine(f"{table}.{each}  {_format_value(getattr(found, each))}") for each in names)
    if part == "calibration_board":
        yield NoteLine(
            f"tips of the pins at z  {design.pin_frame.floor_mm + design.pin_frame.pin_tall_mm:.2f}, on one plane"
        )


def _format_value(value: float | tuple[float, ...]) -> str:
    """Return a number or several in parentheses as text."""
    return f"({', '.join(f'{each:g}' for each in value)})" if isinstance(value, tuple) else f"{value:g}"


SHEET_MM = 420.0, 297.0
SCALES = 10.0, 8.0, 6.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.75, 1.5, 1.25, 1.0, 0.75, 0.5
VIEWS_MM = 302.0, 262.0
"""Space for the views; the rest of the sheet is for the notes."""
LEFT_MM, BOTTOM_MM = 28.0, 28.0
GAP_MM = 32.0
"""Distance between views, for dimensions."""
EDGES_MM = 36.0
"""Space beside the outer views, for dimensions."""
WITH_CORNERS = "acrylic_window", "base_board", "first_mould", "second_mould", "calibration_board"
"""Plates and the tray: all radii of their vertical edges are called out beside the top view."""
TABLE_X, TABLE_TOP, TABLE_BOTTOM = 318.0, 276.0, 15.0
ROW_MM = 4.2
"""Distance between lines of notes; less where there are more than fit."""


@dataclass(frozen=True)
class DrawingSheet:
    """The drawing of one part."""

    part: BuiltPart
    notes: Sequence[NoteLine]
    """Notes on manufacturing and dimensions, below name, scale and box."""

    def to_svg_and_pdf(self) -> Iterator[tuple[str, bytes]]:
        """Yield file extension and content of the drawing, as SVG and as PDF."""
        figure = self.draw_figure()
        yield from ((ending, _figure_to_bytes(figure, ending)) for ending in ("svg", "pdf"))

    def draw_figure(self) -> Any:
        """Return the matplotlib figure; one unit of its axes is one mm of paper."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(SHEET_MM[0] / 25.4, SHEET_MM[1] / 25.4))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, SHEET_MM[0]), ylim=(0, SHEET_MM[1]))
        axes.axis("off")
        self._draw_views(axes)
        self._draw_notes(axes)
        return figure

    @property
    def scale(self) -> float:
        """The largest scale at which the views fit the sheet."""
        x, y, z = self.part.size_mm
        for scale in SCALES:
            wide, tall = (x + y) * scale + GAP_MM + EDGES_MM, (max(y, z) + z) * scale + GAP_MM + EDGES_MM
            if wide < VIEWS_MM[0] and tall < VIEWS_MM[1]:
                return scale
        return SCALES[-1]

    def _draw_views(self, axes: "Axes") -> None:
        """Draw top, front, right and section view with their dimensions."""
        solid, (x_mm, _, z_mm) = self.part.solid, self.part.size_mm
        right, above = LEFT_MM + x_mm * self.scale + GAP_MM, BOTTOM_MM + z_mm * self.scale + GAP_MM
        top = self._draw_view(axes, project_view(solid, "top"), (LEFT_MM, above))
        top.draw_section_line("A")
        corners = [*find_corner_radii(solid)] if self.part.name in WITH_CORNERS else []
        top.draw_round_callouts([*find_round_features(solid)], corners)
        top.draw_vertical_positions(find_face_positions(solid, Axis.Y), "y")
        top.draw_horizontal_positions(find_face_positions(solid, Axis.X), "x")
        heights = find_feature_heights(solid)
        front = self._draw_view(axes, project_view(solid, "front"), (LEFT_MM, BOTTOM_MM))
        front.draw_vertical_positions(heights, "z", heights[0])
        self._draw_view(axes, project_view(solid, "right"), (right, BOTTOM_MM))
        self._draw_view(axes, project_section(solid), (right, above)).draw_title("A–A")

    def _draw_view(self, axes: "Axes", view: ProjectedView, at: XY) -> _DimensionedView:
        """Draw the edges and overall dimensions of one view whose box has its lower left corner there."""
        drawn = _DimensionedView(axes, view, self.scale, at)
        drawn.draw_edges()
        drawn.draw_overall_dimensions()
        return drawn

    def _draw_notes(self, axes: "Axes") -> None:
        """Write name, scale and box, then the notes."""
        rows = *self._title_notes(), *self.notes
        apart = min(ROW_MM, (TABLE_TOP - TABLE_BOTTOM) / len(rows))
        for number, row in enumerate(rows):
            size, weight = (8.0, "bold") if row.heading else (6.6, "normal")
            axes.text(TABLE_X, TABLE_TOP - number * apart, row.text, fontsize=size, color=INK, weight=weight)
        axes.plot([TABLE_X - 5] * 2, [TABLE_BOTTOM, SHEET_MM[1] - TABLE_BOTTOM], color=INK, linewidth=0.6)

    def _title_notes(self) -> Iterator[NoteLine]:
        """Yield name, scale, box and volume of the part."""
        x, y, z = self.part.size_mm
        yield NoteLine(self.part.name.replace("_", " "), heading=True)
        yield NoteLine(f"scale {self.scale:g} : 1 on A3, third angle, lengths in mm")
        yield NoteLine(f"box {x:.2f} x {y:.2f} x {z:.2f}, volume {self.part.volume_mm3:.1f} mm³")


def _figure_to_bytes(figure: Any, ending: str) -> bytes:
    """Return a figure as a file without a date: the same design gives the same bytes."""
    from matplotlib import rc_context

    buffer = BytesIO()
    dateless = {"Date": None} if ending == "svg" else {"CreationDate": None}
    with rc_context({"svg.hashsalt": "ninedtact", "svg.fonttype": "none", "hatch.linewidth": 0.3}):
        figure.savefig(buffer, format=ending, metadata=dateless)
    return buffer.getvalue()

"""A dimensioned drawing of one part on an A3 sheet in third-angle projection, as SVG and PDF. One unit of the axes is one mm of
paper.

The sheet shows the top view, the front view below it, the right view beside the front view, and the section A–A above the right
view. A column of notes lists material, tolerance, fits, holes, and dimensions by their names in the design file.

Projection is build123d's; text and lines are matplotlib's, since build123d's drafting draws every letter as faces, in a font that
differs between computers. matplotlib is slow to import, so it is imported when a sheet is drawn; its global state is never touched.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from build123d import Axis

from ninedtact_hardware.clearances import fits_of_part
from ninedtact_hardware.design import XY, HardwareDesign
from ninedtact_hardware.part_geometry import (
    ProjectedView,
    RoundFeatures,
    find_face_positions,
    find_round_features,
    project_section,
    project_view,
)
from ninedtact_hardware.sensor_assembly import BuiltPart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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


def list_drawing_notes(design: HardwareDesign, part: BuiltPart) -> dict[str, list[str]]:
    """Return the lines of notes on a part by their heading: manufacture, fits, holes, and every dimension by its name."""
    x, y, z = part.size_mm
    made = f"{part.material.name}, {part.method}", f"tolerance {TOLERANCES[part.method]}"
    box = f"box {x:.2f} x {y:.2f} x {z:.2f}, volume {part.volume_mm3:.1f} mm³"
    scale = f"scale {_choose_scale(part.size_mm):g} : 1 on A3, third angle, lengths in mm"
    notes = {
        part.name.replace("_", " "): [scale, box, *made],
        "fits: clearance on each side": [
            f"{fit.clearance_mm:.3f}  {fit.faces}" for fit in fits_of_part(design, part.name)
        ],
        "round, about z (diameter: places x, y)": [
            line for found in find_round_features(part.solid) for line in _list_places(found)
        ],
        "dimensions of the design": [*_list_dimensions(design, part.name)],
    }
    return {heading: lines for heading, lines in notes.items() if lines}


def _list_places(found: RoundFeatures) -> Iterator[str]:
    """Yield the positions of holes or pins of one diameter in lines that fit the column; those of a grid by its ends."""
    head = f"{len(found.positions)} x ⌀{2 * found.radius_mm:.2f}: "
    if found.grid:
        columns, rows, pitch = found.grid
        (low_x, low_y), (high_x, high_y) = found.positions[0], found.positions[-1]
        yield f"{head}{columns} columns x {rows} rows, pitch {pitch:.2f}"
        yield f"      x from {low_x:g} to {high_x:g}, y from {low_y:g} to {high_y:g}"
        return
    places = [f"({x:g}, {y:g})" for x, y in found.positions]
    for start in range(0, len(places), 4):
        yield (head if start == 0 else "      ") + " ".join(places[start : start + 4])


def _list_dimensions(design: HardwareDesign, part: str) -> Iterator[str]:
    for name in DIMENSIONS_OF_PART[part]:
        table, _, only = name.partition(".")
        found = getattr(design, table, None) or getattr(design.sensor, table)
        for key in [only] if only else [field.name for field in fields(found)]:
            value = getattr(found, key)
            several = isinstance(value, tuple)
            yield f"{table}.{key}  " + (f"({', '.join(f'{each:g}' for each in value)})" if several else f"{value:g}")
    if part == "calibration_board":
        tips_mm = design.pin_frame.floor_mm + design.pin_frame.pin_tall_mm
        yield f"tips of the pins at z  {tips_mm:.2f}, on one plane"


INK, HIDDEN, NOTE, BARE = "#111111", "#999999", "#1f4e9e", "#e4e4e4"
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
NOTES_X_MM, NOTES_TOP_MM, NOTES_BOTTOM_MM, NOTES_ROW_MM = 318.0, 276.0, 15.0, 4.2
"""Place of the notes, and the distance between their lines; less where there are more than fit."""
LABEL_MM = 2.6
"""Least distance between two labels."""


def draw_part_as_svg_and_pdf(design: HardwareDesign, part: BuiltPart) -> Iterator[tuple[str, bytes]]:
    """Yield file extension and content of the drawing; the same design gives the same bytes."""
    from matplotlib import rc_context

    figure = draw_part(part, list_drawing_notes(design, part))
    for ending, dateless in (("svg", {"Date": None}), ("pdf", {"CreationDate": None})):
        buffer = BytesIO()
        with rc_context({"svg.hashsalt": "ninedtact", "svg.fonttype": "none", "hatch.linewidth": 0.3}):
            figure.savefig(buffer, format=ending, metadata=dateless)
        yield ending, buffer.getvalue()


def draw_part(part: BuiltPart, notes: dict[str, list[str]]) -> Any:
    """Return the sheet as a matplotlib figure; one unit of its axes is one mm of paper."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SHEET_MM[0] / 25.4, SHEET_MM[1] / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, SHEET_MM[0]), ylim=(0, SHEET_MM[1]))
    axes.axis("off")
    solid, (x_mm, _, z_mm), scale = part.solid, part.size_mm, _choose_scale(part.size_mm)
    right, above = LEFT_MM + x_mm * scale + GAP_MM, BOTTOM_MM + z_mm * scale + GAP_MM
    top = _ViewOnPaper(axes, project_view(solid, "top"), scale, (LEFT_MM, above))
    front = _ViewOnPaper(axes, project_view(solid, "front"), scale, (LEFT_MM, BOTTOM_MM))
    side = _ViewOnPaper(axes, project_view(solid, "right"), scale, (right, BOTTOM_MM))
    cut = _ViewOnPaper(axes, project_section(solid), scale, (right, above))
    for view in (top, front, side, cut):
        view.draw_edges()
        view.draw_overall_dimensions()
    top.draw_section_line()
    corners = find_round_features(solid, corners=True) if part.name in WITH_CORNERS else []
    top.draw_round_callouts([*find_round_features(solid), *corners])
    top.label_faces("y", find_face_positions(solid, Axis.Y))
    top.label_faces("x", find_face_positions(solid, Axis.X), is_below=True)
    heights = find_face_positions(solid, Axis.Z)
    front.label_faces("z", heights, zero=heights[0])
    left, _, cut_right, cut_top = cut.box
    axes.text((left + cut_right) / 2, cut_top + 15.0, "A–A", fontsize=8, color=INK, ha="center", weight="bold")
    _draw_notes(axes, notes)
    return figure


def _choose_scale(size_mm: tuple[float, float, float]) -> float:
    """Return the largest scale at which the views of a part of this size fit the sheet."""
    x, y, z = size_mm
    for scale in SCALES:
        wide, tall = (x + y) * scale + GAP_MM + EDGES_MM, (max(y, z) + z) * scale + GAP_MM + EDGES_MM
        if wide < VIEWS_MM[0] and tall < VIEWS_MM[1]:
            return scale
    return SCALES[-1]


def _draw_notes(axes: "Axes", notes: dict[str, list[str]]) -> None:
    rows = [
        row for heading, lines in notes.items() for row in ((heading, 8.0, "bold"), *((x, 6.6, None) for x in lines))
    ]
    apart = min(NOTES_ROW_MM, (NOTES_TOP_MM - NOTES_BOTTOM_MM) / len(rows))
    for number, (text, size, weight) in enumerate(rows):
        axes.text(NOTES_X_MM, NOTES_TOP_MM - number * apart, text, fontsize=size, color=INK, weight=weight)
    axes.plot([NOTES_X_MM - 5] * 2, [NOTES_BOTTOM_MM, SHEET_MM[1] - NOTES_BOTTOM_MM], color=INK, linewidth=0.6)


@dataclass(frozen=True)
class _ViewOnPaper:
    """One view whose box has its lower left corner at `at`, in mm of paper."""

    axes: "Axes"
    view: ProjectedView
    scale: float
    at: XY

    def paper(self, x: float, y: float) -> XY:
        """Return the position on the sheet of a point of the part."""
        low = self.view.box[0]
        return self.at[0] + (x - low[0]) * self.scale, self.at[1] + (y - low[1]) * self.scale

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, bottom, right and top of the view on the sheet."""
        low, high = self.view.box
        return *self.paper(*low), *self.paper(*high)

    def draw_edges(self) -> None:
        """Draw cut faces hatched, their holes left open, hidden edges dashed and visible edges above them."""
        from matplotlib.collections import LineCollection
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path

        for face in self.view.cut:
            outlines = [[self.paper(*place) for place in (*line, line[0])] for line in face]
            path = Path.make_compound_path(*map(Path, outlines))
            self.axes.add_patch(PathPatch(path, facecolor=BARE, edgecolor=HIDDEN, hatch="////", linewidth=0))
            self.axes.add_patch(PathPatch(path, facecolor="none", edgecolor=INK, linewidth=0.8))
        for lines, colour, width, style in (
            (self.view.hidden, HIDDEN, 0.35, (0, (5, 3))),
            (self.view.visible, INK, 0.8, "-"),
        ):
            on_paper = [np.array(self.at) + (line - self.view.box[0]) * self.scale for line in lines]
            self.axes.add_collection(LineCollection(on_paper, colors=colour, linewidths=width, linestyles=style))

    def draw_section_line(self) -> None:
        """Draw the line x = 0 along which the section A–A is cut, with an arrow in viewing direction (−x) at both ends, the lower
        one below the labels."""
        (x, _), (_, bottom, _, top) = self.paper(0, 0), self.box
        self.axes.plot([x, x], (bottom - 1, top + 4.5), color=INK, linewidth=0.5, linestyle=(0, (12, 3, 2, 3)))
        self.axes.plot([x, x], (bottom - 18, bottom - 16), color=INK, linewidth=0.5)
        for end in (bottom - 18, top + 4.5):
            self._draw_arrow((x + 6, end), (x, end), "-|>", INK)
            self.axes.text(x + 7, end, "A", fontsize=8, color=INK, ha="left", va="center", weight="bold")

    def _draw_arrow(self, start: XY, end: XY, style: str, colour: str) -> None:
        """Draw an arrow or, with heads at both ends, a dimension line."""
        shape = {"arrowstyle": style, "color": colour, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
        self.axes.annotate("", end, start, arrowprops=shape)

    def draw_overall_dimensions(self) -> None:
        """Draw the overall width above the view and the overall height at its right."""
        (low_x, low_y), (high_x, high_y) = self.view.box
        left, bottom, right, top = self.box
        self._draw_arrow((left, top + 8), (right, top + 8), "<->", NOTE)
        self._draw_arrow((right + 8, bottom), (right + 8, top), "<->", NOTE)
        style: dict[str, Any] = {"fontsize": 7, "color": NOTE}
        self.axes.text((left + right) / 2, top + 9.2, f"{high_x - low_x:.2f}", ha="center", va="bottom", **style)
        middle = (bottom + top) / 2
        self.axes.text(right + 6.8, middle, f"{high_y - low_y:.2f}", ha="right", va="center", rotation=90, **style)

    def draw_round_callouts(self, found: Sequence[RoundFeatures]) -> None:
        """Draw one leader per diameter and radius, in the order of their positions so that they do not cross."""
        _, _, right, top = self.box
        style = {"arrowstyle": "-|>", "color": NOTE, "linewidth": 0.5, "shrinkB": 0}
        callouts = [
            (max(each.positions, key=lambda place: (round(sum(place), 2), place)), each.label) for each in found
        ]
        for number, (place, text) in enumerate(sorted(callouts, key=lambda each: (-each[0][1], -each[0][0]))):
            label = right + 16, top - 3 - 6 * number
            self.axes.annotate(text, self.paper(*place), label, fontsize=7, color=NOTE, arrowprops=style, va="center")

    def label_faces(self, name: str, places: Sequence[float], is_below: bool = False, zero: float = 0.0) -> None:
        """Label the position of every flat face across one axis of the sheet: beside the view, or below it."""
        left, bottom, _, _ = self.box
        style: dict[str, Any] = {"fontsize": 6, "color": NOTE}
        wanted = ((place, self.paper(place, place)[0 if is_below else 1]) for place in places)
        for place, at, label_at in _spread_labels(wanted):
            text = f"{name} {place - zero:.2f}"
            if is_below:
                self.axes.plot([at, at, label_at], [bottom - 1, bottom - 3, bottom - 5], color=NOTE, linewidth=0.4)
                self.axes.text(label_at, bottom - 5.5, text, ha="center", va="top", rotation=90, **style)
            else:
                self.axes.plot([left - 1, left - 4, left - 7], [at, at, label_at], color=NOTE, linewidth=0.4)
                self.axes.text(left - 7.5, label_at, text, ha="right", va="center", **style)


def _spread_labels(wanted: Iterable[tuple[float, float]]) -> Iterator[tuple[float, float, float]]:
    """Yield places, their positions on paper and those of their labels, moved on where they would overlap the one before."""
    last = float("-inf")
    for place, on_paper in wanted:
        last = max(on_paper, last + LABEL_MM)
        yield place, on_paper, last

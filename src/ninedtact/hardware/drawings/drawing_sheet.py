"""A dimensioned drawing on an A3 sheet in third-angle projection, as SVG and PDF.

The sheet shows the top view, the front view below it, the right view beside the front view, and the section A–A above the right
view. A column of notes lists material, tolerance, fits, holes, and dimensions by their names in the design file.

matplotlib is slow to import, so it is imported when a sheet is drawn; its global state is never touched.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from io import BytesIO
from typing import TYPE_CHECKING, Any

from build123d import Axis

from ninedtact.hardware.assembly_dimensions import XY
from ninedtact.hardware.clearances import fits_of_part
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.drawings.dimensioned_view import INK, DimensionedView
from ninedtact.hardware.drawings.part_geometry import (
    ProjectedView,
    RoundFeatures,
    find_corner_radii,
    find_face_positions,
    find_feature_heights,
    find_round_features,
    project_section,
    project_view,
)
from ninedtact.hardware.materials import MATERIAL_OF_PART
from ninedtact.hardware.parts.part_catalogue import BuiltPart

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


@dataclass(frozen=True)
class DrawingNote:
    """One line of the column of notes."""

    text: str
    heading: bool = False


def build_drawing_notes(design: HardwareDesign, part: BuiltPart) -> list[DrawingNote]:
    """Return all notes of a part: manufacturing, fits, round features and dimensions."""
    return [
        *_manufacturing_notes(part),
        *_fit_notes(design, part.name),
        *_round_feature_notes(part),
        *_dimension_notes(design, part.name),
    ]


def _manufacturing_notes(part: BuiltPart) -> Iterator[DrawingNote]:
    """Yield material, manufacturing method and tolerance."""
    yield DrawingNote(f"{MATERIAL_OF_PART[part.name].name}, {part.method}")
    yield DrawingNote(f"tolerance {TOLERANCES[part.method]}")


def _fit_notes(design: HardwareDesign, part: str) -> Iterator[DrawingNote]:
    """List the faces that must fit other parts, each with its nominal clearance per side."""
    if found := fits_of_part(design, part):
        yield DrawingNote("fits: clearance on each side", heading=True)
        yield from (DrawingNote(f"{each.clearance_mm:.3f}  {each.faces}") for each in found)


def _round_feature_notes(part: BuiltPart) -> Iterator[DrawingNote]:
    """Yield the holes and pins, if there are any."""
    if found := [*find_round_features(part.solid)]:
        yield DrawingNote("round, about z (diameter: places x, y)", heading=True)
        yield from (DrawingNote(text) for each in found for text in _hole_callout(each))


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


def _dimension_notes(design: HardwareDesign, part: str) -> Iterator[DrawingNote]:
    """Yield each dimension as `name value`, named as in the design file without its `hardware.`."""
    yield DrawingNote("dimensions of the design", heading=True)
    for name in DIMENSIONS_OF_PART[part]:
        table, _, only = name.partition(".")
        found = getattr(design, table, None) or getattr(design.sensor, table)
        names = [only] if only else [field.name for field in fields(found)]
        yield from (DrawingNote(f"{table}.{each}  {_format_value(getattr(found, each))}") for each in names)
    if part == "calibration_board":
        yield DrawingNote(
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
    notes: Sequence[DrawingNote]
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

    def _draw_view(self, axes: "Axes", view: ProjectedView, at: XY) -> DimensionedView:
        """Draw the edges and overall dimensions of one view whose box has its lower left corner there."""
        drawn = DimensionedView(axes, view, self.scale, at)
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

    def _title_notes(self) -> Iterator[DrawingNote]:
        """Yield name, scale, box and volume of the part."""
        x, y, z = self.part.size_mm
        yield DrawingNote(self.part.name.replace("_", " "), heading=True)
        yield DrawingNote(f"scale {self.scale:g} : 1 on A3, third angle, lengths in mm")
        yield DrawingNote(f"box {x:.2f} x {y:.2f} x {z:.2f}, volume {self.part.volume_mm3:.1f} mm³")


def _figure_to_bytes(figure: Any, ending: str) -> bytes:
    """Return a figure as a file without a date: the same design gives the same bytes."""
    from matplotlib import rc_context

    buffer = BytesIO()
    dateless = {"Date": None} if ending == "svg" else {"CreationDate": None}
    with rc_context({"svg.hashsalt": "ninedtact", "svg.fonttype": "none", "hatch.linewidth": 0.3}):
        figure.savefig(buffer, format=ending, metadata=dateless)
    return buffer.getvalue()

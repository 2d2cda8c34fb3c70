"""A dimensioned drawing on A3, third angle: top view, front view below it, right view beside that, and above the right view
the part cut open along A–A. As SVG and PDF.

matplotlib is slow to import, so it is imported when a sheet is drawn; its global state is never touched.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

from build123d import Axis

from ninedtact.hardware.drawings.features import heights, levels, roundings, rounds
from ninedtact.hardware.drawings.table import Row
from ninedtact.hardware.drawings.view_on_sheet import INK, ViewOnSheet
from ninedtact.hardware.drawings.views import cut_open, view
from ninedtact.hardware.parts.catalogue import BuiltPart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHEET_MM = 420.0, 297.0
SCALES = 10.0, 8.0, 6.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.75, 1.5, 1.25, 1.0, 0.75, 0.5
VIEWS_MM = 302.0, 262.0
"""Room for the views; the rest is for the table."""
LEFT_MM, BOTTOM_MM = 28.0, 28.0
GAP_MM = 32.0
"""Between views, for dimensions."""
EDGES_MM = 36.0
"""Beside the outer views, for the same."""
WITH_CORNERS = "acrylic_window", "base_board", "first_mould", "second_mould", "calibration_board"
"""Plates and the tray: all that their vertical edges are rounded by is told beside the top view."""
TABLE_X, TABLE_TOP, TABLE_BOTTOM = 318.0, 276.0, 15.0
ROW_MM = 4.2
"""From one row of the table to the next, or less where there are more than fit."""


@dataclass(frozen=True)
class Sheet:
    """One part's drawing."""

    part: BuiltPart
    notes: Sequence[Row]
    """What the table says of its making, below name, scale and box."""

    def files(self) -> Iterator[tuple[str, bytes]]:
        """Ending and content."""
        figure = self.drawn()
        yield from ((ending, saved(figure, ending)) for ending in ("svg", "pdf"))

    def drawn(self) -> Any:
        """The figure; one unit of its axes is one mm of paper."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(SHEET_MM[0] / 25.4, SHEET_MM[1] / 25.4))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, SHEET_MM[0]), ylim=(0, SHEET_MM[1]))
        axes.axis("off")
        self.draw_views(axes)
        self.draw_table(axes)
        return figure

    @property
    def scale(self) -> float:
        """The largest that fits."""
        x, y, z = self.part.size_mm
        for scale in SCALES:
            wide, tall = (x + y) * scale + GAP_MM + EDGES_MM, (max(y, z) + z) * scale + GAP_MM + EDGES_MM
            if wide < VIEWS_MM[0] and tall < VIEWS_MM[1]:
                return scale
        return SCALES[-1]

    def draw_views(self, axes: "Axes") -> None:
        """Each with the dimensions of its box."""
        solid, scale, (x_mm, _, z_mm) = self.part.solid, self.scale, self.part.size_mm
        right, above = LEFT_MM + x_mm * scale + GAP_MM, BOTTOM_MM + z_mm * scale + GAP_MM
        xs, ys, zs = levels(solid, Axis.X), levels(solid, Axis.Y), heights(solid)
        top = ViewOnSheet(axes, view(solid, "top"), scale, (LEFT_MM, above)).lines().box().cut_at_zero("A")
        corners = [*roundings(solid)] if self.part.name in WITH_CORNERS else []
        top.rounds([*rounds(solid)], corners).upwards(ys, "y").across(xs, "x")
        front = ViewOnSheet(axes, view(solid, "front"), scale, (LEFT_MM, BOTTOM_MM)).lines().box()
        front.upwards(zs, "z", zs[0])
        ViewOnSheet(axes, view(solid, "right"), scale, (right, BOTTOM_MM)).lines().box()
        ViewOnSheet(axes, cut_open(solid), scale, (right, above)).lines().box().titled("A–A")

    def draw_table(self, axes: "Axes") -> None:
        """Name, scale and box, then how it is made."""
        rows = *self.head(), *self.notes
        apart = min(ROW_MM, (TABLE_TOP - TABLE_BOTTOM) / len(rows))
        for number, row in enumerate(rows):
            size, weight = (8.0, "bold") if row.heading else (6.6, "normal")
            axes.text(TABLE_X, TABLE_TOP - number * apart, row.text, fontsize=size, color=INK, weight=weight)
        axes.plot([TABLE_X - 5] * 2, [TABLE_BOTTOM, SHEET_MM[1] - TABLE_BOTTOM], color=INK, linewidth=0.6)

    def head(self) -> Iterator[Row]:
        """Of the table."""
        x, y, z = self.part.size_mm
        yield Row(self.part.name.replace("_", " "), heading=True)
        yield Row(f"scale {self.scale:g} : 1 on A3, third angle, lengths in mm")
        yield Row(f"box {x:.2f} x {y:.2f} x {z:.2f}, volume {self.part.volume_mm3:.1f} mm³")


def saved(figure: Any, ending: str) -> bytes:
    """Without the date: the same design gives the same file."""
    from matplotlib import rc_context

    buffer = BytesIO()
    dateless = {"Date": None} if ending == "svg" else {"CreationDate": None}
    with rc_context({"svg.hashsalt": "ninedtact", "svg.fonttype": "none", "hatch.linewidth": 0.3}):
        figure.savefig(buffer, format=ending, metadata=dateless)
    return buffer.getvalue()

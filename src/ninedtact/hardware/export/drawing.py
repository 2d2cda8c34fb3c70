"""A dimensioned drawing on A3: top view, front view below it, right view beside that (third angle), as SVG and PDF.

matplotlib is slow to import, so it is imported when a sheet is drawn; its global state is never touched.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

from build123d import Axis

from ninedtact.hardware.export.views import Rounds, View, levels, rounds, view
from ninedtact.hardware.parts.catalogue import BuiltPart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHEET_MM = 420.0, 297.0
SCALES = 10.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.5
VIEWS_MM = 302.0, 262.0
"""Room for the views; the rest is for the table."""
GAP_MM = 32.0
"""Between views, for dimensions."""
EDGES_MM = 36.0
"""Beside the outer views, for the same."""
INK, HIDDEN, NOTE = "#111111", "#999999", "#1f4e9e"
TABLE_X, TABLE_TOP, ROW_MM = 318.0, 272.0, 4.4
ROWS = 56
TEXT_MM = 2.6
"""From one number to the next."""


@dataclass(frozen=True)
class Sheet:
    """One part's drawing."""

    part: BuiltPart
    material: str
    notes: Sequence[str]
    """Further lines of the table."""

    def files(self) -> dict[str, bytes]:
        """By ending."""
        figure = self.drawn()
        return {ending: saved(figure, ending) for ending in ("svg", "pdf")}

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
            wide, tall = (x + y) * scale + GAP_MM + EDGES_MM, (y + z) * scale + GAP_MM + EDGES_MM
            if wide < VIEWS_MM[0] and tall < VIEWS_MM[1]:
                return scale
        return SCALES[-1]

    def draw_views(self, axes: "Axes") -> None:
        """Each with the dimensions of its box."""
        solid, scale = self.part.solid, self.scale
        top, front, right = (view(solid, side) for side in ("top", "front", "right"))
        left, bottom = 28.0, 28.0
        z_mm, x_mm = front.box[1][1] - front.box[0][1], front.box[1][0] - front.box[0][0]
        above = Drawn(axes, top, scale, (left, bottom + z_mm * scale + GAP_MM))
        above.with_rounds([*rounds(solid)]).upwards(levels(solid, Axis.Y), "y").across(levels(solid, Axis.X), "x")
        zs = levels(solid, Axis.Z)
        Drawn(axes, front, scale, (left, bottom)).lines().box().upwards(zs, "z", zs[0])
        Drawn(axes, right, scale, (left + x_mm * scale + GAP_MM, bottom)).lines().box()

    def draw_table(self, axes: "Axes") -> None:
        """Name, material, scale, then every hole and dimension."""
        for number, (text, bold) in enumerate(self.rows()):
            place = TABLE_X, TABLE_TOP - number * ROW_MM
            axes.text(*place, text, fontsize=6.6 if not bold else 8, color=INK, weight="bold" if bold else "normal")
        axes.plot([TABLE_X - 5] * 2, [15, SHEET_MM[1] - 15], color=INK, linewidth=0.6)

    def rows(self) -> Iterator[tuple[str, bool]]:
        """Text, and whether it is a heading."""
        x, y, z = self.part.size_mm
        yield self.part.name.replace("_", " "), True
        yield f"{self.material}, {self.part.way}", False
        yield f"scale {self.scale:g} : 1 on A3, third angle, lengths in mm", False
        yield f"box {x:.2f} x {y:.2f} x {z:.2f}, volume {self.part.volume_mm3:.1f} mm³", False
        yield "round, about z (diameter: places x, y)", True
        yield from ((text, False) for each in rounds(self.part.solid) for text in told(each))
        yield "dimensions of the design", True
        yield from ((note, False) for note in self.notes[:ROWS])


def told(found: Rounds) -> Iterator[str]:
    """A group of holes in lines that fit; those of a lattice as their number."""
    head = f"{len(found.places)} x ⌀{found.diameter_mm:.2f}: "
    if len(found.places) > 8:
        yield head + "on the lattice of the pin board"
        return
    places = [f"({x:g}, {y:g})" for x, y in found.places]
    for start in range(0, len(places), 4):
        yield (head if start == 0 else "      ") + " ".join(places[start : start + 4])


@dataclass(frozen=True)
class Drawn:
    """One view on the sheet: the corner of its box is put at `at`, paper mm."""

    axes: "Axes"
    view: View
    scale: float
    at: tuple[float, float]

    def paper(self, x: float, y: float) -> tuple[float, float]:
        """Where a point of the part lies on the sheet."""
        low = self.view.box[0]
        return self.at[0] + (x - low[0]) * self.scale, self.at[1] + (y - low[1]) * self.scale

    def lines(self) -> "Drawn":
        """Hidden edges dashed, visible ones above them."""
        from matplotlib.collections import LineCollection

        for lines, colour, width, style in (
            (self.view.hidden, HIDDEN, 0.35, (0, (5, 3))),
            (self.view.visible, INK, 0.8, "-"),
        ):
            places = [[self.paper(x, y) for x, y in line.tolist()] for line in lines]
            self.axes.add_collection(LineCollection(places, colors=colour, linewidths=width, linestyles=style))
        return self

    def box(self) -> "Drawn":
        """Width above, height at the right."""
        (left, low), (right, high) = self.view.box
        (x0, y0), (x1, y1) = self.paper(left, low), self.paper(right, high)
        self.arrow((x0, y1 + 8), (x1, y1 + 8), f"{right - left:.2f}", 0)
        self.arrow((x1 + 8, y0), (x1 + 8, y1), f"{high - low:.2f}", 90)
        return self

    def arrow(self, start: tuple[float, float], end: tuple[float, float], text: str, turned: int) -> None:
        """A dimension line with its number."""
        style = {"arrowstyle": "<->", "color": NOTE, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
        self.axes.annotate("", end, start, arrowprops=style)
        middle = (start[0] + end[0]) / 2 - (1.2 if turned else 0), (start[1] + end[1]) / 2 + (0 if turned else 1.2)
        anchor = ("right", "center") if turned else ("center", "bottom")
        self.axes.text(*middle, text, fontsize=7, color=NOTE, rotation=turned, ha=anchor[0], va=anchor[1])

    def with_rounds(self, found: Sequence[Rounds]) -> "Drawn":
        """Lines, box, and one leader per diameter, in the order of their places so that they do not cross."""
        self.lines().box()
        (_, low), (right, high) = self.view.box
        x = self.paper(right, low)[0] + 16
        style = {"arrowstyle": "-|>", "color": NOTE, "linewidth": 0.5, "shrinkB": 0}
        highest_first = sorted(found, key=lambda each: (-max(each.places)[1], -max(each.places)[0]))
        for number, each in enumerate(highest_first):
            y = self.paper(right, high)[1] - 3 - 6 * number
            text, place = f"{len(each.places)} x ⌀{each.diameter_mm:.2f}", self.paper(*max(each.places))
            self.axes.annotate(text, place, (x, y), fontsize=7, color=NOTE, arrowprops=style, va="center")
        return self

    def upwards(self, places: Sequence[float], name: str, zero: float = 0.0) -> "Drawn":
        """Beside the view, the place of every flat face across the sheet's upward axis."""
        x = self.paper(*self.view.box[0])[0]
        for place, text_y in spread((place, self.paper(0, place)[1]) for place in places):
            y = self.paper(0, place)[1]
            self.axes.plot([x - 1, x - 4, x - 7], [y, y, text_y], color=NOTE, linewidth=0.4)
            text = f"{name} {place - zero:.2f}"
            self.axes.text(x - 7.5, text_y, text, fontsize=6, color=NOTE, ha="right", va="center")
        return self

    def across(self, places: Sequence[float], name: str) -> "Drawn":
        """Below the view, the same of its other axis."""
        y = self.paper(*self.view.box[0])[1]
        for place, text_x in spread((place, self.paper(place, 0)[0]) for place in places):
            x = self.paper(place, 0)[0]
            self.axes.plot([x, x, text_x], [y - 1, y - 3, y - 5], color=NOTE, linewidth=0.4)
            text = f"{name} {place:.2f}"
            self.axes.text(text_x, y - 5.5, text, fontsize=6, color=NOTE, ha="center", va="top", rotation=90)
        return self


def spread(wanted: Iterable[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """Places with where their text goes: where it is wanted, or beside its neighbour."""
    last = float("-inf")
    for place, text in wanted:
        last = max(text, last + TEXT_MM)
        yield place, last


def saved(figure: Any, ending: str) -> bytes:
    """Without the date: the same design gives the same file."""
    from matplotlib import rc_context

    buffer = BytesIO()
    dateless = {"Date": None} if ending == "svg" else {"CreationDate": None}
    with rc_context({"svg.hashsalt": "ninedtact", "svg.fonttype": "none"}):
        figure.savefig(buffer, format=ending, metadata=dateless)
    return buffer.getvalue()

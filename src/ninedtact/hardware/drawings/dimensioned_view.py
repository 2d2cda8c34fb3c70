"""One view of a drawing with its dimensions. One unit of the axes is one mm of paper."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ninedtact.hardware.drawings.part_geometry import CornerRadius, Polyline, ProjectedView, RoundFeatures

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
class DimensionedView:
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

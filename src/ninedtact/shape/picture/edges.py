"""Numbers in millimetres along the edges of the block in a perspective picture."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ninedtact.shape.picture.page import INK, PALE_INK, round_number, signed
from ninedtact.shape.picture.sight import Block
from ninedtact.shape.picture.viewpoint import Viewpoint

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Point = tuple[float, float, float]

TICK, NUMBER, NAME = 0.012, 0.036, 0.085
"""How far tick marks, numbers and names stand out from the block, in lengths of it."""
CLOSEST, CLOSEST_HEIGHTS = 1 / 8, 0.025
"""Distance below which numbers would be crowded, along the skin and upwards, in lengths of the block."""


@dataclass(frozen=True)
class Edge:
    """One coordinate along one edge of the block."""

    name: str
    at: Callable[[float], Point]
    """The point of the edge at a value of the coordinate."""
    outwards: Point
    low: float
    high: float
    step: float

    @property
    def values(self) -> list[float]:
        """The round numbers on it."""
        return [
            self.step * count for count in range(int(np.ceil(self.low / self.step)), int(self.high / self.step) + 1)
        ]


def number_edges(axes: "Axes", block: Block, view: Viewpoint, times: int) -> None:
    """Number x along the front, y along the right, and the heights, drawn `times` larger, up the left corner."""
    (left, front, base), (right, back, top) = block.low.tolist(), block.high.tolist()
    length = 2 * max(right, back)
    step, step_up = round_number(CLOSEST * length), round_number(CLOSEST_HEIGHTS * length / times)
    for edge in (
        Edge("x (mm)", lambda x: (x, front, base), (0, -1, 0), left, right, step),
        Edge("y (mm)", lambda y: (right, y, base), (1, 0, 0), front, back, step),
        Edge("z (mm)", lambda z: (left, front, z * times), (-1, 0, 0), base / times, top / times, step_up),
    ):
        number_edge(axes, edge, view, length)


def number_edge(axes: "Axes", edge: Edge, view: Viewpoint, length: float) -> None:
    """Tick marks, numbers and the name of one edge."""
    points, out = np.array([edge.at(value) for value in edge.values]), length * np.array(edge.outwards)
    ends, places = view.project(points + TICK * out), view.project(points + NUMBER * out)
    for value, start, end, place in zip(edge.values, view.project(points), ends, places, strict=True):
        axes.plot(*zip(start, end, strict=True), color=PALE_INK, linewidth=0.8)
        axes.text(*place, signed(round(value, 6)), color=INK, size=9, ha="center", va="center")
    middle = np.array([edge.at((edge.low + edge.high) / 2)])
    axes.text(*view.project(middle + NAME * out)[0], edge.name, color=INK, size=10, ha="center", va="center")

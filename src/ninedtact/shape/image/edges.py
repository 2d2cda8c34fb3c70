"""Numbers in millimetres along the edges of the block in a perspective image."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ninedtact.shape.image.page import INK, PALE_INK, round_number, signed
from ninedtact.shape.image.sight import Block
from ninedtact.shape.image.viewpoint import Viewpoint

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Point = tuple[float, float, float]

TICK, NUMBER = 0.010, {"left": 0.018, "center": 0.034, "right": 0.018}
"""How far tick marks and numbers stand out from the block, in lengths of it."""
CLOSEST, CLOSEST_HEIGHTS = 1 / 8, 0.025
"""Distance below which numbers would be crowded, along the skin and upwards, in lengths of the block."""


@dataclass(frozen=True)
class Edge:
    """One coordinate along one edge of the block."""

    name: str
    at: Callable[[float], Point]
    """The point of the edge at a value of the coordinate."""
    outwards: Point
    align: Literal["left", "center", "right"]
    """Which side of its words faces the block, or neither."""
    name_at: float
    """Value beside which the name is written."""
    low: float
    high: float
    step: float

    @property
    def values(self) -> list[float]:
        """The round numbers on it."""
        first, last = int(np.ceil(self.low / self.step)), int(np.floor(self.high / self.step))
        return [self.step * count for count in range(first, last + 1)]


def number_edges(axes: "Axes", block: Block, view: Viewpoint, times: int) -> None:
    """Number x along the front, y along the right, and the heights, drawn `times` larger, up the left corner."""
    (left, front, base), (right, back, top) = block.low.tolist(), block.high.tolist()
    length, lowest, highest = 2 * max(right, back), base / times, top / times
    step, step_up = round_number(CLOSEST * length), round_number(CLOSEST_HEIGHTS * length / times)
    for edge in (
        Edge("x (mm)", lambda x: (x, front, base), (0.0, -1.0, 0.0), "center", step / 2, left, right, step),
        Edge("y (mm)", lambda y: (right, y, base), (1.0, 0.0, 0.0), "left", step / 2, front, back, step),
        Edge(
            "z (mm)", lambda z: (left, front, z * times), (-1.0, 0.0, 0.0), "right", step_up, lowest, highest, step_up
        ),
    ):
        number_edge(axes, edge, view, length)


def number_edge(axes: "Axes", edge: Edge, view: Viewpoint, length: float) -> None:
    """Tick marks, numbers and the name of one edge."""
    out = length * np.array(edge.outwards)
    for value in edge.values:
        tick = np.array(edge.at(value)) + np.outer([0, TICK], out)
        axes.plot(*view.project(tick).T, color=PALE_INK, linewidth=0.8)
    words = {value: signed(round(value, 6)) for value in edge.values} | {edge.name_at: edge.name}
    for value, word in words.items():
        x, y = view.project(np.array([edge.at(value)]) + NUMBER[edge.align] * out)[0]
        axes.text(x, y, word, color=INK, size=9, ha=edge.align, va="center")

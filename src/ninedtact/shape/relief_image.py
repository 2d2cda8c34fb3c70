"""Numbers in millimetres along the edges of the block in a perspective image.

The skin in perspective, lit from a side: the top of a block of gel with millimetres along its edges.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from ninedtact.quantities import HeightMap, HeightSource
from ninedtact.shape.height_map_image import (
    INK,
    LEFT_PX,
    PALE_INK,
    TOP_PX,
    add_axes_at,
    add_colour_bar,
    add_text_at,
    figure_to_png,
    fit_colour_scale,
    format_signed_number,
    new_figure_page,
    round_up_to_1_2_5,
    summary_sentence,
)
from ninedtact.shape.measures import max_bulge_mm, max_indentation_mm, summarise_shape
from ninedtact.shape.orthorectification import orthorectify
from ninedtact.shape.relief_renderer import Block, Viewpoint, paint_skin, render_block, trace_sightlines, viewpoint_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


EdgePoint = tuple[float, float, float]

TICK_LENGTH, NUMBER = 0.010, {"left": 0.018, "center": 0.034, "right": 0.018}
"""How far tick marks and numbers stand out from the block, in lengths of it."""
CLOSEST, CLOSEST_HEIGHTS = 1 / 8, 0.025
"""Distance below which numbers would be crowded, along the skin and upwards, in lengths of the block."""


@dataclass(frozen=True)
class Edge:
    """One coordinate along one edge of the block."""

    name: str
    at: Callable[[float], EdgePoint]
    """The point of the edge at a value of the coordinate."""
    outwards: EdgePoint
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
    step, step_up = round_up_to_1_2_5(CLOSEST * length), round_up_to_1_2_5(CLOSEST_HEIGHTS * length / times)
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
        tick = np.array(edge.at(value)) + np.outer([0, TICK_LENGTH], out)
        axes.plot(*view.project(tick).T, color=PALE_INK, linewidth=0.8)
    words = {value: format_signed_number(round(value, 6)) for value in edge.values} | {edge.name_at: edge.name}
    for value, word in words.items():
        x, y = view.project(np.array([edge.at(value)]) + NUMBER[edge.align] * out)[0]
        axes.text(x, y, word, color=INK, size=9, ha=edge.align, va="center")


WIDTH_PX, HEIGHT_PX = 860, 570
NUMBERS_PX = 50
"""Room around the block for the numbers along its edges."""
FINER = 1.5
"""The block is computed this much finer than it is shown, against jagged edges."""
SMOOTHING_PX = 2.0
"""Standard deviation of the Gaussian on the heights drawn: light that grazes the skin would show noise above all."""
EXAGGERATIONS = (1, 2, 5, 10, 20)
FLATTEST = 1 / 8
"""Heights are exaggerated as long as the relief stays below this part of the skin's longer side."""
CALM = 60
"""A relief below this many standard deviations of its noise does not fill that room."""
UNDER_DEEPEST = 1 / 30
"""Gel drawn under the deepest point, in the same measure."""


def render_relief(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """A PNG with the skin in perspective, seen from outside; axes and heights in mm, any exaggeration stated."""
    figure = new_figure_page(title, summary_sentence(summarise_shape(height)), WIDTH_PX, HEIGHT_PX)
    axes = add_axes_at(figure, LEFT_PX, TOP_PX, WIDTH_PX, HEIGHT_PX)
    straight, times = orthorectify(height), exaggeration(height)
    draw_block(axes, straight, times)
    add_colour_bar(figure, fit_colour_scale(height), LEFT_PX + WIDTH_PX + 36, HEIGHT_PX)
    add_text_at(figure, LEFT_PX, TOP_PX + HEIGHT_PX + 60, relief_caption(straight, times))
    return figure_to_png(figure)


def relief_caption(height: HeightMap, times: int) -> str:
    """What the image shows, in one line."""
    words = ["seen from outside", "heights true to scale" if times == 1 else f"heights drawn {times} times larger"]
    words.append("fine lines every millimetre")
    if (height.source == HeightSource.EXTRAPOLATED).any():
        words.append("orange: edge of the calibrated range")
    if not height.in_view.all():
        words.append("grey: out of view")
    return " · ".join(words)


def exaggeration(height: HeightMap) -> int:
    """How many times larger than true the heights are drawn."""
    relief_mm = max(max_indentation_mm(height) + max_bulge_mm(height), CALM * height.noise_mm)
    room_mm = FLATTEST * max(height.z_mm.shape) * height.mm_per_px
    return max((times for times in EXAGGERATIONS if times * relief_mm <= room_mm), default=1)


def draw_block(axes: "Axes", height: HeightMap, times: int) -> None:
    """The block and the numbers along its edges, in axes whose coordinates are the pixels of its viewpoint."""
    rows, cols = round(HEIGHT_PX * FINER), round(WIDTH_PX * FINER)
    block, margin = block_under(height, times), NUMBERS_PX * FINER
    view = viewpoint_of(block.corners, (margin, margin), (cols - margin, rows - margin))
    image = render_block(block, paint_skin(height, fit_colour_scale(height)), trace_sightlines(block, view, rows, cols))
    shown = cv2.resize(image, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
    axes.imshow(shown, extent=(-0.5, cols - 0.5, rows - 0.5, -0.5), aspect="auto")
    axes.set_axis_off()
    number_edges(axes, block, view, times)


def block_under(height: HeightMap, times: int) -> Block:
    """The gel under the skin, heights exaggerated; level where the camera does not see it."""
    seen_mm = np.where(height.in_view, height.z_mm, np.float32(0))
    skin = cv2.GaussianBlur(seen_mm, (0, 0), SMOOTHING_PX) * np.float32(times)
    under_mm = UNDER_DEEPEST * max(skin.shape) * height.mm_per_px
    return Block(skin, height.mm_per_px, min(float(skin.min()), 0.0) - under_mm)

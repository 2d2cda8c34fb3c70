"""The relief image: a perspective view of the skin as the top of a block of gel, lit from one side, with millimetres along its
edges. `render_relief` returns it as a PNG; the block itself is rendered by `relief_renderer`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from ninedtact.quantities import HeightMap, HeightSource
from ninedtact.shape.coloured_height_map import (
    INK,
    LEFT_PX,
    PALE_INK,
    TOP_PX,
    add_axes_at,
    add_colour_bar,
    add_text_at,
    figure_to_png,
    fit_colour_scale,
    format_with_minus_sign,
    new_figure_page,
    round_up_to_1_2_5,
    shape_summary_sentence,
)
from ninedtact.shape.measures import max_bulge_mm, max_indentation_mm, summarise_shape
from ninedtact.shape.orthorectification import orthorectify
from ninedtact.shape.relief_renderer import (
    RayTracedGel,
    ReliefViewpoint,
    relief_texture,
    render_relief_block,
    trace_rays_to_relief,
    viewpoint_framing_corners,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


EdgePoint = tuple[float, float, float]

TICK_LENGTH, NUMBER = 0.010, {"left": 0.018, "center": 0.034, "right": 0.018}
"""Distance of tick marks and numbers from the block, as fractions of its length."""
CLOSEST, CLOSEST_HEIGHTS = 1 / 8, 0.025
"""Distance below which numbers would be crowded, along the skin and upwards, as fractions of the block's length."""


@dataclass(frozen=True)
class ReliefAxisEdge:
    """One coordinate axis along one edge of the block."""

    name: str
    at: Callable[[float], EdgePoint]
    """The point of the edge at a value of the coordinate."""
    outwards: EdgePoint
    align: Literal["left", "center", "right"]
    """Alignment of the text towards the block, or centred."""
    name_at: float
    """Value beside which the name of the coordinate is written."""
    low: float
    high: float
    step: float

    @property
    def values(self) -> list[float]:
        """Return the round numbers at which the edge has tick marks."""
        first, last = int(np.ceil(self.low / self.step)), int(np.floor(self.high / self.step))
        return [self.step * count for count in range(first, last + 1)]


def _number_edges(axes: "Axes", block: RayTracedGel, view: ReliefViewpoint, times: int) -> None:
    """Draw the numbers of x along the front, of y along the right, and of the heights, exaggerated `times`, up the left corner."""
    (left, front, base), (right, back, top) = block.low.tolist(), block.high.tolist()
    length, lowest, highest = 2 * max(right, back), base / times, top / times
    step, step_up = round_up_to_1_2_5(CLOSEST * length), round_up_to_1_2_5(CLOSEST_HEIGHTS * length / times)
    for edge in (
        ReliefAxisEdge("x (mm)", lambda x: (x, front, base), (0.0, -1.0, 0.0), "center", step / 2, left, right, step),
        ReliefAxisEdge("y (mm)", lambda y: (right, y, base), (1.0, 0.0, 0.0), "left", step / 2, front, back, step),
        ReliefAxisEdge(
            "z (mm)", lambda z: (left, front, z * times), (-1.0, 0.0, 0.0), "right", step_up, lowest, highest, step_up
        ),
    ):
        _number_edge(axes, edge, view, length)


def _number_edge(axes: "Axes", edge: ReliefAxisEdge, view: ReliefViewpoint, length: float) -> None:
    """Draw the tick marks, numbers and name of one edge."""
    out = length * np.array(edge.outwards)
    for value in edge.values:
        tick = np.array(edge.at(value)) + np.outer([0, TICK_LENGTH], out)
        axes.plot(*view.project(tick).T, color=PALE_INK, linewidth=0.8)
    words = {value: format_with_minus_sign(round(value, 6)) for value in edge.values} | {edge.name_at: edge.name}
    for value, word in words.items():
        x, y = view.project(np.array([edge.at(value)]) + NUMBER[edge.align] * out)[0]
        axes.text(x, y, word, color=INK, size=9, ha=edge.align, va="center")


WIDTH_PX, HEIGHT_PX = 860, 570
NUMBERS_PX = 50
"""Space around the block for the numbers along its edges."""
FINER = 1.5
"""Factor by which the block is rendered finer than it is shown, against jagged edges."""
SMOOTHING_PX = 2.0
"""Standard deviation of the Gaussian on the rendered heights; grazing light would otherwise amplify noise."""
EXAGGERATIONS = (1, 2, 5, 10, 20)
FLATTEST = 1 / 8
"""Heights are exaggerated as long as the relief stays below this fraction of the skin's longer side."""
CALM = 60
"""A relief below this many standard deviations of its noise is not exaggerated to the full height."""
UNDER_DEEPEST = 1 / 30
"""Thickness of the gel drawn under the deepest point, as a fraction of the skin's longer side."""


def render_relief(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """Return a PNG with the skin in perspective, seen from outside; axes and heights are in mm, and any exaggeration is stated."""
    figure = new_figure_page(title, shape_summary_sentence(summarise_shape(height)), WIDTH_PX, HEIGHT_PX)
    axes = add_axes_at(figure, LEFT_PX, TOP_PX, WIDTH_PX, HEIGHT_PX)
    straight, times = orthorectify(height), exaggeration(height)
    _draw_block(axes, straight, times)
    add_colour_bar(figure, fit_colour_scale(height), LEFT_PX + WIDTH_PX + 36, HEIGHT_PX)
    add_text_at(figure, LEFT_PX, TOP_PX + HEIGHT_PX + 60, _relief_caption(straight, times))
    return figure_to_png(figure)


def _relief_caption(height: HeightMap, times: int) -> str:
    """Return what the image shows, in one line."""
    words = ["seen from outside", "heights true to scale" if times == 1 else f"heights drawn {times} times larger"]
    words.append("fine lines every millimetre")
    if (height.source == HeightSource.EXTRAPOLATED).any():
        words.append("orange: edge of the calibrated range")
    if not height.in_view.all():
        words.append("grey: out of view")
    return " · ".join(words)


def exaggeration(height: HeightMap) -> int:
    """Return the vertical exaggeration."""
    relief_mm = max(max_indentation_mm(height) + max_bulge_mm(height), CALM * height.noise_mm)
    room_mm = FLATTEST * max(height.z_mm.shape) * height.mm_per_px
    return max((times for times in EXAGGERATIONS if times * relief_mm <= room_mm), default=1)


def _draw_block(axes: "Axes", height: HeightMap, times: int) -> None:
    """Draw the block and the numbers along its edges, in axes whose coordinates are the pixels of its viewpoint."""
    rows, cols = round(HEIGHT_PX * FINER), round(WIDTH_PX * FINER)
    block, margin = _block_under(height, times), NUMBERS_PX * FINER
    view = viewpoint_framing_corners(block.corners, (margin, margin), (cols - margin, rows - margin))
    image = render_relief_block(
        block, relief_texture(height, fit_colour_scale(height)), trace_rays_to_relief(block, view, rows, cols)
    )
    shown = cv2.resize(image, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
    axes.imshow(shown, extent=(-0.5, cols - 0.5, rows - 0.5, -0.5), aspect="auto")
    axes.set_axis_off()
    _number_edges(axes, block, view, times)


def _block_under(height: HeightMap, times: int) -> RayTracedGel:
    """Return the gel under the skin with exaggerated heights; it is level where the camera does not see it."""
    seen_mm = np.where(height.in_view, height.z_mm, np.float32(0))
    skin = cv2.GaussianBlur(seen_mm, (0, 0), SMOOTHING_PX) * np.float32(times)
    under_mm = UNDER_DEEPEST * max(skin.shape) * height.mm_per_px
    return RayTracedGel(skin, height.mm_per_px, min(float(skin.min()), 0.0) - under_mm)

"""The skin in perspective, lit from a side: the top of a block of gel with millimetres along its edges."""

from typing import TYPE_CHECKING

import cv2
import numpy as np

from ninedtact.quantities import Coverage, HeightMap
from ninedtact.shape.image.edges import number_edges
from ninedtact.shape.image.page import LEFT_PX, TOP_PX, axes_at, colour_bar, in_words, note, page, png
from ninedtact.shape.image.palette import scale_for
from ninedtact.shape.image.render import render
from ninedtact.shape.image.sight import Block, sight_of
from ninedtact.shape.image.texture import texture
from ninedtact.shape.image.viewpoint import viewpoint_of
from ninedtact.shape.measures import max_bulge_mm, max_indentation_mm, summarise
from ninedtact.shape.sightlines import from_straight_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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


def shaded_image(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """A PNG with the skin in perspective, seen from outside; axes and heights in mm, any exaggeration stated."""
    figure = page(title, in_words(summarise(height)), WIDTH_PX, HEIGHT_PX)
    axes = axes_at(figure, LEFT_PX, TOP_PX, WIDTH_PX, HEIGHT_PX)
    straight, times = from_straight_below(height), exaggeration(height)
    draw_block(axes, straight, times)
    colour_bar(figure, scale_for(height), LEFT_PX + WIDTH_PX + 36, HEIGHT_PX)
    note(figure, LEFT_PX, TOP_PX + HEIGHT_PX + 60, legend(straight, times))
    return png(figure)


def legend(height: HeightMap, times: int) -> str:
    """What the image shows, in one line."""
    words = ["seen from outside", "heights true to scale" if times == 1 else f"heights drawn {times} times larger"]
    words.append("fine lines every millimetre")
    if (height.coverage == Coverage.EXTRAPOLATED).any():
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
    image = render(block, texture(height, scale_for(height)), sight_of(block, view, rows, cols))
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

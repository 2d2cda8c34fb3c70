"""The skin in perspective, lit from a side, as the top of a block of gel that stands in a frame of millimetres."""

from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap
from ninedtact.shape.measures import max_bulge_mm, max_indentation_mm, summarise
from ninedtact.shape.picture.page import INK, LEFT_PX, TOP_PX, axes_at, colour_bar, in_words, note, page, png, signed
from ninedtact.shape.picture.palette import scale_for
from ninedtact.shape.picture.render import render
from ninedtact.shape.picture.sight import Block, sight_of
from ninedtact.shape.picture.texture import texture
from ninedtact.shape.picture.viewpoint import Viewpoint, viewpoint_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_PX, HEIGHT_PX = 860, 600
NUMBERS_PX = 45
"""Room around the block for the numbers along its edges."""
FINER = 1.5
"""The picture is computed this much finer than it is shown, against jagged edges."""
SMOOTHING_PX = 2.0
"""Standard deviation of the Gaussian on the heights that are lit: light that grazes the skin shows noise above all."""
EXAGGERATIONS = (1, 2, 5, 10, 20)
FLATTEST = 1 / 8
"""The heights are exaggerated as long as the relief stays below this part of the skin's longer side."""
TICK_MM = 5


def relief_picture(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """A PNG with the skin in perspective, seen from outside; axes and heights in mm, any exaggeration stated."""
    times, scale = exaggeration(height), scale_for(height)
    block = block_of(height, times)
    margin, size = np.array([NUMBERS_PX, NUMBERS_PX]), np.array([WIDTH_PX, HEIGHT_PX])
    view = viewpoint_of(block.corners, tuple(margin * FINER), tuple((size - margin) * FINER))
    seen = sight_of(block, view, int(HEIGHT_PX * FINER), int(WIDTH_PX * FINER))
    picture = cv2.resize(render(block, texture(height, scale), seen), (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA)
    figure = page(title, in_words(summarise(height)), WIDTH_PX, HEIGHT_PX)
    axes = axes_at(figure, LEFT_PX, TOP_PX, WIDTH_PX, HEIGHT_PX)
    draw(axes, picture)
    number_edges(axes, block, view, times)
    colour_bar(figure, scale, LEFT_PX + WIDTH_PX + 36, HEIGHT_PX)
    return png(figure)


def exaggeration(height: HeightMap) -> int:
    """How many times larger than true the heights are drawn."""
    relief = max(max_indentation_mm(height) + max_bulge_mm(height), 1e-3)
    room = FLATTEST * max(height.z_mm.shape) * height.mm_per_px
    return max([times for times in EXAGGERATIONS if times * relief <= room], default=1)

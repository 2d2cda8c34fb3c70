"""Light and colour on what an image's lines of sight meet."""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.shape.image.sight import AT_THE_EDGE, Block, Sight

LIGHT = np.array([-0.70, 0.30, 0.65]) / np.linalg.norm([-0.70, 0.30, 0.65])
"""Towards the light: from the left and a little from behind, so that slopes show."""
AMBIENT = 0.5
"""Share of the light that comes from everywhere."""
WALL = np.array([206, 208, 212], np.float32)
SIDE_WALL = np.float32(0.87)
"""Brightness of the wall to the right, against the one in front."""
BASE_SHADE = 0.16
"""Brightness that a wall loses from the skin to the base."""


def render(block: Block, colours: UInt8[Array, "fine_rows fine_cols 3"], sight: Sight) -> UInt8[Array, "rows cols 3"]:
    """Colour what is seen, white where nothing is; `colours` lie over the whole skin, at any resolution."""
    finer, half = np.float32(colours.shape[1] / block.skin.shape[1]), np.float32(0.5)
    # Pixels are areas: the edges of the two grids coincide, not the centres of their first pixels.
    col, row = (sight.col + half) * finer - half, (sight.row + half) * finer - half
    skin = cv2.remap(colours, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    light = cv2.remap(shading(block), sight.col, sight.row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    image = np.full(skin.shape, 255, np.uint8)
    image[sight.on_skin] = np.minimum(skin * light[..., None], 255)[sight.on_skin]
    image[sight.on_wall] = wall_colours(block, sight)[sight.on_wall]
    return image


def shading(block: Block) -> Float32[Array, "skin_rows skin_cols"]:
    """How bright the skin is at each pixel, 1 where it is level."""
    y, x = np.gradient(block.skin, block.mm_per_px)
    facing = (LIGHT[2] - x * LIGHT[0] - y * LIGHT[1]) / np.sqrt(1 + x * x + y * y)
    return np.asarray(AMBIENT + (1 - AMBIENT) * np.maximum(facing, 0) / LIGHT[2], np.float32)


def wall_colours(block: Block, sight: Sight) -> Float32[Array, "rows cols 3"]:
    """Grey, darker on the side and towards the base."""
    brightness = np.where(sight.row < AT_THE_EDGE, np.float32(1), SIDE_WALL)
    depth = (block.high[2] - sight.z) / (block.high[2] - block.low[2])
    return np.asarray((brightness * (1 - BASE_SHADE * depth))[..., None] * WALL, np.float32)

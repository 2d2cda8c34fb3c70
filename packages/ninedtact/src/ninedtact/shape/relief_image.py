"""The relief image: the height map as the camera sees it, in the colours of height and shaded as if lit from the upper left."""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap
from ninedtact.shape.coloured_height_map import ColourScale, colourise_heights, draw_map_page, fit_colour_scale

TOWARDS_LIGHT = np.array([-0.43, -0.43, 0.79])
"""Direction from the skin to the light, in front of the upper left corner."""
AMBIENT = 0.3
"""Fraction of the light that is ambient."""
SMOOTHING_PX = 2.0
"""Standard deviation of the Gaussian on the heights that are shaded; grazing light would otherwise amplify noise."""


def render_relief(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """Return a PNG with the skin in colours of height, shaded as if lit from the upper left; axes and heights are in mm."""
    scale = fit_colour_scale(height)
    return draw_map_page(height, title, shade_heights(height, scale)[..., ::-1], scale, "lit from the upper left")


def shade_heights(height: HeightMap, scale: ColourScale = ColourScale()) -> UInt8[Array, "rows cols 3"]:
    """Return heights as a BGR image, in the colours of `colourise_heights` and shaded by `facing_light`."""
    z_mm = cv2.GaussianBlur(np.where(height.in_view, height.z_mm, np.float32(0)), (0, 0), SMOOTHING_PX)
    light = np.where(height.in_view, facing_light(z_mm, height.mm_per_px), np.float32(1))
    return np.asarray(np.clip(colourise_heights(height, scale) * light[..., None], 0, 255), np.uint8)


def facing_light(z_mm: Float32[Array, "rows cols"], mm_per_px: float) -> Float32[Array, "rows cols"]:
    """Return the brightness of a surface of these heights, 1 where it is level: ambient light and Lambert's cosine law."""
    slope_y, slope_x = np.gradient(z_mm, mm_per_px)
    to_x, to_y, to_z = TOWARDS_LIGHT
    cosine = (to_z - slope_x * to_x - slope_y * to_y) / np.sqrt(1 + slope_x**2 + slope_y**2)
    return np.asarray(AMBIENT + (1 - AMBIENT) * np.maximum(cosine, 0) / to_z, np.float32)

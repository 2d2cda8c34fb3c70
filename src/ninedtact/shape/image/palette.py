"""Colours of heights: blue where the skin is pressed in, red where it bulges, nearly white where it is untouched."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap
from ninedtact.shape.measures import max_bulge_mm, max_indentation_mm

# ColorBrewer's RdBu, which colour-blind readers can tell apart.
PRESSED = ("#f7f7f7", "#d1e5f0", "#92c5de", "#4393c3", "#2166ac", "#08306b")
BULGED = ("#f7f7f7", "#fddbc7", "#f4a582", "#d6604d", "#b2182b", "#67001f")
OUT_OF_VIEW = "#8c8c8c"


@dataclass(frozen=True)
class ColourScale:
    """Heights at the two ends of the colours; each side has its own, as a bulge is far smaller than what causes it."""

    pressed_mm: float = 2.0
    bulged_mm: float = 0.5

    @cached_property
    def table(self) -> UInt8[Array, "256 3"]:
        """RGB of 256 equal steps of height; the first stands for out of view."""
        z_mm = np.linspace(-self.pressed_mm, self.bulged_mm, 255)
        return np.asarray(np.vstack([rgb(OUT_OF_VIEW), self.colour(z_mm)]), np.uint8)

    def colour(self, z_mm: Float[Array, " n"]) -> Float[Array, "n 3"]:
        """RGB (0 to 255) of some heights."""
        pressed, bulged = (np.array([rgb(stop) for stop in stops]) for stops in (PRESSED, BULGED))
        stops = np.vstack([pressed[::-1], bulged[1:]])
        places = [*np.linspace(-self.pressed_mm, 0, len(pressed)), *np.linspace(0, self.bulged_mm, len(bulged))[1:]]
        return np.column_stack([np.rint(np.interp(z_mm, places, channel)) for channel in stops.T])


def scale_for(height: HeightMap) -> ColourScale:
    """Ends that hold all of one height map; noise alone stays pale."""
    faintest = max(0.05, 10 * height.noise_mm)
    pressed = max(max_indentation_mm(height), faintest)
    return ColourScale(pressed, max(max_bulge_mm(height), faintest, pressed / 8))


def colourise(height: HeightMap, scale: ColourScale = ColourScale()) -> UInt8[Array, "rows cols 3"]:
    """Heights as a BGR image for live display; beyond the ends of the scale, the colour of the end."""
    steps_per_mm = 254 / (scale.pressed_mm + scale.bulged_mm)
    index = cv2.addWeighted(
        height.z_mm, steps_per_mm, height.z_mm, 0, 1 + scale.pressed_mm * steps_per_mm, dtype=cv2.CV_8U
    )
    index = np.maximum(index, np.uint8(1))
    index *= height.in_view
    return np.asarray(cv2.applyColorMap(index, np.ascontiguousarray(scale.table[:, None, ::-1])))


def rgb(colour: str) -> tuple[int, ...]:
    """Red, green and blue (0 to 255) of #rrggbb."""
    return tuple(bytes.fromhex(colour[1:]))

"""All that the page draws of one reading."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.reading import Reading
from ninedtact.shape.depth import DepthCurve
from ninedtact.shape.image.palette import ColourScale, colourise
from ninedtact.shape.measures import ShapeSummary, summarise
from ninedtact.studio.surface import Surface, surface_of

FADED = 0.35
"""Brightness left to images of the past."""


@dataclass(frozen=True)
class View:
    """One reading, drawn."""

    reading: Reading
    image: UInt8[Array, "raw_rows raw_cols 3"]
    """BGR, as the camera gave it."""
    heights: UInt8[Array, "rows cols 3"]
    """BGR, false colours."""
    surface: Surface
    summary: ShapeSummary
    is_past: bool = False
    """Faded, so that nobody takes it for the present."""

    def faded(self) -> "View":
        """The same as a thing of the past."""
        if self.is_past:
            return self
        surface = replace(self.surface, colours=darker(self.surface.colours))
        return replace(self, image=darker(self.image), heights=darker(self.heights), surface=surface, is_past=True)


def drawn(reading: Reading, scale: ColourScale) -> View:
    """Draw a reading, heights in the colours of `scale`."""
    heights = colourise(reading.height, scale)
    surface, summary = surface_of(reading.height, heights), summarise(reading.height)
    return View(reading, reading.frame.image, heights, surface, summary)


def scale_of(curve: DepthCurve) -> ColourScale:
    """Colours that stay the same all session: the whole calibrated range."""
    deepest_mm = max(round(curve.max_indentation_mm, 1), 0.1)
    return ColourScale(deepest_mm, max(curve.bulge_mm[-1], deepest_mm / 4))


def darker(colours: UInt8[Array, "*shape 3"]) -> UInt8[Array, "*shape 3"]:
    """The same image, dim."""
    return (colours * np.float32(FADED)).astype(np.uint8)

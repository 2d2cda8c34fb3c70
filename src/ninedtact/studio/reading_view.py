"""The view of one reading on the live page: image, coloured heights, and the surface with its triangles."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Int32, UInt8
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap
from ninedtact.reading import Reading
from ninedtact.shape.coloured_height_map import ColourScale, colourise_heights
from ninedtact.shape.depth import DepthCurve
from ninedtact.shape.measures import ShapeSummary, summarise_shape
from ninedtact.shape.surface import point_cloud, triangulate_view

MAX_SURFACE_POINTS = 40_000
"""Number of points that a browser draws smoothly without a graphics card. Measures use the full map, not these points."""
LIGHT_DIRECTION = np.array([-0.5, 0.35, 0.79], np.float32)
"""Direction towards the light: grazing, from the upper left of the first view, so that shallow relief is visible."""
SHADE = 0.45
"""Brightness of skin that faces away from the light; level skin keeps its colour."""


@dataclass(frozen=True)
class SkinSurface:
    """Points on the skin, and triangles between neighbouring points."""

    points_mm: Float32[Array, "n 3"]
    colours: UInt8[Array, "n 3"]
    """Red, green and blue: the colour of the height, lit from one side, because points have no shading of their own."""
    faces: Int32[Array, "m 3"]
    spacing_mm: float
    """Distance of neighbouring points on undeformed skin."""


def skin_surface(height: HeightMap, colours_bgr: UInt8[Array, "rows cols 3"]) -> SkinSurface:
    """Return evenly spaced points of a height map, with their colours in an image of the same size."""
    every = _row_step(height)
    cloud, seen = point_cloud(height, every), height.in_view[::every, ::every]
    colours = colours_bgr[::every, ::every][seen][:, ::-1]
    return SkinSurface(
        cloud.points_mm, _shade_colours(colours, cloud.normals), triangulate_view(seen), every * height.mm_per_px
    )


def _row_step(height: HeightMap) -> int:
    """Return the step between the rows, and between the columns, that are kept."""
    return int(np.ceil(np.sqrt(height.z_mm.size / MAX_SURFACE_POINTS)))


def _shade_colours(colours: UInt8[Array, "n 3"], normals: Float32[Array, "n 3"]) -> UInt8[Array, "n 3"]:
    """Return colours under a light from one side."""
    towards = np.maximum(normals @ (LIGHT_DIRECTION / LIGHT_DIRECTION[2]), 0)
    brightness = SHADE + (1 - SHADE) * towards
    return np.clip(colours * brightness[:, None], 0, 255).astype(np.uint8)


FADED = 0.35
"""Factor of the brightness of images that are not current."""


@dataclass(frozen=True)
class ReadingView:
    """The images, the surface and the summary of one reading."""

    reading: Reading
    image: UInt8[Array, "raw_rows raw_cols 3"]
    """The camera image in BGR, unchanged."""
    heights: UInt8[Array, "rows cols 3"]
    """The heights as a false-colour image in BGR."""
    surface: SkinSurface
    summary: ShapeSummary
    is_past: bool = False
    """Whether the view is dimmed because it is not current."""

    def dimmed_copy(self) -> "ReadingView":
        """Return the view with dimmed colours, which mark it as not current."""
        if self.is_past:
            return self
        surface = replace(self.surface, colours=_darken(self.surface.colours))
        return replace(self, image=_darken(self.image), heights=_darken(self.heights), surface=surface, is_past=True)


def render_reading(reading: Reading, scale: ColourScale) -> ReadingView:
    """Return the view of a reading, with heights in the colours of `scale`."""
    heights = colourise_heights(reading.height, scale)
    surface, summary = skin_surface(reading.height, heights), summarise_shape(reading.height)
    return ReadingView(reading, reading.frame.image, heights, surface, summary)


def session_colour_scale(curve: DepthCurve) -> ColourScale:
    """Return the colour scale of a session, which spans the whole calibrated range."""
    deepest_mm = max(round(curve.max_indentation_mm, 1), 0.1)
    return ColourScale(deepest_mm, max(curve.bulge_mm[-1], deepest_mm / 4))


def _darken(colours: UInt8[Array, "*shape 3"]) -> UInt8[Array, "*shape 3"]:
    """Return an image with its brightness reduced to `FADED`."""
    return (colours * np.float32(FADED)).astype(np.uint8)

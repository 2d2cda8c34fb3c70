"""The view of one reading on the live page: its images, the surface with its triangles, and the profile along a line.

A `ReadingView` belongs to one reading. What it draws is drawn when a viewer first asks for it, and once for all viewers.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, lru_cache
from typing import Any, TypeVar, cast

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float16, Float32, Int32, UInt8, UInt32
from numpy import ndarray as Array

from ninedtact.force.brightness_channels import compute_image_deformation, render_brightness_change
from ninedtact.mechanics.numpy_or_torch_arrays import to_numpy
from ninedtact.quantities import HeightMap
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.coloured_height_map import ColourScale, colourise_heights
from ninedtact.shape.orthorectification import find_pixels_of_skin_places, sample_field
from ninedtact.shape.surface import ShapeSummary, point_cloud, sightline_scale, triangulate_view
from ninedtact.simulation.pixel_to_skin_map import grid_indices_at_positions, sample_periodic
from ninedtact.simulation.press import Press
from ninedtact.studio.skin_fields import (
    SkinTractions,
    colourise_magnitudes,
    interpolate_estimated_tractions,
    true_tractions,
)

MAX_SURFACE_POINTS = 40_000
"""Number of points that a browser draws smoothly without a graphics card. Measures use the full map, not these points."""
LIGHT_DIRECTION = np.array([-0.5, 0.35, 0.79], np.float32)
"""Direction towards the light: grazing, from the upper left of the first view, so that shallow relief is visible."""
SHADE = 0.45
"""Brightness of skin that faces away from the light; level skin keeps its colour."""
FADED = 0.35
"""Factor of the brightness of images that are not current."""
_OUTLINE = (20, 20, 20)
LINE_LIFT_MM = 0.2
"""Height of lines over the skin, so that the points of a coarse surface do not hide them."""
JPEG_QUALITY = 85
TILE_WIDTH_PX = 320
"""Width of the image of one sensor where those of several stand side by side."""

T = TypeVar("T")
Image = UInt8[Array, "rows cols 3"]


class ImageKind(StrEnum):
    """An image of the page; the text is the name in its menu."""

    CAMERA = "camera image"
    GEL_FLOW = "gel flow, red and green"
    GEL_FLOW_SAFE = "gel flow, orange and blue"
    HEIGHT = "height"
    PRESSURE = "pressure"
    SHEAR = "shear"
    STICKING = "stick and slip (twin)"


class SkinColouring(StrEnum):
    """What the colours of the surface in 3D show."""

    HEIGHT = "height"
    PRESSURE = "pressure"
    SHEAR = "shear"
    NORMALS = "normals"
    PLAIN = "plain shaded surface"


class ShownTraction(StrEnum):
    """Which pressure and shear are shown."""

    ESTIMATED = "estimated"
    TRUE = "true (twin)"


@dataclass(frozen=True)
class SkinSurface:
    """Points on the skin, row by row, and triangles between neighbouring points."""

    points_mm: Float32[Array, "n 3"]
    colours: UInt8[Array, "n 3"]
    """Red, green and blue: the colour of the height, lit from one side, because points have no shading of their own."""
    in_view: Bool[Array, "rows cols"]
    """Which places of the grid have a point."""
    spacing_mm: float
    """Distance of neighbouring points on undeformed skin."""

    @cached_property
    def half_precision_points_mm(self) -> Float16[Array, "n 3"]:
        """The points to 0.004 mm, in half of the bytes; OpenCV rounds them twenty times faster than numpy."""
        rows = self.points_mm.reshape(1, -1)
        return np.asarray(cv2.addWeighted(rows, 1, rows, 0, 0, dtype=cv2.CV_16F)).reshape(-1, 3)

    @cached_property
    def faces(self) -> UInt32[Array, "m 3"]:
        """Triangles between neighbouring points; the same array for all surfaces of one size that are wholly in view."""
        in_view = self.in_view
        return _whole_view_faces(in_view.shape) if in_view.all() else triangulate_view(in_view).astype(np.uint32)


@lru_cache(maxsize=4)
def _whole_view_faces(shape: tuple[int, int]) -> UInt32[Array, "m 3"]:
    return triangulate_view(np.ones(shape, bool)).astype(np.uint32)


def skin_surface(height: HeightMap, colours_bgr: Image | None, coarser: int = 1) -> SkinSurface:
    """Return evenly spaced points of a height map, with their colours in an image of the same size.

    colours_bgr: None colours by the direction of the outward normal: red along x, green along y, blue outwards.
    coarser: factor by which neighbouring points are farther apart than in the finest surface.
    """
    every = int(np.ceil(np.sqrt(height.z_mm.size / MAX_SURFACE_POINTS))) * coarser
    cloud, seen = point_cloud(height, every), height.in_view[::every, ::every]
    if colours_bgr is None:
        colours = np.clip(cloud.normals * 127.5 + 127.5, 0, 255).astype(np.uint8)
    else:
        # numpy copies items of three bytes ten times faster than rows of three.
        few = np.ascontiguousarray(colours_bgr.view("V3")[::every, ::every]).view(np.uint8)
        colours = _shade_colours(np.asarray(cv2.cvtColor(few, cv2.COLOR_BGR2RGB), np.uint8), seen, cloud.normals)
    return SkinSurface(cloud.points_mm, colours, seen, every * height.mm_per_px)


def _shade_colours(image: Image, seen: Bool[Array, "rows cols"], normals: Float32[Array, "n 3"]) -> UInt8[Array, "n 3"]:
    """Return the colours of an image at the pixels in view, under a light from one side."""
    colours = image.reshape(-1, 3) if seen.all() else image[seen]
    towards = cv2.transform(normals[:, None], (LIGHT_DIRECTION / LIGHT_DIRECTION[2])[None])
    brightness = SHADE + (1 - SHADE) * np.maximum(towards, 0)
    return np.asarray(cv2.multiply(colours[:, None], cv2.merge([brightness] * 3), dtype=cv2.CV_8U)[:, 0], np.uint8)


@dataclass(frozen=True)
class HeightProfile:
    """Heights along a straight line on the skin."""

    distance_mm: Float[Array, " n"]
    """Distance from the first end."""
    height_mm: Float[Array, " n"]
    """Height of the skin from the image; not a number out of view."""
    true_mm: Float[Array, " n"] | None
    """Height of the simulated skin; None for a sensor that is no twin."""
    points_mm: Float[Array, "n 3"]


PROFILE_POINTS = 200
_SIGHTLINE_ITERATIONS = 2
"""A line of sight is displaced by a few per cent, so that the iteration converges at once."""


@dataclass(frozen=True)
class ReadingView:
    """The images, the surface and the measures of one reading, with what the twin knows of the same moment."""

    reading: Reading
    scale: ColourScale
    """The colours of the heights."""
    press: Press | None = None
    """The object and the contact of the twin; None for a sensor that is no twin, or where it is no longer known."""
    is_past: bool = False
    """Whether the view is dimmed because it is not current."""
    _drawn: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)
    """Everything that has been drawn, by what it is."""

    @property
    def summary(self) -> ShapeSummary:
        """The measures of the shape."""
        return self.reading.summary

    def with_past(self, is_past: bool) -> "ReadingView":
        """Return the view dimmed where it is not current, or in full brightness; nothing of another view has been drawn yet."""
        return self if is_past == self.is_past else replace(self, is_past=is_past, _drawn={})

    def image(self, kind: ImageKind, with_outline: bool = False, source: ShownTraction = ShownTraction.TRUE) -> Image:
        """Return an image in BGR; where something is not known, the image is grey."""
        return self._draw(("image", kind, with_outline, source), lambda: self._draw_image(kind, with_outline, source))

    def scale_end_mpa(self, kind: ImageKind, source: ShownTraction) -> float | None:
        """Return the pressure or shear at the end of the colours; None for other images and where nothing is known."""
        tractions = self.tractions(source)
        if tractions is None or kind not in (ImageKind.PRESSURE, ImageKind.SHEAR):
            return None
        return self._coloured_field(kind, tractions, source)[1]

    def tractions(self, source: ShownTraction) -> SkinTractions | None:
        """Return pressure and shear of the twin or of the estimate; None where they are not known."""
        if source is ShownTraction.TRUE:
            press = self.press
            return None if press is None else self._draw("true", lambda: true_tractions(press, self.reading.height))
        traction = None if self.reading.force is None else self.reading.force.traction
        if traction is None:
            return None
        return self._draw("estimated", lambda: interpolate_estimated_tractions(traction, self.reading.height))

    def surface(self, colouring: SkinColouring, coarser: int, source: ShownTraction) -> SkinSurface:
        """Return the surface in these colours."""
        return self._draw(
            ("surface", colouring, coarser, source), lambda: self._draw_surface(colouring, coarser, source)
        )

    @cached_property
    def contact_outlines_px(self) -> list[Int32[Array, "n 1 2"]]:
        """The edges of the contact and of the holes in it, as columns and rows of the height map."""
        mask = self.reading.contact.astype(np.uint8)
        return [np.asarray(line, np.int32) for line in cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]]

    def outline_mm(self) -> Float32[Array, "n 2 3"]:
        """Return the edges of the contact as pieces of line on the skin."""
        height = self.reading.height
        (x, y), scale = height.axes_mm, sightline_scale(height)
        pieces = []
        for line in self.contact_outlines_px:
            cols, rows = line[:, 0, 0], line[:, 0, 1]
            z_mm, stretch = height.z_mm[rows, cols] + np.float32(LINE_LIFT_MM), scale[rows, cols]
            points = np.stack([x[cols] * stretch, y[rows] * stretch, z_mm], axis=-1)
            pieces.append(np.stack([points, np.roll(points, -1, axis=0)], axis=1))
        return np.concatenate(pieces).astype(np.float32) if pieces else np.zeros((1, 2, 3), np.float32)

    def profile(self, start_mm: tuple[float, float], end_mm: tuple[float, float]) -> HeightProfile:
        """Return the heights along a line between two positions on the skin."""
        part = np.linspace(0, 1, PROFILE_POINTS)
        x, y = (a + part * (b - a) for a, b in zip(start_mm, end_mm, strict=True))
        z_mm = _heights_at(self.reading.height, x, y)
        true_mm = None if self.press is None else _true_heights_at(self.press, x, y)
        points = np.stack([x, y, np.nan_to_num(z_mm) + LINE_LIFT_MM], axis=-1)
        return HeightProfile(part * float(np.hypot(x[-1] - x[0], y[-1] - y[0])), z_mm, true_mm, points)

    def _draw(self, key: Any, draw: Callable[[], T]) -> T:
        if key not in self._drawn:
            self._drawn[key] = draw()
        return cast("T", self._drawn[key])

    def _draw_image(self, kind: ImageKind, with_outline: bool, source: ShownTraction) -> Image:
        height = self.reading.height
        image = self._full_image(kind, source)
        if with_outline and kind is not ImageKind.CAMERA:
            size = height.z_mm.shape[::-1]
            if image.shape[1::-1] != size:
                image = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
            colour = (255, 255, 255) if kind in (ImageKind.GEL_FLOW, ImageKind.GEL_FLOW_SAFE) else _OUTLINE
            image = cv2.polylines(image.copy(), self.contact_outlines_px, True, colour, 1, cv2.LINE_AA)
        return _darken(image) if self.is_past else image

    def _full_image(self, kind: ImageKind, source: ShownTraction) -> Image:
        if kind is ImageKind.CAMERA:
            return self.reading.frame.image
        if kind is ImageKind.HEIGHT:
            return self._draw(("colours", kind), lambda: colourise_heights(self.reading.height, self.scale))
        tractions = self.tractions(ShownTraction.TRUE if kind is ImageKind.STICKING else source)
        if kind in (ImageKind.GEL_FLOW, ImageKind.GEL_FLOW_SAFE):
            flow = render_brightness_change(compute_image_deformation(self.reading.rectified, self.reading.reference))
            return flow if kind is ImageKind.GEL_FLOW else _to_orange_and_blue(flow)
        if tractions is not None and kind is ImageKind.STICKING:
            return tractions.sticking_image()
        if tractions is not None and kind in (ImageKind.PRESSURE, ImageKind.SHEAR):
            return self._coloured_field(kind, tractions, source)[0]
        return np.full((*self.reading.height.z_mm.shape, 3), 90, np.uint8)

    def _coloured_field(self, kind: ImageKind, tractions: SkinTractions, source: ShownTraction) -> tuple[Image, float]:
        """Return pressure or shear in colours, and the end of their scale in MPa."""
        values = tractions.pressure_mpa if kind is ImageKind.PRESSURE else tractions.shear_magnitude_mpa
        return self._draw(("field", kind, source), lambda: colourise_magnitudes(values))

    def _draw_surface(self, colouring: SkinColouring, coarser: int, source: ShownTraction) -> SkinSurface:
        height = self.reading.height
        image: Image | None = None
        if colouring is not SkinColouring.NORMALS:
            kinds = {SkinColouring.PRESSURE: ImageKind.PRESSURE, SkinColouring.SHEAR: ImageKind.SHEAR}
            image = self._full_image(kinds.get(colouring, ImageKind.HEIGHT), source)
            if image.shape[:2] != height.z_mm.shape:
                image = np.asarray(cv2.resize(image, height.z_mm.shape[::-1], interpolation=cv2.INTER_LINEAR), np.uint8)
        surface = skin_surface(height, image, coarser)
        return replace(surface, colours=_darken(surface.colours)) if self.is_past else surface


def tile_sensor_images(
    views: Mapping[str, ReadingView], kind: ImageKind, with_outline: bool, source: ShownTraction
) -> Image:
    """Return the same image of several sensors side by side, with their names, in BGR."""
    images = [view.image(kind, with_outline, source) for view in views.values()]
    rows, cols = images[0].shape[0] * TILE_WIDTH_PX // images[0].shape[1], TILE_WIDTH_PX
    tiles = [np.asarray(cv2.resize(image, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8) for image in images]
    for tile, name in zip(tiles, views, strict=True):
        cv2.rectangle(tile, (0, 0), (9 * len(name) + 8, 18), (30, 30, 30), cv2.FILLED)
        cv2.putText(tile, name, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    tiles += [np.full_like(tiles[0], 90)] * (len(tiles) % 2)
    pairs = [np.hstack(tiles[at : at + 2]) for at in range(0, len(tiles), 2)]
    return np.vstack(pairs)


def full_range_colour_scale(shape: CalibratedShape) -> ColourScale:
    """Return the colour scale of a session, symmetric about zero, which spans the whole calibrated range of depth."""
    bulge_mm = shape.curve.bulge_mm
    deepest_mm = max(round(shape.depth_range_mm, 1), 0.1, round(bulge_mm[-1], 1) if bulge_mm else 0.0)
    return ColourScale(deepest_mm, deepest_mm)


def _heights_at(height: HeightMap, x_mm: Float[Array, " n"], y_mm: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the heights of the skin at positions: pixels are lines of sight, which are followed to where they meet the skin."""
    places, pitch = np.stack([x_mm, y_mm]).astype(np.float32)[:, None], (height.mm_per_px, height.mm_per_px)
    pixel = find_pixels_of_skin_places(height.z_mm, pitch, places, height.camera_distance_mm, _SIGHTLINE_ITERATIONS)
    z_mm = sample_field(height.z_mm, pixel, cv2.INTER_LINEAR)
    seen = cv2.remap(height.in_view.astype(np.float32), pixel[0], pixel[1], cv2.INTER_LINEAR, borderValue=0)
    return np.where(seen[0] > 0.999, z_mm[0].astype(float), np.nan)


def _true_heights_at(press: Press, x_mm: Float[Array, " n"], y_mm: Float[Array, " n"]) -> Float[Array, " n"]:
    contact = press.corrected
    at = grid_indices_at_positions(
        contact.skin.grid, contact.centre_mm, x_mm[None].astype(np.float32), y_mm[None].astype(np.float32)
    )
    return np.asarray(sample_periodic(to_numpy(contact.height_mm).astype(np.float32), *at)[0], float)


def _to_orange_and_blue(flow_bgr: Image) -> Image:
    """Return a gel-flow image whose darker parts are orange and whose brighter parts are blue."""
    red, green = flow_bgr[..., 2], flow_bgr[..., 1]
    return np.asarray(cv2.merge([green, cv2.addWeighted(red, 0.6, green, 0.45, 0), red]), np.uint8)


def _darken(colours: UInt8[Array, "*shape 3"]) -> UInt8[Array, "*shape 3"]:
    """Return an image with its brightness reduced to `FADED`."""
    return (colours * np.float32(FADED)).astype(np.uint8)

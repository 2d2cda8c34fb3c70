"""The renderer of the relief image: viewpoint, ray tracing, texture and shading. A `ReliefViewpoint` is a pinhole camera in front
of a `RayTracedGel`. `trace_rays_to_relief` follows the line of sight of every pixel to the block, `relief_texture` makes the
texture (colours of height, a millimetre grid, the calibrated range), and `render_relief_block` shades what the lines of sight
meet.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap, HeightSource
from ninedtact.shape.coloured_height_map import EXTRAPOLATED, ColourScale, colourise_heights, rgb_of_hex

TOWARDS_EYE = np.array([0.36, -0.80, 0.74]) / np.linalg.norm([0.36, -0.80, 0.74])
"""Direction from the skin to the eye: outside, in front of the edge of smallest y, a little to the right."""
DISTANCE = 2.6
"""Distance of the eye, in diagonals of what it sees; a smaller one distorts the image as a wide-angle lens does."""


@dataclass(frozen=True)
class ReliefViewpoint:
    """The pinhole camera from which the relief is drawn; its image has z upwards."""

    eye: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    """Unit vectors to the right, downwards and ahead, as rows."""
    focal_px: float
    centre_px: Float[Array, "2"]

    def project(self, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
        """Return the pixels (x, y) at which points in space appear."""
        right, down, ahead = self.axes @ (points - self.eye).T
        return np.asarray(np.column_stack([right / ahead, down / ahead]) * self.focal_px + self.centre_px)

    def rays(self, rows: int, cols: int) -> Float32[Array, "3 rows cols"]:
        """Return the viewing direction of every pixel, scaled to unit depth."""
        x, y = np.meshgrid(np.arange(cols) - self.centre_px[0], np.arange(rows) - self.centre_px[1])
        here = np.stack([x / self.focal_px, y / self.focal_px, np.ones_like(x)])
        return np.asarray(np.einsum("ij,irc->jrc", self.axes, here), np.float32)


def viewpoint_framing_corners(
    corners: Float[Array, "n 3"], top_left_px: tuple[float, float], bottom_right_px: tuple[float, float]
) -> ReliefViewpoint:
    """Return the viewpoint from which all `corners` appear as large as fits between two pixels (x, y)."""
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    eye = middle + TOWARDS_EYE * DISTANCE * np.linalg.norm(np.ptp(corners, axis=0))
    right = np.cross([0, 0, 1], TOWARDS_EYE)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(right, TOWARDS_EYE), -TOWARDS_EYE])
    seen = ReliefViewpoint(eye, axes, 1.0, np.zeros(2)).project(corners)
    room = np.subtract(bottom_right_px, top_left_px)
    focal_px = float((room / np.ptp(seen, axis=0)).min())
    centre_px = np.add(top_left_px, room / 2) - focal_px * (seen.min(axis=0) + seen.max(axis=0)) / 2
    return ReliefViewpoint(eye, axes, focal_px, centre_px)


PixelField = Float32[Array, "rows cols"]

AT_THE_EDGE = 1e-3
"""Tolerance, in pixels or mm, for points that rounding moves off their wall."""
RAY_STEPS = 28
"""Number of steps along each line of sight through the box around the block; detail thinner than a step may be missed."""
RAY_HALVINGS = 6
"""Number of bisections after the step in which the line of sight enters the skin."""


@dataclass(frozen=True)
class RayTracedGel:
    """Gel from a flat base up to the skin; heights are as drawn, exaggeration included."""

    skin: Float32[Array, "skin_rows skin_cols"]
    mm_per_px: float
    base: float

    @property
    def low(self) -> Float32[Array, "3"]:
        """Corner of the bounding box with the smallest coordinates."""
        rows, cols = self.skin.shape
        return np.array([-(cols - 1) / 2 * self.mm_per_px, -(rows - 1) / 2 * self.mm_per_px, self.base], np.float32)

    @property
    def high(self) -> Float32[Array, "3"]:
        """Corner of the bounding box with the largest coordinates."""
        return np.array([-self.low[0], -self.low[1], max(float(self.skin.max()), 0.0)], np.float32)

    @property
    def corners(self) -> Float32[Array, "8 3"]:
        """All corners of the bounding box."""
        return np.array(list(product(*zip(self.low, self.high, strict=True))), np.float32)

    def at(self, col: PixelField, row: PixelField) -> PixelField:
        """Return the height of the skin by interpolation between its pixels."""
        return np.asarray(cv2.remap(self.skin, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@dataclass(frozen=True)
class RayHitGrid:
    """The point that each pixel of an image shows: a place on the block (columns and rows of the skin, height) or nothing."""

    col: PixelField
    row: PixelField
    z: PixelField
    on_skin: Bool[Array, "rows cols"]
    on_wall: Bool[Array, "rows cols"]


def trace_rays_to_relief(block: RayTracedGel, view: ReliefViewpoint, rows: int, cols: int) -> RayHitGrid:
    """Return the intersection of every line of sight with the block."""
    rays = view.rays(rows, cols)
    near, far = box_entry_and_exit(block, view, rays)
    origin = (view.eye - block.low).astype(np.float32) / np.float32(block.mm_per_px)
    slant = rays[:2] / np.float32(block.mm_per_px)

    def place(ahead: PixelField) -> tuple[PixelField, PixelField, PixelField]:
        return origin[0] + slant[0] * ahead, origin[1] + slant[1] * ahead, np.float32(view.eye[2]) + rays[2] * ahead

    def above(ahead: PixelField) -> PixelField:
        col, row, z = place(ahead)
        return np.asarray(z - block.at(col, row))

    hit = near < far
    wall = hit & (above(near) < -AT_THE_EDGE)
    ahead = first_crossing(above, near, far)
    skin = hit & ~wall & np.isfinite(ahead)
    return RayHitGrid(*place(np.where(skin, ahead, near)), skin, wall)


def box_entry_and_exit(
    block: RayTracedGel, view: ReliefViewpoint, rays: Float32[Array, "3 rows cols"]
) -> tuple[PixelField, PixelField]:
    """Return the distances at which each line enters and leaves the bounding box; a line that leaves before it enters misses the
    box.
    """
    eye = view.eye.astype(np.float32)
    with np.errstate(divide="ignore"):
        sides = [(side - eye)[:, None, None] / rays for side in (block.low, block.high)]
    return np.minimum(*sides).max(axis=0), np.maximum(*sides).min(axis=0)


def first_crossing(above: Callable[[PixelField], PixelField], near: PixelField, far: PixelField) -> PixelField:
    """Return the first distance between `near` and `far` at which `above` is negative; infinite where there is none."""
    step = (far - near) / RAY_STEPS
    after = near + step
    for _ in range(RAY_STEPS - 1):
        after += step * (above(after) > 0)  # a line that is already under the skin stays where it is
    under, before = above(after) < 0, after - step
    for _ in range(RAY_HALVINGS):
        middle = (before + after) / 2
        dived = above(middle) < 0
        before, after = np.where(dived, before, middle), np.where(dived, middle, after)
    return np.where(under, after, np.float32(np.inf))


PAINT_PX_PER_PX = 4
"""Pixels of texture per pixel of the height map, along each axis."""
LINE_MM = {1.0: 0.04, 5.0: 0.10}
"""Width of the grid lines, for each distance between them."""
LINE_STRENGTH = 0.25
RANGE_EDGE_WIDTH_PX = 11


def relief_texture(height: HeightMap, scale: ColourScale) -> UInt8[Array, "fine_rows fine_cols 3"]:
    """Return the texture of the skin as RGB."""
    fine = upsample_height_map(height)
    paint = np.ascontiguousarray(colourise_heights(fine, scale)[..., ::-1])
    lines = millimetre_grid_mask(fine) & fine.in_view
    paint[lines] = blend_contrasting_ink(paint[lines])
    paint[calibrated_range_edge_mask(fine)] = rgb_of_hex(EXTRAPOLATED)
    return paint


def upsample_height_map(height: HeightMap) -> HeightMap:
    """Return the same height map on a finer grid."""
    seen, measured = (
        upsample_mask(height.source >= kind) for kind in (HeightSource.EXTRAPOLATED, HeightSource.MEASURED)
    )
    z_mm = cv2.resize(
        np.where(height.in_view, height.z_mm, np.float32(0)), None, fx=PAINT_PX_PER_PX, fy=PAINT_PX_PER_PX
    )
    return HeightMap(
        z_mm, seen.astype(np.uint8) + (seen & measured), height.mm_per_px / PAINT_PX_PER_PX, height.noise_mm
    )


def upsample_mask(mask: Bool[Array, "rows cols"]) -> Bool[Array, "fine_rows fine_cols"]:
    """Return a mask on a finer grid, with its edge smoothed."""
    share = cv2.resize(
        mask.astype(np.float32), None, fx=PAINT_PX_PER_PX, fy=PAINT_PX_PER_PX, interpolation=cv2.INTER_LINEAR
    )
    return np.asarray(share > 0.5)


def millimetre_grid_mask(height: HeightMap) -> Bool[Array, "rows cols"]:
    """Return the pixels on the lines of the millimetre grid."""
    x, y = height.axes_mm
    paper = np.zeros(height.z_mm.shape, bool)
    for distance_mm, width_mm in LINE_MM.items():
        paper |= near_multiple_mask(y, distance_mm, width_mm)[:, None] | near_multiple_mask(x, distance_mm, width_mm)
    return paper


def near_multiple_mask(axis_mm: Float32[Array, " n"], distance_mm: float, width_mm: float) -> Bool[Array, " n"]:
    """Return which coordinates lie within a line's width of a multiple of the distance."""
    return np.asarray(np.abs(axis_mm - distance_mm * np.rint(axis_mm / distance_mm)) < width_mm / 2)


def blend_contrasting_ink(paint: UInt8[Array, "n 3"]) -> UInt8[Array, "n 3"]:
    """Return the texture under a line: darkened where it is bright, lightened where it is dark."""
    ink = np.where(paint.mean(axis=1, keepdims=True) > 110, 0, 255)
    return np.asarray(paint * (1 - LINE_STRENGTH) + ink * LINE_STRENGTH, np.uint8)


def calibrated_range_edge_mask(height: HeightMap) -> Bool[Array, "rows cols"]:
    """Return the extrapolated side of the edge of the calibrated range."""
    measured = (height.source == HeightSource.MEASURED).astype(np.uint8)
    touching = cv2.dilate(measured, np.ones((RANGE_EDGE_WIDTH_PX, RANGE_EDGE_WIDTH_PX), np.uint8)).astype(bool)
    return np.asarray(touching & (height.source == HeightSource.EXTRAPOLATED))


LIGHT = np.array([-0.70, 0.30, 0.65]) / np.linalg.norm([-0.70, 0.30, 0.65])
"""Direction towards the light: from the left and a little from behind, so that slopes are visible."""
AMBIENT = 0.5
"""Fraction of the light that is ambient."""
WALL = np.array([206, 208, 212], np.float32)
SIDE_WALL = np.float32(0.87)
"""Brightness of the right wall relative to the front wall."""
BASE_SHADE = 0.16
"""Brightness that a wall loses from the skin to the base."""


def render_relief_block(
    block: RayTracedGel, colours: UInt8[Array, "fine_rows fine_cols 3"], sight: RayHitGrid
) -> UInt8[Array, "rows cols 3"]:
    """Return the shaded image, white where no line of sight meets the block; `colours` cover the whole skin, at any resolution."""
    finer, half = np.float32(colours.shape[1] / block.skin.shape[1]), np.float32(0.5)
    # Pixels are areas: the edges of the two grids coincide, not the centres of their first pixels.
    col, row = (sight.col + half) * finer - half, (sight.row + half) * finer - half
    skin = cv2.remap(colours, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    light = cv2.remap(shading(block), sight.col, sight.row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    image = np.full(skin.shape, 255, np.uint8)
    image[sight.on_skin] = np.minimum(skin * light[..., None], 255)[sight.on_skin]
    image[sight.on_wall] = relief_wall_greys(block, sight)[sight.on_wall]
    return image


def shading(block: RayTracedGel) -> Float32[Array, "skin_rows skin_cols"]:
    """Return the brightness of the skin at each pixel, 1 where it is level."""
    y, x = np.gradient(block.skin, block.mm_per_px)
    facing = (LIGHT[2] - x * LIGHT[0] - y * LIGHT[1]) / np.sqrt(1 + x * x + y * y)
    return np.asarray(AMBIENT + (1 - AMBIENT) * np.maximum(facing, 0) / LIGHT[2], np.float32)


def relief_wall_greys(block: RayTracedGel, sight: RayHitGrid) -> Float32[Array, "rows cols 3"]:
    """Return the grey of the walls, darker on the side and towards the base."""
    brightness = np.where(sight.row < AT_THE_EDGE, np.float32(1), SIDE_WALL)
    depth = (block.high[2] - sight.z) / (block.high[2] - block.low[2])
    return np.asarray((brightness * (1 - BASE_SHADE * depth))[..., None] * WALL, np.float32)

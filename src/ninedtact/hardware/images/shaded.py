"""Bodies as a shaded image in parallel projection: nearest depth per pixel, light by the slope of that depth.

The image's axes are x right and y down; depth grows away from the eye.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from ninedtact.hardware.images.triangles import Triangles
from ninedtact.hardware.materials import Colour
from ninedtact.simulation.objects.raster import draw_lowest, portions

FINER = 2
"""Pixels are drawn so many times finer and averaged."""
MARGIN = 0.05
"""Of the image's size, left empty."""
LIGHT = np.array([-0.45, -0.6, -0.66])
"""Direction to the lamp: from above left, in front."""
DIM = 0.38
"""Light on faces that the lamp does not reach."""
BLACK_LIFT = 26.0
"""Added to all colours, so that black parts show their shape."""

SAME_MM = 1e-3
"""Faces nearer to each other than this are one; the body that was drawn first shows."""

Image = UInt8[Array, "rows cols 3"]
Depth = Float[Array, "rows cols"]


@dataclass(frozen=True)
class Eye:
    """From where it is looked: turned about z, then raised above the horizon."""

    azimuth_deg: float = -52.0
    elevation_deg: float = 32.0

    @property
    def axes(self) -> Float[Array, "3 3"]:
        """Rows: right, down, away, in the assembly's frame."""
        turn, raised = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        away = -np.array([np.cos(raised) * np.cos(turn), np.cos(raised) * np.sin(turn), np.sin(raised)])
        right = np.array([-np.sin(turn), np.cos(turn), 0.0])
        return np.stack([right, np.cross(away, right), away])


ABOVE = Eye()
BELOW = Eye(elevation_deg=-32.0)


@dataclass(frozen=True)
class Coloured:
    """One body to draw."""

    triangles: Triangles
    colour: Colour


def shaded(bodies: Sequence[Coloured], eye: Eye = ABOVE, size_px: tuple[int, int] = (900, 700)) -> Image:
    """BGR image on white, the bodies as large as they fit; size: columns, rows."""
    cols, rows = (side * FINER for side in size_px)
    seen = [body.triangles @ eye.axes.T for body in bodies]
    scale, shift = fitted(seen, cols, rows)
    nearest, image = np.full((rows, cols), np.inf), np.full((rows, cols, 3), 255.0)
    for body, places in zip(bodies, seen, strict=True):
        draw(image, nearest, Placed(places, scale, shift), body.colour)
    image = outlined(image, nearest * scale)
    return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA).astype(np.uint8)


def fitted(seen: Sequence[Triangles], cols: int, rows: int) -> tuple[float, Float[Array, "2"]]:
    """Pixels per mm, and the pixel of the origin."""
    places = np.concatenate([part.reshape(-1, 3)[:, :2] for part in seen])
    low, high = places.min(axis=0), places.max(axis=0)
    room = np.array([cols, rows]) * (1 - 2 * MARGIN)
    scale = float((room / np.maximum(high - low, 1e-9)).min())
    return scale, np.array([cols, rows]) / 2 - scale * (low + high) / 2


@dataclass(frozen=True)
class Placed:
    """One body's triangles as they lie in the image."""

    places: Triangles
    scale: float
    shift: Float[Array, "2"]

    def window(self, shape: tuple[int, int]) -> tuple[slice, slice]:
        """Rows and columns that it covers, and one more on every side."""
        places = self.places[..., :2].reshape(-1, 2) * self.scale + self.shift
        (left, top), (right, bottom) = np.floor(places.min(axis=0)) - 1, np.ceil(places.max(axis=0)) + 2
        return (
            slice(max(int(top), 0), min(int(bottom), shape[0])),
            slice(max(int(left), 0), min(int(right), shape[1])),
        )

    def depth(self, window: tuple[slice, slice]) -> Depth:
        """Distance of the nearest face per pixel of the window, infinite beside the body."""
        rows, cols = window
        placed = self.places.copy()
        placed[..., :2] = placed[..., :2] * self.scale + self.shift - (cols.start, rows.start)
        table = np.full((rows.stop - rows.start, cols.stop - cols.start), np.inf)
        for portion in portions(placed):
            draw_lowest(table, portion)
        return table


def draw(image: Float[Array, "rows cols 3"], nearest: Depth, body: Placed, colour: Colour) -> None:
    """Put a body into the image where nothing is nearer."""
    window = body.window((nearest.shape[0], nearest.shape[1]))
    depth = body.depth(window)
    front = depth < nearest[window] - SAME_MM
    image[window][front] = lit([least_step(depth, axis)[front] * body.scale for axis in (0, 1)], colour)
    nearest[window] = np.minimum(nearest[window], depth)


def lit(slopes: Sequence[Float[Array, " pixels"]], colour: Colour) -> Float[Array, "pixels 3"]:
    """The body's colour under the lamp, by its slopes down and to the right."""
    (down, right), lamp = slopes, LIGHT / np.linalg.norm(LIGHT)
    towards = (right * lamp[0] + down * lamp[1] - lamp[2]) / np.sqrt(right**2 + down**2 + 1)
    light = DIM + (1 - DIM) * np.clip(towards, 0, 1)
    return np.outer(light, np.clip(np.array(colour[::-1], float) + BLACK_LIFT, 0, 255))


def least_step(depth: Depth, axis: int) -> Depth:
    """Slope towards the neighbour that differs less: at an edge, that of the pixel's own face; level where it has none."""
    with np.errstate(invalid="ignore"):
        step = np.diff(depth, axis=axis)
    beside = [(1, 1) if side == axis else (0, 0) for side in (0, 1)]
    step = np.pad(np.where(np.isfinite(step), step, np.inf), beside, constant_values=np.inf)
    before, after = (step[:-1], step[1:]) if axis == 0 else (step[:, :-1], step[:, 1:])
    nearer = np.where(np.abs(before) <= np.abs(after), before, after)
    return np.where(np.isfinite(nearer), nearer, 0.0)


def outlined(image: Float[Array, "rows cols 3"], depth_px: Depth) -> Float[Array, "rows cols 3"]:
    """Dark lines where depth bends or jumps."""
    depth = np.where(np.isfinite(depth_px), depth_px, depth_px[np.isfinite(depth_px)].max() + 50.0)
    bend = np.abs(cv2.Laplacian(depth.astype(np.float32), cv2.CV_32F))
    strength = cv2.GaussianBlur(np.clip((bend - 0.35) / 1.2, 0, 1), (0, 0), 0.8)
    return np.asarray(image * (1 - 0.62 * strength[..., None]))

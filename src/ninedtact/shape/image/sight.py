"""What each pixel of a perspective image looks at, by following its line of sight to the skin."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray as Array

from ninedtact.shape.image.viewpoint import Viewpoint

Field = Float32[Array, "rows cols"]

AT_THE_EDGE = 1e-3
"""How far, in pixels or mm, rounding may push a point off its wall."""
STEPS = 28
"""Along each line of sight through the box around the block; what is thinner than a step may be missed."""
HALVINGS = 6
"""After the step in which the line dives under the skin."""


@dataclass(frozen=True)
class Block:
    """Gel from a flat base up to the skin; heights are as they are to be drawn, exaggeration included."""

    skin: Float32[Array, "skin_rows skin_cols"]
    mm_per_px: float
    base: float

    @property
    def low(self) -> Float32[Array, "3"]:
        """Corner of the surrounding box with the smallest coordinates."""
        rows, cols = self.skin.shape
        return np.array([-(cols - 1) / 2 * self.mm_per_px, -(rows - 1) / 2 * self.mm_per_px, self.base], np.float32)

    @property
    def high(self) -> Float32[Array, "3"]:
        """Corner of the surrounding box with the largest coordinates."""
        return np.array([-self.low[0], -self.low[1], max(float(self.skin.max()), 0.0)], np.float32)

    @property
    def corners(self) -> Float32[Array, "8 3"]:
        """All corners of the surrounding box."""
        return np.array(list(product(*zip(self.low, self.high, strict=True))), np.float32)

    def at(self, col: Field, row: Field) -> Field:
        """Height of the skin between its pixels."""
        return np.asarray(cv2.remap(self.skin, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@dataclass(frozen=True)
class Sight:
    """What each pixel of an image looks at: a place on the block (columns and rows of the skin, height) or nothing."""

    col: Field
    row: Field
    z: Field
    on_skin: Bool[Array, "rows cols"]
    on_wall: Bool[Array, "rows cols"]


def sight_of(block: Block, view: Viewpoint, rows: int, cols: int) -> Sight:
    """Follow every line of sight to the block."""
    rays = view.rays(rows, cols)
    near, far = through_box(block, view, rays)
    origin = (view.eye - block.low).astype(np.float32) / np.float32(block.mm_per_px)
    slant = rays[:2] / np.float32(block.mm_per_px)

    def place(ahead: Field) -> tuple[Field, Field, Field]:
        return origin[0] + slant[0] * ahead, origin[1] + slant[1] * ahead, np.float32(view.eye[2]) + rays[2] * ahead

    def above(ahead: Field) -> Field:
        col, row, z = place(ahead)
        return np.asarray(z - block.at(col, row))

    hit = near < far
    wall = hit & (above(near) < -AT_THE_EDGE)
    ahead = first_crossing(above, near, far)
    skin = hit & ~wall & np.isfinite(ahead)
    return Sight(*place(np.where(skin, ahead, near)), skin, wall)


def through_box(block: Block, view: Viewpoint, rays: Float32[Array, "3 rows cols"]) -> tuple[Field, Field]:
    """Where each line enters and leaves the box around the block; it misses it where it leaves before it enters."""
    eye = view.eye.astype(np.float32)
    with np.errstate(divide="ignore"):
        sides = [(side - eye)[:, None, None] / rays for side in (block.low, block.high)]
    return np.minimum(*sides).max(axis=0), np.maximum(*sides).min(axis=0)


def first_crossing(above: Callable[[Field], Field], near: Field, far: Field) -> Field:
    """The first place between `near` and `far` at which `above` is negative; infinite where there is none."""
    step = (far - near) / STEPS
    after = near + step
    for _ in range(STEPS - 1):
        after += step * (above(after) > 0)  # a line that has dived under stays where it is
    under, before = above(after) < 0, after - step
    for _ in range(HALVINGS):
        middle = (before + after) / 2
        dived = above(middle) < 0
        before, after = np.where(dived, before, middle), np.where(dived, middle, after)
    return np.where(under, after, np.float32(np.inf))

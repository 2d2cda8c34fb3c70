"""How far one faintly structured image is shifted and turned against another, with an error that can be believed.

Least squares after Lucas & Kanade (1981) with a turn as third unknown, over the whole image; errors by leaving out
one tile at a time (docs/references.md). A motion is (shift x, shift y, turn), the turn as the way it moves the middle
of the right border, all in pixels; turns are positive clockwise on the screen.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

Field = Float32[Array, "down across"]
Motion = Float[Array, "3"]

MARGIN_PX = 12
"""The frame of the image shows housing and glare instead of skin."""
TILES = (6, 8)
GOOD = 0.5
"""Likeness above which the motion found from rest needs no second first guess."""
ROUNDS = 10
SETTLED_PX = 0.003
ROBUST = 2.0
"""Differences of so many standard deviations count half."""
OUTLIER = 6.0


@dataclass(frozen=True)
class Registration:
    """A motion, its standard errors, and how alike the images are once it is undone."""

    motion: Motion
    error: Motion
    likeness: float


def registered(earlier: Field, later: Field) -> Registration:
    """The motion from the earlier image to the later."""
    found = fitted(earlier, later, np.zeros(3))
    if found.likeness > GOOD:
        return found
    return max(found, fitted(earlier, later, correlated(earlier, later)), key=lambda fit: fit.likeness)


def fitted(earlier: Field, later: Field, motion: Motion) -> Registration:
    """Least squares from a first guess, repeated until it settles."""
    for _ in range(ROUNDS):
        normal, right = equations(earlier, undone(later, motion))
        step = np.linalg.pinv(normal.sum(axis=0)) @ right.sum(axis=0)
        motion = motion + step
        if np.abs(step).max() < SETTLED_PX:
            break
    return Registration(motion, left_out_error(normal, right), likeness(earlier, undone(later, motion)))


def equations(earlier: Field, later: Field) -> tuple[Float[Array, "tiles 3 3"], Float[Array, "tiles 3"]]:
    """Normal equations of every tile: gradient times motion is what the later image lacks."""
    down, right = np.gradient((earlier + later) / 2)
    y, x = (np.indices(earlier.shape) - (np.array(earlier.shape)[:, None, None] - 1) / 2) / (earlier.shape[1] / 2)
    columns = np.stack([right, down, x * down - y * right], axis=-1)
    lacking = earlier - later
    spread = np.median(np.abs(lacking)) / 0.6745
    weight = 1 / (1 + (lacking / (ROBUST * spread + 1e-9)) ** 2)
    weighted = tiles(weight[..., None] * columns)
    normal = [np.einsum("rci,rcj->ij", *pair) for pair in zip(weighted, tiles(columns), strict=True)]
    side = [np.einsum("rci,rc->i", *pair) for pair in zip(weighted, tiles(lacking), strict=True)]
    return np.array(normal), np.array(side)


def left_out_error(normal: Float[Array, "tiles 3 3"], right: Float[Array, "tiles 3"]) -> Motion:
    """Standard error by the jackknife over tiles, which also sees errors that neighbouring pixels share."""
    without = (np.linalg.pinv(normal.sum(axis=0) - normal) @ (right.sum(axis=0) - right)[..., None])[..., 0]
    return np.asarray(np.sqrt((len(normal) - 1) * without.var(axis=0)))


def correlated(earlier: Field, later: Field) -> Motion:
    """A first guess of a large shift, by phase correlation."""
    parts = [inside(field) for field in (earlier, later)]
    first, second = (np.clip(part / (np.median(np.abs(part)) + 1e-9), -OUTLIER, OUTLIER) for part in parts)
    (x, y), _ = cv2.phaseCorrelate(first, second, cv2.createHanningWindow(first.shape[::-1], cv2.CV_32F))
    return np.array([x, y, 0.0])


def likeness(earlier: Field, later: Field) -> float:
    """Median correlation of tiles; a press or a new mark spoils only the tiles that it lies in."""
    pairs = zip(tiles(earlier), tiles(later), strict=True)
    return float(np.median([correlation(first, second) for first, second in pairs]))


def correlation(first: Field, second: Field) -> float:
    """Pearson's, zero where one side is flat."""
    first, second = first - first.mean(), second - second.mean()
    scale = np.sqrt((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / scale) if scale > 0 else 0.0


def undone(image: Array, motion: Motion, border: int = cv2.BORDER_REPLICATE) -> Array:
    """An image of any type with a motion undone; OpenCV's name for what lies beyond its border."""
    rows, cols = image.shape[:2]
    middle, angle = np.array([(cols - 1) / 2, (rows - 1) / 2]), motion[2] / (cols / 2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = np.column_stack([turn, middle + motion[:2] - turn @ middle])
    way = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, matrix, (cols, rows), flags=way, borderMode=border))


def inside(image: Array) -> Array:
    """Without the frame."""
    return image[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]


def tiles(image: Array) -> list[Array]:
    """The inside in equal pieces, more along the longer side."""
    down, across = TILES if image.shape[0] <= image.shape[1] else TILES[::-1]
    return [tile for band in np.array_split(inside(image), down) for tile in np.array_split(band, across, axis=1)]

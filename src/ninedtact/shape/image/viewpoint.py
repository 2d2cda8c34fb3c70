"""Where the eye of a perspective image is, and along which line each of its pixels looks."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

TOWARDS_EYE = np.array([0.36, -0.80, 0.74]) / np.linalg.norm([0.36, -0.80, 0.74])
"""From the skin to the eye: outside, in front of the edge of smallest y, a little to the right."""
DISTANCE = 2.6
"""Of the eye, in diagonals of what it sees; nearer bends the image as a wide-angle lens does."""


@dataclass(frozen=True)
class Viewpoint:
    """A pinhole eye whose image has z upwards."""

    eye: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    """Unit vectors to the right, downwards and ahead, as rows."""
    focal_px: float
    centre_px: Float[Array, "2"]

    def project(self, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
        """Pixels (x, y) at which points of space appear."""
        right, down, ahead = self.axes @ (points - self.eye).T
        return np.asarray(np.column_stack([right / ahead, down / ahead]) * self.focal_px + self.centre_px)

    def rays(self, rows: int, cols: int) -> Float32[Array, "3 rows cols"]:
        """Direction in which every pixel looks, at one unit ahead."""
        x, y = np.meshgrid(np.arange(cols) - self.centre_px[0], np.arange(rows) - self.centre_px[1])
        here = np.stack([x / self.focal_px, y / self.focal_px, np.ones_like(x)])
        return np.asarray(np.einsum("ij,irc->jrc", self.axes, here), np.float32)


def viewpoint_of(
    corners: Float[Array, "n 3"], top_left_px: tuple[float, float], bottom_right_px: tuple[float, float]
) -> Viewpoint:
    """The eye that sees all `corners` as large as fits between two pixels (x, y)."""
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    eye = middle + TOWARDS_EYE * DISTANCE * np.linalg.norm(np.ptp(corners, axis=0))
    right = np.cross([0, 0, 1], TOWARDS_EYE)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(right, TOWARDS_EYE), -TOWARDS_EYE])
    seen = Viewpoint(eye, axes, 1.0, np.zeros(2)).project(corners)
    room = np.subtract(bottom_right_px, top_left_px)
    focal_px = float((room / np.ptp(seen, axis=0)).min())
    centre_px = np.add(top_left_px, room / 2) - focal_px * (seen.min(axis=0) + seen.max(axis=0)) / 2
    return Viewpoint(eye, axes, focal_px, centre_px)

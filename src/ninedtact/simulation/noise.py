"""Noise of a camera, drawn once and dealt out: fresh noise for every frame would cost more than the frame."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

ROOM_PX = 61
"""By how much larger than an image the stored noise is, each way; every frame gets its own cut."""


@dataclass(frozen=True)
class Noise:
    """Gaussian noise in grey levels, alike in all colours, different in every image of one sensor."""

    grey_levels: float = 0.7
    """Standard deviation of one pixel in one image (real sensors, docs/figures.md)."""
    shape: tuple[int, int] = (480, 640)
    seed: int = 0

    @cached_property
    def stored(self) -> Float32[Array, "rows cols"]:
        """The noise that images get cuts of, as three equal channels."""
        rows, cols = self.shape
        drawn = np.random.default_rng(self.seed).normal(0, self.grey_levels, (rows + ROOM_PX, cols + ROOM_PX))
        return drawn.astype(np.float32)

    def upon(self, image: Float32[Array, "rows cols 3"], number: int) -> UInt8[Array, "rows cols 3"]:
        """The image with the noise of this number, in 8 bits."""
        rows, cols = self.shape
        down, right = (number * step % ROOM_PX for step in (17, 31))
        cut = self.stored[down : down + rows, right : right + cols]
        return np.asarray(cv2.add(image, cv2.merge([cut, cut, cut]), dtype=cv2.CV_8U))

"""Whether an image shows the skin untouched: places of 8 x 8 pixels, held against the reference.

Noise averages out in a place. What the whole image gained or lost (a lamp that warms up) is taken off first.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

PLACE_PX = 8


class SkinSeen:
    """The untouched skin, and how far an image is from it."""

    def __init__(self, untouched: Sequence[UInt8[Array, "rows cols 3"]]) -> None:
        self._reference = np.mean([places(image) for image in untouched], axis=0)
        self._median = float(np.median(self._reference))

    def change(self, image: UInt8[Array, "rows cols 3"]) -> float:
        """Grey levels by which the most changed place differs."""
        seen = places(image)
        if seen.shape != self._reference.shape:
            return float("inf")
        gain = self._median / max(float(np.median(seen)), 1.0)
        return float(np.abs(gain * seen - self._reference).max())


def places(image: UInt8[Array, "rows cols 3"]) -> Float32[Array, "_ _"]:
    """Mean grey level of each place."""
    rows, cols = (max(side // PLACE_PX, 1) for side in image.shape[:2])
    small = cv2.resize(image.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)

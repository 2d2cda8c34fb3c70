"""How far the imprint of an object has moved along the skin, by correlation of heights between images.

Skin that friction drags down beside a flat object changes the border of the contact, and its centre, but not where the object's
edges are. Heights are filtered to widths of edges, so that what friction drags, which is as wide as the gel is thick, hardly
counts.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap

_NARROW_MM, _WIDE_MM = 0.1, 0.6
"""Standard deviations of two Gaussians, whose difference is correlated."""
_NEXT_KEY_MM = 0.5
"""Shift from which the next image is compared with this one."""


@dataclass
class ImprintShift:
    """Follows the imprint along x and y through a stream, against key images."""

    _key: Float32[Array, "rows cols"] | None = field(default=None, init=False, repr=False)
    _shift_mm: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    """Shift of the last image since the key image."""

    def forget(self) -> None:
        """Compare with no earlier image, because nothing touched in between."""
        self._key = None

    def update(self, height: HeightMap) -> Float[Array, "2"]:
        """Return the shift in mm since the image before; zero in the first one."""
        edges, pixel_mm = _edges(height)
        if self._key is None or self._key.shape != edges.shape:
            self._key, self._shift_mm = edges, np.zeros(2)
            return np.zeros(2)
        shift_px, _ = cv2.phaseCorrelate(self._key, edges, _window(*edges.shape))
        before_mm, shift_mm = self._shift_mm, pixel_mm * np.array(shift_px)
        is_far = np.linalg.norm(shift_mm) > _NEXT_KEY_MM
        self._key, self._shift_mm = (edges, np.zeros(2)) if is_far else (self._key, shift_mm)
        return shift_mm - before_mm


@lru_cache(maxsize=4)
def _window(rows: int, cols: int) -> Float32[Array, "rows cols"]:
    """Return the weights that make an image fade towards its border."""
    return np.asarray(cv2.createHanningWindow((cols, rows), cv2.CV_32F))


def _edges(height: HeightMap) -> tuple[Float32[Array, "rows cols"], float]:
    """Return the heights without what is narrower or wider than edges, at half of the resolution; and mm per pixel of it."""
    coarse = cv2.resize(height.z_mm, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    pixel_mm = 2 * height.mm_per_px
    narrow, wide = (cv2.GaussianBlur(coarse, (0, 0), width_mm / pixel_mm) for width_mm in (_NARROW_MM, _WIDE_MM))
    return np.asarray(narrow - wide, np.float32), pixel_mm

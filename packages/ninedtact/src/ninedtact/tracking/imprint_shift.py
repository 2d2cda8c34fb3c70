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
    """Follows the imprint along x and y through images that follow each other, against key images."""

    _last: HeightMap | None = field(default=None, init=False, repr=False)
    _key: Float32[Array, "rows cols"] = field(init=False, repr=False)
    _shift_mm: Float[Array, "2"] = field(init=False, repr=False)
    """Shift of the last image since the key image."""

    def update(self, before: HeightMap, height: HeightMap) -> Float[Array, "2"]:
        """Return the shift in mm of an image since the one before, which is the next key image where it was not followed."""
        if before is not self._last:
            self._key, self._shift_mm = _edges(before), np.zeros(2)
        self._last, edges = height, _edges(height)
        if self._key.shape != edges.shape:
            self._key, self._shift_mm = edges, np.zeros(2)
            return np.zeros(2)
        shift_px, _ = cv2.phaseCorrelate(self._key, edges, _window(*edges.shape))
        before_mm, shift_mm = self._shift_mm, 2 * height.mm_per_px * np.array(shift_px)
        is_far = np.linalg.norm(shift_mm) > _NEXT_KEY_MM
        self._key, self._shift_mm = (edges, np.zeros(2)) if is_far else (self._key, shift_mm)
        return shift_mm - before_mm


@lru_cache(maxsize=4)
def _window(rows: int, cols: int) -> Float32[Array, "rows cols"]:
    """Return the weights that make an image fade towards its border."""
    return np.asarray(cv2.createHanningWindow((cols, rows), cv2.CV_32F))


def _edges(height: HeightMap) -> Float32[Array, "rows cols"]:
    """Return the heights without what is narrower or wider than edges, at half of the resolution."""
    coarse = cv2.resize(height.z_mm, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    sigmas_px = (width_mm / (2 * height.mm_per_px) for width_mm in (_NARROW_MM, _WIDE_MM))
    narrow, wide = (cv2.GaussianBlur(coarse, (0, 0), sigma_px) for sigma_px in sigmas_px)
    return np.asarray(narrow - wide, np.float32)

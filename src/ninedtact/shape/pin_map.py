"""The paper's own projection: five central anchors, an equidistant grid, a cubic radial-basis map through all pins.

docs/references.md: 9DTact, section on camera calibration. It passes exactly through every pin, so it carries every
pin's error into the map; the lens model is the default, this one is for reproducing the paper.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RBFInterpolator

from ninedtact.shape.lens import Points


@dataclass(frozen=True)
class PinMap:
    """Cubic radial-basis interpolation from the skin to the image."""

    points_mm: Points
    points_px: Points

    def to_px(self, points_mm: Points) -> Points:
        """Pixels (x, y) at which skin points appear."""
        return np.asarray(self.interpolator(np.asarray(points_mm, float)))

    @cached_property
    def interpolator(self) -> RBFInterpolator:
        """The map, solved once."""
        return RBFInterpolator(self.points_mm, self.points_px, kernel="cubic")

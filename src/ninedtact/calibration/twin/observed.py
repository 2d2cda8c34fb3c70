"""A ball press as numbers to fit: brightness relative to untouched skin at points around the contact."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.brightness import smoothed
from ninedtact.quantities import Rectified
from ninedtact.shape.rectification import skin_grid_mm

REACH_MM = 8.0
"""Radius around the contact within which the image is fitted."""
SMOOTHING_PX = 1.5
EVERY_PX = 2
"""Of rows and columns; smoothing has made neighbours alike."""
DIMMEST = 1.0


@dataclass(frozen=True)
class ObservedPress:
    """Two rectified images, before and after, around the contact."""

    before: Rectified
    after: Rectified
    middle_mm: tuple[float, float]
    """Roughly of the contact."""

    @cached_property
    def ratio(self) -> Float32[Array, "rows cols"]:
        """Brightness relative to untouched skin, calmed."""
        return smoothed(self.after.grey / np.maximum(self.before.grey, DIMMEST), SMOOTHING_PX)

    @cached_property
    def place_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of every pixel."""
        return skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)

    @cached_property
    def chosen(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted."""
        x, y = self.place_mm
        near = np.hypot(x - self.middle_mm[0], y - self.middle_mm[1]) < REACH_MM
        every = np.zeros_like(near)
        every[::EVERY_PX, ::EVERY_PX] = True
        return np.asarray(near & every)

    @cached_property
    def points_mm(self) -> tuple[Float32[Array, "1 n"], Float32[Array, "1 n"]]:
        """x and y of the chosen pixels."""
        x, y = (axis[self.chosen][None] for axis in self.place_mm)
        return x, y

    @cached_property
    def seen(self) -> Float[Array, " n"]:
        """Relative brightness of the chosen pixels."""
        return self.ratio[self.chosen].astype(float)

    @property
    def blur_mm(self) -> float:
        """Standard deviation of the calming, which is part of the point-spread that is fitted."""
        return SMOOTHING_PX * self.before.mm_per_px

    @property
    def mean_grey(self) -> float:
        """Of the untouched image: what turns relative brightness into grey levels."""
        return float(self.before.grey.mean())

    def image(self, values: Float[Array, " n"]) -> Float[Array, "few_rows few_cols"]:
        """Values of the chosen pixels as a coarse image, not-a-number elsewhere."""
        whole = np.full(self.chosen.shape, np.nan)
        whole[self.chosen] = values
        return whole[::EVERY_PX, ::EVERY_PX]

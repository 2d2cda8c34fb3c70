"""The square grid of heights on which the underside of a generated object is computed, and the sampler of its dimensions.

A height field holds mm above the plane that the object touches, and infinity where there is no object. The union of two solids
is the minimum of their fields, their intersection the maximum.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from zlib import crc32

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

Heightfield = Float[Array, "rows cols"]

GOLDEN = (5**0.5 - 1) / 2
ROOTS = (GOLDEN, *(root % 1 for root in np.sqrt([2, 3, 7, 11, 13, 17, 19, 23]).tolist()))
"""Steps of the dimensions from one object of a family to the next; multiples of these fill an interval evenly."""
ROUNDING_MM = 0.07
"""Standard deviation of the smoothing that gives every edge a radius of at least 0.1 mm."""


@dataclass(frozen=True)
class HeightGrid:
    """A square grid centred on the object's origin."""

    side_mm: float = 22.0
    pitch_mm: float = 0.1

    @cached_property
    def x(self) -> Heightfield:
        """x of every grid point in mm; it grows along the columns."""
        samples = round(self.side_mm / self.pitch_mm) + 1
        axis = (np.arange(samples) - (samples - 1) / 2) * self.pitch_mm
        return np.broadcast_to(axis, (samples, samples))

    @cached_property
    def y(self) -> Heightfield:
        """y of every grid point in mm; it grows along the rows."""
        return self.x.T

    @cached_property
    def r(self) -> Heightfield:
        """Distance of every grid point from the origin in mm."""
        return np.hypot(self.x, self.y)

    @cached_property
    def angle(self) -> Heightfield:
        """Polar angle of every grid point, −π to π rad."""
        return np.arctan2(self.y, self.x)

    def rotated_axes(self, angle_rad: float) -> tuple[Heightfield, Heightfield]:
        """Return x and y of every grid point in a frame rotated by an angle."""
        cos, sin = np.cos(angle_rad), np.sin(angle_rad)
        return cos * self.x + sin * self.y, cos * self.y - sin * self.x

    def smooth(self, heights: Heightfield, sigma_mm: float = ROUNDING_MM) -> Heightfield:
        """Return a height field with its edges rounded and its footprint unchanged."""
        from scipy.ndimage import gaussian_filter

        seen, sigma = np.isfinite(heights), sigma_mm / self.pitch_mm
        weight = np.maximum(gaussian_filter(seen.astype(float), sigma), 1e-6)
        return np.where(seen, gaussian_filter(np.where(seen, heights, 0.0), sigma) / weight, np.inf)


class DimensionSampler:
    """Samples the dimensions of one object, one per call, from its seed, family and number alone.

    Successive objects of a family differ most in the dimension that is sampled first.
    """

    def __init__(self, seed: int, family: str, number: int) -> None:
        self.number = number
        self.start = np.random.default_rng([seed, crc32(family.encode())])
        self.random = np.random.default_rng([seed, crc32(family.encode()), number])
        """Generator for all that is not a dimension: noise, scattered positions, letters."""
        self.count = 0

    def fraction(self) -> float:
        """Sample the next number from 0 to 1."""
        step = ROOTS[self.count % len(ROOTS)]
        self.count += 1
        return float((self.start.random() + self.number * step) % 1)

    def between(self, low: float, high: float) -> float:
        """Sample a dimension between two limits."""
        return low + (high - low) * self.fraction()

    def integer(self, low: int, high: int) -> int:
        """Sample an integer between two limits, both included."""
        return low + int(self.fraction() * (high - low + 1))

    def scatter(self, count: int, radius_mm: float) -> Float[Array, "count 2"]:
        """Sample positions in a disc that keep apart: each is the most isolated of eight candidates (Mitchell's algorithm)."""
        places = [np.zeros(2)]
        for _ in range(count - 1):
            angle, far = self.random.random(8) * 2 * np.pi, radius_mm * np.sqrt(self.random.random(8))
            tries = np.stack([far * np.cos(angle), far * np.sin(angle)], axis=1)
            lonely = np.linalg.norm(tries[:, None] - np.array(places), axis=2).min(axis=1)
            places.append(tries[lonely.argmax()])
        return np.array(places)


HeightfieldFunction = Callable[[DimensionSampler, HeightGrid], Heightfield]
"""A family of objects: the heights of one object, from the dimensions that it samples."""

"""What a shape is drawn on, and how its dimensions are drawn.

Heights are mm over the plane that the object touches, infinite where there is nothing. The union of two solids is the
lower of both, a common part the higher one.
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
"""Steps of the dimensions from one object of a family to the next: multiples of these fill an interval evenly."""
ROUNDING_MM = 0.07
"""Standard deviation of the smoothing that takes the sharpness off every edge; a radius of 0.1 mm and more."""


@dataclass(frozen=True)
class HeightGrid:
    """A square grid, centred on the object's origin."""

    side_mm: float = 22.0
    pitch_mm: float = 0.1

    @cached_property
    def x(self) -> Heightfield:
        """Along the columns, mm."""
        samples = round(self.side_mm / self.pitch_mm) + 1
        axis = (np.arange(samples) - (samples - 1) / 2) * self.pitch_mm
        return np.broadcast_to(axis, (samples, samples))

    @cached_property
    def y(self) -> Heightfield:
        """Along the rows, mm."""
        return self.x.T

    @cached_property
    def r(self) -> Heightfield:
        """Distance from the middle, mm."""
        return np.hypot(self.x, self.y)

    @cached_property
    def angle(self) -> Heightfield:
        """Around the middle, rad from −π to π."""
        return np.arctan2(self.y, self.x)

    def turned(self, angle_rad: float) -> tuple[Heightfield, Heightfield]:
        """x and y of a frame that is turned by this angle."""
        cos, sin = np.cos(angle_rad), np.sin(angle_rad)
        return cos * self.x + sin * self.y, cos * self.y - sin * self.x

    def smooth(self, heights: Heightfield, sigma_mm: float = ROUNDING_MM) -> Heightfield:
        """Without sharp edges; the footprint stays."""
        from scipy.ndimage import gaussian_filter

        seen, sigma = np.isfinite(heights), sigma_mm / self.pitch_mm
        weight = np.maximum(gaussian_filter(seen.astype(float), sigma), 1e-6)
        return np.where(seen, gaussian_filter(np.where(seen, heights, 0.0), sigma) / weight, np.inf)


class DimensionSampler:
    """The dimensions of one object: each call draws the next, from the object's seed, family and number alone.

    Objects of a family that follow each other differ most in what is drawn first.
    """

    def __init__(self, seed: int, family: str, number: int) -> None:
        self.number = number
        self.start = np.random.default_rng([seed, crc32(family.encode())])
        self.random = np.random.default_rng([seed, crc32(family.encode()), number])
        """For what has no dimensions: noise, scatter, letters."""
        self.drawn = 0

    def part(self) -> float:
        """The next number from 0 to 1."""
        step = ROOTS[self.drawn % len(ROOTS)]
        self.drawn += 1
        return float((self.start.random() + self.number * step) % 1)

    def between(self, low: float, high: float) -> float:
        """A dimension."""
        return low + (high - low) * self.part()

    def integer(self, low: int, high: int) -> int:
        """A count, both ends included."""
        return low + int(self.part() * (high - low + 1))

    def scatter(self, count: int, radius_mm: float) -> Float[Array, "count 2"]:
        """Places in a disc that keep away from each other: each is the loneliest of eight tries."""
        places = [np.zeros(2)]
        for _ in range(count - 1):
            angle, far = self.random.random(8) * 2 * np.pi, radius_mm * np.sqrt(self.random.random(8))
            tries = np.stack([far * np.cos(angle), far * np.sin(angle)], axis=1)
            lonely = np.linalg.norm(tries[:, None] - np.array(places), axis=2).min(axis=1)
            places.append(tries[lonely.argmax()])
        return np.array(places)


HeightfieldFunction = Callable[[DimensionSampler, HeightGrid], Heightfield]
"""A family of objects: the heights of one object, from the dimensions that it samples."""

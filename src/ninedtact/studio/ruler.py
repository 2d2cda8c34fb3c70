"""The block of gel under the skin as thin lines, with millimetres along its edges."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.shape.calibrated import CalibratedShape

Point = tuple[float, float, float]
LINES_EVERY_MM = 5.0
DEPTHS_EVERY_MM = 1.0
AWAY_MM = 0.9
"""Of the numbers from their edge."""


@dataclass(frozen=True)
class Mark:
    """A text at a place, mm in the sensor frame."""

    text: str
    at_mm: Point


@dataclass(frozen=True)
class Block:
    """Gel of this size, the untouched skin on top at z = 0."""

    width_mm: float
    """Along x."""
    length_mm: float
    """Along y."""
    gel_mm: float

    @property
    def edges_mm(self) -> Float32[Array, "n 2 3"]:
        """The twelve edges, as pairs of ends."""
        x, y, z = self.width_mm / 2, self.length_mm / 2, self.gel_mm
        along_x = [((-x, v, w), (x, v, w)) for v in (-y, y) for w in (-z, 0)]
        along_y = [((u, -y, w), (u, y, w)) for u in (-x, x) for w in (-z, 0)]
        along_z = [((u, v, -z), (u, v, 0)) for u in (-x, x) for v in (-y, y)]
        return np.array([*along_x, *along_y, *along_z], np.float32)

    @property
    def floor_mm(self) -> Float32[Array, "n 2 3"]:
        """Lines every 5 mm on the window under the gel."""
        x, y, z = self.width_mm / 2, self.length_mm / 2, self.gel_mm
        along_y = [((u, -y, -z), (u, y, -z)) for u in round_places(x, LINES_EVERY_MM)]
        along_x = [((-x, v, -z), (x, v, -z)) for v in round_places(y, LINES_EVERY_MM)]
        return np.array([*along_y, *along_x], np.float32).reshape(-1, 2, 3)

    def marks(self) -> Iterator[Mark]:
        """Numbers along the front (x), the right (y) and the corner between them (z)."""
        x, y, z = self.width_mm / 2, self.length_mm / 2, self.gel_mm
        for place in round_places(x, LINES_EVERY_MM):
            yield Mark(signed(place), (place, -y - AWAY_MM, -z))
        for place in round_places(y, LINES_EVERY_MM):
            yield Mark(signed(place), (x + AWAY_MM, place, -z))
        for depth in np.arange(0, z, DEPTHS_EVERY_MM):
            yield Mark(signed(-float(depth)), (-x - AWAY_MM, -y, -float(depth)))
        yield Mark("x (mm)", (0.0, -y - 3 * AWAY_MM, -z))
        yield Mark("y (mm)", (x + 3 * AWAY_MM, 0.0, -z))
        yield Mark("z (mm)", (-x - 3 * AWAY_MM, -y, -z / 2))


def block_under(shape: CalibratedShape, gel: Gel) -> Block:
    """The gel under all the skin that a sensor sees."""
    rows, cols, _ = shape.rectify.source_px.shape
    return Block(cols * shape.rectify.mm_per_px, rows * shape.rectify.mm_per_px, gel.thickness_mm)


def round_places(half_mm: float, every_mm: float) -> list[float]:
    """Multiples of `every_mm` between −`half_mm` and `half_mm`."""
    count = int(half_mm / every_mm)
    return [float(number * every_mm) for number in range(-count, count + 1)]


def signed(number: float) -> str:
    """A number of tenths, with a true minus sign, which zero has not."""
    return f"{round(number, 1) + 0.0:g}".replace("-", "\N{MINUS SIGN}")

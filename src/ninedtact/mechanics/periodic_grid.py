"""A rectangle of skin on a square grid, treated as periodic."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.errors import InputError

_MIN_POINTS_PER_SIDE = 8


class InvalidGrid(InputError):
    """A grid that cannot carry a contact."""


@dataclass(frozen=True)
class PeriodicGrid:
    """A grid centred on the sensor's origin."""

    rows: int
    cols: int
    pitch_mm: float

    def __post_init__(self) -> None:
        if min(self.rows, self.cols) < _MIN_POINTS_PER_SIDE or not self.pitch_mm > 0:
            raise InvalidGrid(
                f"expected a grid of at least {_MIN_POINTS_PER_SIDE} x {_MIN_POINTS_PER_SIDE} points with a pitch above zero, got "
                f"{self.rows} x {self.cols} of {self.pitch_mm} mm; give a finer pitch or a larger area"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)"""
        return self.rows, self.cols

    @property
    def width_mm(self) -> float:
        """Along x, cell for cell."""
        return self.cols * self.pitch_mm

    @property
    def height_mm(self) -> float:
        """Along y."""
        return self.rows * self.pitch_mm

    @property
    def cell_mm2(self) -> float:
        """Area of one grid cell."""
        return self.pitch_mm**2

    @cached_property
    def place_mm(self) -> Float[Array, "2 rows cols"]:
        """(x, y) of every point."""
        axes = [(np.arange(samples) - (samples - 1) / 2) * self.pitch_mm for samples in (self.cols, self.rows)]
        return np.stack(np.meshgrid(*axes))

    @cached_property
    def waves(self) -> tuple[Float[Array, "rows half"], Float[Array, "rows half"]]:
        """(k_x, k_y) of the transform's entries, 1/mm."""
        turn = 2 * np.pi / self.pitch_mm
        kx, ky = np.meshgrid(np.fft.rfftfreq(self.cols) * turn, np.fft.fftfreq(self.rows) * turn)
        return kx, ky

    @cached_property
    def unit_waves(self) -> tuple[Float[Array, "rows half"], Float[Array, "rows half"]]:
        """Direction of every wave.

        The highest wave of an even grid has none along its axis; zero there keeps fields real, and even and odd grids
        alike.
        """
        kx, ky = (wave.copy() for wave in self.waves)
        if self.cols % 2 == 0:
            kx[:, -1] = 0
        if self.rows % 2 == 0:
            ky[self.rows // 2] = 0
        length = np.hypot(*self.waves)
        length[0, 0] = 1
        return kx / length, ky / length


def padded_grid(width_mm: float, height_mm: float, pitch_mm: float, margin_mm: float) -> PeriodicGrid:
    """The smallest quickly transformed grid with at least this margin on every side of the area."""
    from scipy.fft import next_fast_len

    sides = [int(np.ceil((side + 2 * margin_mm) / pitch_mm)) for side in (height_mm, width_mm)]
    rows, cols = (next_fast_len(side, real=True) for side in sides)
    return PeriodicGrid(rows, cols, pitch_mm)

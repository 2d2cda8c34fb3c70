"""A rectangle of skin sampled on a square grid that is treated as periodic: its points and the wave vectors of its transform."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.errors import InputError

_MIN_POINTS_PER_SIDE = 8


class PeriodicGridTooSmall(InputError):
    """Raised for a grid that is too small to carry a contact."""


@dataclass(frozen=True)
class PeriodicGrid:
    """A square grid centred on the sensor's origin; `PeriodicGridTooSmall` below 8 x 8 points or without a positive pitch."""

    rows: int
    cols: int
    pitch_mm: float

    def __post_init__(self) -> None:
        if min(self.rows, self.cols) < _MIN_POINTS_PER_SIDE or not self.pitch_mm > 0:
            raise PeriodicGridTooSmall(
                f"expected a grid of at least {_MIN_POINTS_PER_SIDE} x {_MIN_POINTS_PER_SIDE} points with a pitch above zero, "
                f"got {self.rows} x {self.cols} points with a pitch of {self.pitch_mm} mm; give a finer pitch or a larger area"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """The number of points as (rows, cols)."""
        return self.rows, self.cols

    @property
    def width_mm(self) -> float:
        """The length of one period along x, which is the sum of the cells."""
        return self.cols * self.pitch_mm

    @property
    def height_mm(self) -> float:
        """The length of one period along y, which is the sum of the cells."""
        return self.rows * self.pitch_mm

    @property
    def cell_area_mm2(self) -> float:
        """The area of one grid cell."""
        return self.pitch_mm**2

    @cached_property
    def positions_mm(self) -> Float[Array, "2 rows cols"]:
        """The (x, y) of every point in the sensor's frame."""
        axes = [(np.arange(samples) - (samples - 1) / 2) * self.pitch_mm for samples in (self.cols, self.rows)]
        return np.stack(np.meshgrid(*axes))

    @cached_property
    def wave_vectors(self) -> tuple[Float[Array, "rows half"], Float[Array, "rows half"]]:
        """The (k_x, k_y) of every entry of the transform, in 1/mm."""
        turn = 2 * np.pi / self.pitch_mm
        kx, ky = np.meshgrid(np.fft.rfftfreq(self.cols) * turn, np.fft.fftfreq(self.rows) * turn)
        return kx, ky

    @cached_property
    def wave_directions(self) -> tuple[Float[Array, "rows half"], Float[Array, "rows half"]]:
        """The unit vector (k_x, k_y) / |k| of every entry of the transform.

        The highest wave of an even grid has no direction along its axis. A zero there keeps fields real, and makes even and
        odd grids agree.
        """
        kx, ky = (wave.copy() for wave in self.wave_vectors)
        if self.cols % 2 == 0:
            kx[:, -1] = 0
        if self.rows % 2 == 0:
            ky[self.rows // 2] = 0
        length = np.hypot(*self.wave_vectors)
        length[0, 0] = 1
        return kx / length, ky / length


def padded_grid(width_mm: float, height_mm: float, pitch_mm: float, margin_mm: float) -> PeriodicGrid:
    """Return the smallest grid of a quickly transformed size that has at least this margin on every side of the area."""
    from scipy.fft import next_fast_len

    sides = [int(np.ceil((side + 2 * margin_mm) / pitch_mm)) for side in (height_mm, width_mm)]
    rows, cols = (next_fast_len(side, real=True) for side in sides)
    return PeriodicGrid(rows, cols, pitch_mm)

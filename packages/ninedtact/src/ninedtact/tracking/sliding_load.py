"""The load of a contact that slides all over.

One image does not tell how much of a sheared contact sticks. Skin that sticks cannot spread under the object, and a wide contact
then bears up to four times the load for the same thinning, as gel does that is squeezed out between two walls in place of one. Once
an object is seen to slide, nothing sticks, and its shear is the load along the skin, spread as the pressure is.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.fft import next_fast_len

from ninedtact.design import Gel
from ninedtact.mechanics.skin import PeriodicGrid, Skin
from ninedtact.quantities import Traction, WrenchEstimate

_MARGIN_CELLS, _MOST_OVERREAD = 8, 4.0


def overread_of_sliding(traction: Traction) -> float:
    """Return the load of a traction over that of one which slides all over and thins the gel as much, in least squares.

    The pressure of the latter has the same shape and its shear the same sum. It is one where nothing presses.
    """
    if not traction.pressure_mpa.any():
        return 1.0
    skin = skin_of(square_grid(traction), traction.gel)
    fields = np.zeros((3, *skin.grid.shape), np.float32)
    rows, cols = traction.pressure_mpa.shape
    fields[0, :rows, :cols], fields[1:, :rows, :cols] = traction.pressure_mpa, traction.shear_mpa
    pressure, shear = fields[0], fields[1:]
    ratio = shear.sum(axis=(1, 2)) / pressure.sum()
    sticks = shear - ratio[:, None, None] * pressure
    by_pressure_mm = skin.thickness_change_by_pressure_mm(pressure)
    by_sticking_mm = skin.operators.bulge_from_shear_mm(sticks) - skin.interface_height_mm(0 * pressure, sticks)
    part = 1 + float(np.vdot(by_pressure_mm, by_sticking_mm) / np.vdot(by_pressure_mm, by_pressure_mm))
    return 1 / max(part, 1 / _MOST_OVERREAD)


def as_it_slides(force: WrenchEstimate, overread: float) -> WrenchEstimate:
    """Return an estimate about the skin's centre with the load of a contact that slides all over (`overread_of_sliding`)."""
    force, traction = force.about_skin_centre(), force.traction
    if traction is None:
        return force
    traction = replace(traction, pressure_mpa=traction.pressure_mpa / np.float32(overread))
    return replace(force, wrench=traction.wrench(), traction=traction)


def square_grid(traction: Traction) -> PeriodicGrid:
    """Return a grid on which the contact is apart from its periodic images, however it is turned."""
    side = next_fast_len(max(traction.pressure_mpa.shape) + _MARGIN_CELLS, real=True)
    return PeriodicGrid(side, side, traction.mm_per_px)


@cache
def skin_of(grid: PeriodicGrid, gel: Gel) -> Skin:
    """Return the skin of a gel on a grid, which is built once."""
    return Skin(grid, gel)

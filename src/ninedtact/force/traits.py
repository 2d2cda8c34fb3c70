"""What is known of a sensor beside its images, told to networks that ask: its gel's thickness, and how its light answers.

The light tells more than light. Its numbers are fitted to a ball press with mechanics that are taken for granted; where a gel's
base yields, they come out unlike those of any gel on a rigid one, and a network can tell by them what the heights that were
read with them mean.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.shape.calibrated import CalibratedShape


@dataclass(frozen=True)
class Traits:
    """Of one sensor; the defaults are usual ones, and stand where a calibration tells none."""

    thickness_mm: float = Gel().thickness_mm
    darkening_per_mm: float = 0.1
    """Relative darkening of the first tenth of a millimetre that is pressed in, per mm."""
    brightening_per_mm: float = 0.35
    """Relative brightening, per mm that the skin bulges."""
    point_spread_mm: float = 0.55
    """How far light scatters in the gel, a standard deviation."""
    global_dimming: float = 0.7
    """Relative loss of light everywhere, per mean darkening of the view."""

    @property
    def row(self) -> Float32[Array, " traits"]:
        """All numbers, as training keeps them."""
        return np.array(list(vars(self).values()), np.float32)


USUAL = Traits()
NUMBER = len(USUAL.row)


def traits_of(shape: CalibratedShape, gel: Gel) -> Traits:
    """As the calibration has them."""
    curve, usual = shape.curve, USUAL
    if curve.signal != "ratio":
        return Traits(gel.thickness_mm)
    return Traits(
        gel.thickness_mm,
        slope(curve.darkening, curve.indentation_mm, usual.darkening_per_mm),
        slope(curve.brightening, curve.bulge_mm, usual.brightening_per_mm),
        usual.point_spread_mm if shape.deblurring is None else shape.deblurring.point_spread_mm,
        shape.loss.global_dimming,
    )


def slope(signal: tuple[float, ...], mm: tuple[float, ...], usual: float) -> float:
    """Of a curve at its beginning."""
    return signal[1] / mm[1] if len(signal) > 1 and mm[1] > 0 else usual

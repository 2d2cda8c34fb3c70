"""How much darker or brighter skin of a height is, before its light scatters: the depth curve read backwards."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.force.traction.refusals import require_bulges
from ninedtact.shape.depth import DepthCurve

BEYOND = 2.0
"""Times the calibrated range to which the curve is continued along its last stretch."""


@dataclass(frozen=True)
class BrightnessLaw:
    """Relative change of brightness over height, straight between knots."""

    height_mm: Float[Array, " knots"]
    change: Float[Array, " knots"]

    def __call__(self, height_mm: Float32[Array, "*shape"]) -> Float32[Array, "*shape"]:
        """The change of skin this high."""
        return np.interp(height_mm, self.height_mm, self.change).astype(np.float32)

    def slope_per_mm(self, height_mm: Float32[Array, "*shape"]) -> Float32[Array, "*shape"]:
        """Its derivative."""
        steps = np.diff(self.change) / np.diff(self.height_mm)
        stretch = np.searchsorted(self.height_mm[1:-1], height_mm, side="right")
        return steps.astype(np.float32)[stretch]


def law_of(curve: DepthCurve) -> BrightnessLaw:
    """The law of a ratio curve; raises `TractionImpossible` where it knows no bulges."""
    require_bulges(curve.knows_bulges and curve.signal == "ratio")
    dark, deep = np.array(curve.darkening), np.array(curve.indentation_mm)
    bright, high = np.array(curve.brightening), np.array(curve.bulge_mm)
    height = np.concatenate([-deep[::-1], high[1:]])
    change = np.concatenate([-dark[::-1], bright[1:]])
    return continued(*rising(height, change))


def rising(height: Float[Array, " n"], change: Float[Array, " n"]) -> tuple[Array, Array]:
    """Without knots at the same height."""
    new = np.concatenate([[True], np.diff(height) > 1e-9])
    return height[new], change[new]


def continued(height: Float[Array, " n"], change: Float[Array, " n"]) -> BrightnessLaw:
    """Both ends drawn out straight."""
    slope = np.diff(change) / np.diff(height)
    low, high = BEYOND * height[0], BEYOND * height[-1]
    ends = change[0] + slope[0] * (low - height[0]), change[-1] + slope[-1] * (high - height[-1])
    return BrightnessLaw(np.concatenate([[low], height, [high]]), np.concatenate([[ends[0]], change, [ends[1]]]))


HEIGHTS_THEMSELVES = BrightnessLaw(np.array([-20.0, 20.0]), np.array([-20.0, 20.0]))
"""Where heights are given and no light: one per mm."""

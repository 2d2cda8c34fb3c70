"""The height of the skin from the thickness of the gel, where the layer below it yields.

Light shows how thick the gel is, not how high its skin lies: height = change of thickness + deflection of the interface below.
Under pressure the interface of a linear gel follows from the change of thickness t by one filter, û = Nᵢ/(N − Nᵢ) t̂, with the
compliances of `layer_compliance`; shear moves both in nearly the same ratio. At finite strain the load, and with it the
deflection, grows by the factor of `finite_strain_stiffening`, which needs the height itself: three iterations find it.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.finite_strain import finite_strain_stiffening
from ninedtact.mechanics.layer_compliance import gel_compliance
from ninedtact.mechanics.skin import PeriodicGrid, padded_grid

_PITCH_MM = 0.4
"""Pitch of the grid on which the deflection, which is smooth over a thickness, is computed."""
_MARGIN_MM = 6.0
"""Width of the skin beyond the field; thicker or thinner gel there is not seen and taken as untouched."""
_SMOOTHING_PITCHES = 0.4
"""Standard deviation of the filter before the coarser grid, in pitches of it."""
_ITERATIONS = 3
STIFFENING = 1.3
"""Usual factor on the stiffening, because friction carries a part of the load that the filter attributes to pressure. Found on
balls of 4 mm on bases 3 to 10 times as stiff as the gel, down to 0.8 of the thickness: with it, depths are right to 2 to 5 %."""

Field = Float32[Array, "rows cols"]


@dataclass(frozen=True)
class BaseDeflection:
    """Computes the height of the interface below a gel from the change of the gel's thickness."""

    gel: Gel
    stiffening: float = STIFFENING
    """Factor on what finite strain adds; a calibration finds the one that gives the depth of its own ball."""

    def __call__(self, thickness_change_mm: Field, mm_per_px: float) -> Field:
        """Return the height of the interface, negative where it is pressed down; zero where the base is rigid.

        thickness_change_mm: negative where the gel is thinner. mm_per_px: the pitch of its points.
        """
        if self.gel.has_rigid_base:
            return np.zeros_like(thickness_change_mm)
        rows, cols = thickness_change_mm.shape
        grid = padded_grid(cols * mm_per_px, rows * mm_per_px, _PITCH_MM, _MARGIN_MM)
        # The field's middle lies on the grid's middle; points of the grid beyond the field are untouched.
        zoom = mm_per_px / _PITCH_MM
        to_grid = np.array(
            [[zoom, 0, (grid.cols - 1 - zoom * (cols - 1)) / 2], [0, zoom, (grid.rows - 1 - zoom * (rows - 1)) / 2]]
        )
        smooth = cv2.GaussianBlur(thickness_change_mm, (0, 0), _SMOOTHING_PITCHES / zoom)
        coarse = cv2.warpAffine(smooth, to_grid, (grid.cols, grid.rows), flags=cv2.INTER_LINEAR, borderValue=0.0)
        interface = self._interface_mm(coarse, grid)
        return np.asarray(
            cv2.warpAffine(interface, to_grid, (cols, rows), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP), np.float32
        )

    def _interface_mm(self, thickness_change_mm: Field, grid: PeriodicGrid) -> Field:
        """Return the height of the interface on a periodic grid."""
        from scipy.fft import irfft2, rfft2

        share = _share_of_interface(grid, self.gel)
        linear_mm = thickness_change_mm
        for _ in range(_ITERATIONS if self.gel.finite_strain else 0):
            height_mm = linear_mm + irfft2(rfft2(linear_mm) * share, s=grid.shape)
            stiffening = finite_strain_stiffening(height_mm, linear_mm, self.gel)
            added = self.stiffening * (stiffening - 1) * np.minimum(linear_mm, 0)
            linear_mm = thickness_change_mm + irfft2(rfft2(added) * share, s=grid.shape)
        # The linear gel would be as much thinner as the interface of the stiffer one is deeper.
        height_mm = linear_mm + irfft2(rfft2(linear_mm) * share, s=grid.shape)
        return np.asarray(height_mm - thickness_change_mm, np.float32)


@lru_cache(maxsize=4)
def _share_of_interface(grid: PeriodicGrid, gel: Gel) -> Float32[Array, "rows half"]:
    """Return Nᵢ/(N − Nᵢ) for every wave of a grid; zero for the mean, of which an incompressible gel shows nothing."""
    compliance = gel_compliance(np.hypot(*grid.wave_vectors), gel)
    thinning = compliance.normal - compliance.interface_normal
    share = compliance.interface_normal / np.where(thinning > 0, thinning, np.inf)
    share[0, 0] = 0.0
    return share.astype(np.float32)

"""The height of the skin from the thickness of the gel, where the layer below it yields.

Light shows how thick the gel is, not how high its skin lies: height = change of thickness + deflection of the interface below.
Under pressure the interface of a linear gel follows from the change of thickness t by one filter, û = Nᵢ/(N − Nᵢ) t̂, with the
compliances of `layer_compliance`; shear moves both in nearly the same ratio. At finite strain the load, and with it the
deflection, grows by the factor of `finite_strain_stiffening` at the height of the linear gel.
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

_PITCH_MM = 0.8
"""About the pitch of the grid on which the deflection, which is smooth over a thickness, is computed."""
_MARGIN_MM = 6.0
"""Width of the skin beyond the field; thicker or thinner gel there is not seen and taken as untouched."""
STIFFENING = 1.5
"""Usual factor on the stiffening, because friction carries a part of the load that the filter attributes to pressure. Found on
balls of 4 mm on bases 3 to 10 times as stiff as the gel, down to 0.8 of the thickness: with it, depths are right to 5 %."""

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
        # Points of the grid are means of whole blocks of the field; those beyond the field are untouched.
        side = max(round(_PITCH_MM / mm_per_px), 1)
        blocks = cv2.copyMakeBorder(thickness_change_mm, 0, -rows % side, 0, -cols % side, cv2.BORDER_REPLICATE)
        few_rows, few_cols = blocks.shape[0] // side, blocks.shape[1] // side
        few = np.asarray(cv2.resize(blocks, (few_cols, few_rows), interpolation=cv2.INTER_AREA))
        pitch_mm = side * mm_per_px
        grid = padded_grid(few_cols * pitch_mm, few_rows * pitch_mm, pitch_mm, _MARGIN_MM)
        down, right = grid.rows - few_rows, grid.cols - few_cols
        interface = self._interface_mm(
            cv2.copyMakeBorder(few, 0, down, 0, right, cv2.BORDER_CONSTANT, value=0.0), grid
        )[:few_rows, :few_cols]
        fine = cv2.resize(interface, blocks.shape[::-1], interpolation=cv2.INTER_CUBIC)
        return np.ascontiguousarray(fine[:rows, :cols])

    def _interface_mm(self, thickness_change_mm: Field, grid: PeriodicGrid) -> Field:
        """Return the height of the interface on a periodic grid."""
        from scipy.fft import irfft2, rfft2

        share = _share_of_interface(grid, self.gel)
        deflection = rfft2(thickness_change_mm) * share
        if self.gel.finite_strain:
            height_mm = thickness_change_mm + irfft2(deflection, s=grid.shape)
            stiffening = finite_strain_stiffening(height_mm, thickness_change_mm, self.gel)
            # The linear gel would be as much thinner as the interface of the stiffer one is deeper.
            added = rfft2(self.stiffening * (stiffening - 1) * np.minimum(thickness_change_mm, 0))
            deflection = deflection + share * (added + share * added)
        return np.asarray(irfft2(deflection, s=grid.shape), np.float32)


@lru_cache(maxsize=4)
def _share_of_interface(grid: PeriodicGrid, gel: Gel) -> Float32[Array, "rows half"]:
    """Return Nᵢ/(N − Nᵢ) for every wave of a grid; zero for the mean, of which an incompressible gel shows nothing."""
    compliance = gel_compliance(np.hypot(*grid.wave_vectors), gel)
    thinning = compliance.normal - compliance.interface_normal
    share = compliance.interface_normal / np.where(thinning > 0, thinning, np.inf)
    share[0, 0] = 0.0
    return share.astype(np.float32)

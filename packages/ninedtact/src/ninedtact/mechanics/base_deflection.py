"""The height of the skin from the thickness of the gel, where the layer below it yields.

Light shows how thick the gel is, not how high its skin lies: height = change of thickness + deflection of the interface below.
A wave of pressure p̂ and shear q̂ on the skin along its direction e changes the thickness by −(N − Nᵢ) p̂ − i (M − Mᵢ)(e·q̂), and
the height of the interface by −Nᵢ p̂ − i Mᵢ (e·q̂), with the compliances N (normal), M (coupling), L (along) of `layer_compliance`
and those of the interface. Thickness alone tells the interface where shear follows from pressure. Two components are modelled:

- Friction keeps skin under an object from being pushed outwards. Held everywhere, the skin would bear the shear q̂ = i (M/L) p̂ e; a
  contact holds the part `_HELD_SHARE` of it, since skin outside moves freely.
- Under a drag, shear is the pressure times one vector. Its wrong value would put pressure outside of the contact; it is the one
  that leaves the least there.

At finite strain the load, and with it the deflection, grows by the factor of `finite_strain_stiffening` at the height of the linear
gel.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Complex64, Float, Float32
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.finite_strain import finite_strain_stiffening
from ninedtact.mechanics.layer_compliance import gel_compliance
from ninedtact.mechanics.skin import PeriodicGrid, padded_grid

DEFLECTION_PITCH_MM = 0.8
"""About the pitch of the grid on which the deflection, which is smooth over a thickness, is computed."""
DEFLECTION_MARGIN_MM = 6.0
"""Width of the skin beyond the field; thicker or thinner gel there is not seen and taken as untouched."""
_HELD_SHARE = 0.45
"""Part of the shear of skin that is held everywhere which a contact bears. Found on balls, flat punches, a gear, a letter, a key
and a screw on gels of 1.7 to 2.5 mm, with bases 3 to 25 times as stiff and friction of 0.3 to 1: without it, flat objects are read
too shallow by up to a third of the interface's deflection."""
STIFFENING = 0.6
"""Usual factor on the stiffening: of 0.3 on these objects, and of 0.9 for independent finite elements of a ball on 2.5 mm of gel,
pressed in to 1.8 mm. A calibration finds that of its own ball."""
LEAST_THINNING_MM = 0.05
"""Thinning below which no shear is looked for."""
EDGE_OF_CONTACT = 0.25
"""Share of the greatest thinning above which gel is taken to be in contact."""
_PRESSURE_BLUR_MM = 0.9
"""Standard deviation of the smoothing of the pressure outside of the contact, which noise of the thickness would hide."""
SHEAR_STEPS, SMALL_SHEAR = 4, 0.03
"""Gauss–Newton steps at most, and the change of the shear over the pressure after which they end."""
MAX_SHEAR = 1.0
"""Largest shear over pressure: friction of skin bears little more."""

Field = Float32[Array, "rows cols"]
_Spectrum = Complex64[Array, "rows half"]
_ShearRatio = Float[Array, "2"]


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
        side = max(round(DEFLECTION_PITCH_MM / mm_per_px), 1)
        blocks = cv2.copyMakeBorder(thickness_change_mm, 0, -rows % side, 0, -cols % side, cv2.BORDER_REPLICATE)
        few_rows, few_cols = blocks.shape[0] // side, blocks.shape[1] // side
        few = np.asarray(cv2.resize(blocks, (few_cols, few_rows), interpolation=cv2.INTER_AREA))
        pitch_mm = side * mm_per_px
        grid = padded_grid(few_cols * pitch_mm, few_rows * pitch_mm, pitch_mm, DEFLECTION_MARGIN_MM)
        down, right = grid.rows - few_rows, grid.cols - few_cols
        in_view = np.s_[:few_rows, :few_cols]
        padded = cv2.copyMakeBorder(few, 0, down, 0, right, cv2.BORDER_CONSTANT, value=0.0)
        interface = self._interface_mm(padded, grid, in_view)[in_view]
        fine = cv2.resize(interface, blocks.shape[::-1], interpolation=cv2.INTER_CUBIC)
        return np.ascontiguousarray(fine[:rows, :cols])

    def _interface_mm(self, thickness_change_mm: Field, grid: PeriodicGrid, in_view: tuple[slice, slice]) -> Field:
        """Return the height of the interface on a periodic grid, of which a part is seen."""
        from scipy.fft import irfft2, rfft2

        waves, spectrum = held_skin_waves(grid, self.gel), rfft2(thickness_change_mm)
        share = waves.share_of_interface(waves.shear_over_pressure(spectrum, thickness_change_mm, in_view))
        deflection = spectrum * share
        if self.gel.finite_strain:
            height_mm = thickness_change_mm + irfft2(deflection, s=grid.shape)
            stiffening = finite_strain_stiffening(height_mm, thickness_change_mm, self.gel)
            # The linear gel would be as much thinner as the interface of the stiffer one is deeper: two terms of the series of
            # added · share / (1 − share).
            added = rfft2(self.stiffening * (stiffening - 1) * np.minimum(thickness_change_mm, 0))
            deflection = deflection + share * (added + share * added)
        return np.asarray(irfft2(deflection, s=grid.shape), np.float32)


@dataclass(frozen=True)
class HeldSkinWaves:
    """What pressure on skin that friction holds does to each wave of a grid."""

    grid: PeriodicGrid
    thinning: Float32[Array, "rows half"]
    """Thinning by pressure, mm/MPa; one for the mean, of which an incompressible gel shows nothing."""
    interface: Float32[Array, "rows half"]
    """Inward displacement of the interface by pressure; zero for the mean."""
    thinning_by_shear: Complex64[Array, "2 rows half"]
    """Thinning by further shear along x and along y."""
    interface_by_shear: Complex64[Array, "2 rows half"]
    blur: Float32[Array, "rows half"]
    """Of the pressure outside of the contact; zero for the mean."""

    def share_of_interface(self, shear_over_pressure: _ShearRatio) -> _Spectrum:
        """Return the height of the interface over the change of thickness."""
        s_x, s_y = shear_over_pressure
        interface = self.interface + s_x * self.interface_by_shear[0] + s_y * self.interface_by_shear[1]
        return np.asarray(interface / self._thinning(shear_over_pressure), np.complex64)

    def shear_over_pressure(
        self, spectrum: _Spectrum, thickness_change_mm: Field, in_view: tuple[slice, slice]
    ) -> _ShearRatio:
        """Return the vector by which shear is a multiple of pressure: that which leaves least pressure outside of the contact."""
        from scipy.fft import irfft2

        ratio, seen = np.zeros(2), thickness_change_mm[in_view]
        free = _skin_outside_contact(seen)
        if seen.min() > -LEAST_THINNING_MM or not free.any():
            return ratio
        for _ in range(SHEAR_STEPS):
            pressure = spectrum * self.blur / self._thinning(ratio)
            by_shear = pressure * self.thinning_by_shear / self._thinning(ratio)
            fields = irfft2(np.concatenate([pressure[None], by_shear]), s=self.grid.shape)[(np.s_[:], *in_view)]
            wrong, *derivatives = fields[:, free]
            step = np.linalg.lstsq(np.stack(derivatives, axis=-1), wrong, rcond=None)[0]
            ratio = ratio + step
            ratio = ratio / max(float(np.hypot(*ratio)) / MAX_SHEAR, 1.0)
            if np.abs(step).max() < SMALL_SHEAR:
                break
        return ratio

    def _thinning(self, shear_over_pressure: _ShearRatio) -> _Spectrum:
        s_x, s_y = shear_over_pressure.astype(np.float32)
        return np.asarray(self.thinning + s_x * self.thinning_by_shear[0] + s_y * self.thinning_by_shear[1])


def _skin_outside_contact(thickness_change_mm: Field) -> Bool[Array, "rows cols"]:
    """Return the points at which, and next to which, the gel is little thinner."""
    free = (thickness_change_mm > EDGE_OF_CONTACT * thickness_change_mm.min()).astype(np.uint8)
    return np.asarray(cv2.erode(free, np.ones((3, 3), np.uint8)) > 0)


@lru_cache(maxsize=4)
def held_skin_waves(grid: PeriodicGrid, gel: Gel) -> HeldSkinWaves:
    """Return the responses of a gel, for every wave of a grid."""
    wave_number = np.hypot(*grid.wave_vectors)
    compliance = gel_compliance(wave_number, gel)
    held = _HELD_SHARE * compliance.coupling / compliance.along
    interface = compliance.interface_normal - held * compliance.interface_coupling
    thinning = compliance.normal - held * compliance.coupling - interface
    coupling = compliance.coupling - compliance.interface_coupling
    directions = np.stack(grid.wave_directions)
    blur = np.exp(-((wave_number * _PRESSURE_BLUR_MM) ** 2) / 2)
    blur[0, 0] = interface[0, 0] = 0.0
    thinning[0, 0] = 1.0
    return HeldSkinWaves(
        grid,
        thinning.astype(np.float32),
        interface.astype(np.float32),
        (1j * coupling * directions).astype(np.complex64),
        (1j * compliance.interface_coupling * directions).astype(np.complex64),
        blur.astype(np.float32),
    )

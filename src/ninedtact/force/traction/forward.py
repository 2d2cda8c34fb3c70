"""From tractions to what is seen of them: heights of the skin by the gel's compliance, then light that scatters.

Tractions are in units of the shear modulus, so that everything here depends on the gel's shape alone.
"""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Complex64, Float, Float32
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.force.traction.cells import Cells
from ninedtact.mechanics.array_namespace import forward_transform, inverse_transform
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance, layered_compliance
from ninedtact.mechanics.skin import Skin as Layers

View = Float32[Array, "rows cols"]
Skin = Float32[Array, "skin_rows skin_cols"]
Tractions = Float32[Array, "3 rows cols"]
"""Pressure, and shear along x and y, over the shear modulus."""


@dataclass(frozen=True)
class Forward:
    """Linear in the tractions up to the height; the law of light comes between `heights` and `scattered`."""

    cells: Cells
    thickness_mm: float
    poisson_ratio: float
    point_spread_mm: float
    """Standard deviation of the point-spread; zero where heights are given."""
    base: Gel | None = None
    """What the gel lies on, its shear modulus over that of the gel; none is rigid."""

    @cached_property
    def symbols(self) -> Complex64[Array, "3 skin_rows half"]:
        """What the transforms of the tractions are multiplied by."""
        gel = Gel(self.thickness_mm, 1.0, self.poisson_ratio)
        below = partial(bonded_layer_compliance, gel=gel) if self.base is None else layered_compliance((gel, self.base))
        parts = Layers(self.cells.patch, below, np.zeros(())).symbols
        up = np.stack([-parts["normal"] + 0j, 1j * parts["bulge_x"], 1j * parts["bulge_y"]])
        return up.astype(np.complex64)

    @cached_property
    def back_symbols(self) -> Complex64[Array, "3 skin_rows half"]:
        """Of the adjoint."""
        return np.conj(self.symbols)

    @cached_property
    def wave(self) -> Float[Array, "skin_rows half"]:
        """|k|, 1/mm."""
        return np.hypot(*self.cells.patch.waves)

    @cached_property
    def spreads(self) -> tuple[Float32[Array, "rows skin_rows"], Float32[Array, "skin_cols cols"]]:
        """Scattering from the skin into the view, one axis at a time."""
        down, across = (scattering(self.cells, axis, self.point_spread_mm) for axis in (0, 1))
        return down, np.ascontiguousarray(across.T)

    def heights(self, tractions: Tractions) -> Skin:
        """Height of all skin."""
        return self.raised(forward_transform(tractions, self.cells.patch.shape))

    def raised(self, wave: Complex64[Array, "3 skin_rows half"]) -> Skin:
        """The same from the tractions' transforms."""
        shape = self.cells.patch.shape
        return inverse_transform((wave * self.symbols).sum(axis=0), shape, shape)

    def pulled_back(self, skin: Skin) -> Complex64[Array, "3 skin_rows half"]:
        """The adjoint of `heights`, still as waves."""
        return forward_transform(skin, self.cells.patch.shape) * self.back_symbols

    def of_view(self, waves: Complex64[Array, "*n skin_rows half"]) -> Float32[Array, "*n rows cols"]:
        """Waves back in space, the view cut out."""
        return inverse_transform(waves, self.cells.patch.shape, self.cells.shape)

    def scattered(self, skin: Skin) -> View:
        """What the camera sees of a change of brightness all over the skin."""
        down, across = self.spreads
        return down @ skin @ across

    def gathered(self, view: View) -> Skin:
        """The adjoint of `scattered`."""
        down, across = self.spreads
        return down.T @ view @ across.T


def scattering(cells: Cells, axis: int, sigma_mm: float) -> Float32[Array, "view skin"]:
    """A Gaussian from every cell of the skin to every one of the view; the identity for no width."""
    away_mm = (np.arange(cells.shape[axis])[:, None] - cells.offsets(axis)) * cells.pitch_mm
    width_mm = max(sigma_mm, 1e-3 * cells.pitch_mm)
    reach_mm = np.arange(-200, 201) * cells.pitch_mm
    total = np.exp(-((reach_mm / width_mm) ** 2) / 2).sum()
    return (np.exp(-((away_mm / width_mm) ** 2) / 2) / total).astype(np.float32)

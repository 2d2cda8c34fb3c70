"""The forward model: tractions → change of the gel's thickness by its compliance → light that scatters into the view.

Tractions are in units of the shear modulus, so that everything here depends on the gel's geometry alone. `ForwardModel` computes
whole fields by Fourier transforms; `InfluenceKernels` gives the response to single cells, from which the inversion builds its
matrices. `ForwardModel` takes single fields or batches, in NumPy or torch (`ForwardModel.like`).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Complex64, Float, Float32, Int
from numpy import ndarray as Array
from numpy.lib.stride_tricks import sliding_window_view

from ninedtact.design import Gel
from ninedtact.force.traction.observation import CellGrid
from ninedtact.mechanics.finite_strain import finite_strain_stiffening, finite_strain_thickening_mm
from ninedtact.mechanics.numpy_or_torch_arrays import (
    array_namespace_of,
    forward_transform,
    inverse_transform,
    max_over_grid,
)
from ninedtact.mechanics.skin import Skin

View = Float32[Any, "*batch rows cols"]
SkinField = Float32[Any, "*batch skin_rows skin_cols"]
Tractions = Float32[Any, "*batch 3 rows cols"]
"""Pressure, and shear along x and along y, over the shear modulus."""
Indices = Int[Array, " n"]

_SMALLEST_WEIGHT = 1e-9
_EDGE_THINNING = 0.1
"""Thinning over the gel's thickness from which gel under pressure lies wholly under the object: little pressure that the inversion
puts beside the contact, where the gel is thicker, does not make it a part of the contact."""
_SCATTERING_REACH = 3.0
"""Distance, in standard deviations of the point-spread, from which scattered light still reaches the view."""


@dataclass(frozen=True)
class DeformedSkin:
    """The skin under tractions of the linear gel, and how much more the gel at finite strain needs for it."""

    height_mm: SkinField
    thickness_change_mm: SkinField
    """Change of the gel's thickness, that at finite strain included."""
    stiffening: SkinField
    """Ratio of the tractions at finite strain to those of the linear gel."""
    nonlinear_mm: SkinField
    """The part of the change of thickness that is not linear in the tractions."""


@dataclass(frozen=True)
class ForwardModel:
    """The skin as a function of tractions, and scattering of light; the brightness law is applied between the two."""

    cells: CellGrid
    gel: Gel
    """Its shear modulus does not count: tractions are in units of it."""
    point_spread_mm: float
    """Standard deviation of the point-spread."""
    like: Any = field(default_factory=lambda: np.zeros((), np.float32), compare=False, repr=False)
    """An array whose library and device the fields have."""

    @cached_property
    def compliance(self) -> Complex64[Any, "3 skin_rows half"]:
        """Change of the gel's thickness over pressure and over shear along x and y, per wave vector."""
        return self._height_compliance - self._interface_compliance

    @cached_property
    def _height_compliance(self) -> Complex64[Any, "3 skin_rows half"]:
        """Height over pressure and over shear along x and y, per wave vector."""
        parts = self._skin.fourier_symbols
        return self._on_cells(-parts["normal"] + 0j, 1j * parts["bulge_x"], 1j * parts["bulge_y"])

    @cached_property
    def _interface_compliance(self) -> Complex64[Any, "3 skin_rows half"]:
        """Height of the gel's bottom over pressure and over shear along x and y, per wave vector."""
        return self._on_cells(*self._skin.interface_symbols)

    @cached_property
    def _tangential_compliance(self) -> Complex64[Any, "2 3 skin_rows half"]:
        """Displacement of the skin along x and y over pressure and over shear along x and y, per wave vector."""
        parts = self._skin.fourier_symbols
        along_x = self._on_cells(1j * parts["bulge_x"], parts["xx"], parts["xy"])
        along_y = self._on_cells(1j * parts["bulge_y"], parts["xy"], parts["yy"])
        return array_namespace_of(along_x).stack([along_x, along_y])

    @cached_property
    def sticking_shear(self) -> Complex64[Any, "2 skin_rows half"]:
        """Shear along x and y over pressure, per wave vector, that keeps the skin from moving sideways.

        Pressure spreads the gel outwards. Skin that sticks to the object does not follow, so that the object pulls it inwards.
        """
        parts = self._skin.fourier_symbols
        determinant = parts["xx"] * parts["yy"] - parts["xy"] ** 2
        along_x = (parts["yy"] * parts["bulge_x"] - parts["xy"] * parts["bulge_y"]) / determinant
        along_y = (parts["xx"] * parts["bulge_y"] - parts["xy"] * parts["bulge_x"]) / determinant
        return self._on_cells(-1j * along_x, -1j * along_y)

    @cached_property
    def _skin(self) -> Skin:
        """The periodic skin of a gel with a shear modulus of one."""
        return Skin(self.cells.patch, replace(self.gel, shear_modulus_mpa=1.0), self.like)

    def _on_cells(self, *symbols: Array) -> Complex64[Any, "symbols skin_rows half"]:
        """Return symbols for tractions that are uniform over cells: those of points times the sinc of each axis."""
        wave_x, wave_y = self.cells.patch.wave_vectors
        turns = self.cells.pitch_mm / (2 * np.pi)
        waves = np.stack(symbols) * np.sinc(wave_x * turns) * np.sinc(wave_y * turns)
        return self._skin.asarray(waves.real) + 1j * self._skin.asarray(waves.imag)

    @cached_property
    def point_spread(self) -> tuple[Float32[Any, "rows skin_rows"], Float32[Any, "skin_cols cols"]]:
        """Weights with which light scatters from the skin into the cells of the view, one axis at a time."""
        # The signal of a cell is the mean over a cell, which is a point spread of variance pitch²/12 on each axis.
        sigma_mm = float(np.hypot(self.point_spread_mm, self.cells.pitch_mm / np.sqrt(12)))
        down, across = (_gaussian_weights(self.cells, axis, sigma_mm) for axis in (0, 1))
        return self._skin.asarray(down), self._skin.asarray(across.T)

    def deform(self, tractions: Tractions) -> DeformedSkin:
        """Return all skin under tractions of the linear gel on the view, with thickness as in `correct_for_finite_strain`."""
        (rows, cols), shape, gel = tractions.shape[-2:], self.cells.patch.shape, self.gel
        xp, waves = array_namespace_of(tractions), forward_transform(tractions, shape)
        height_mm = self._to_skin(waves, self._height_compliance)
        linear_mm = height_mm if gel.has_rigid_base else height_mm - self._to_skin(waves, self._interface_compliance)
        # An iteration far from the solution may press further than through the gel.
        stiffening = finite_strain_stiffening(height_mm, xp.clip(linear_mm, min=-gel.thickness_mm), gel)
        added = forward_transform(tractions * (stiffening[..., None, :rows, :cols] - 1), shape)
        change_by_pressure_mm = self._to_skin(waves[..., :1, :, :], self.compliance[:1])
        tangential_mm = self._to_skin(waves[..., None, :, :, :], self._tangential_compliance)
        thickening_mm = finite_strain_thickening_mm(
            change_by_pressure_mm, max_over_grid(-linear_mm), gel, self.cells.patch, tangential_mm
        )
        around_mm = gel.finite_strain * thickening_mm + self._to_skin(added[..., 1:, :, :], self.compliance[1:])
        thinning = -linear_mm[..., :rows, :cols] / gel.thickness_mm
        under = xp.zeros_like(linear_mm)
        under[..., :rows, :cols] = xp.clip(thinning / _EDGE_THINNING, min=0, max=1) * (tractions[..., 0, :, :] > 0)
        under_mm = 0.0 if gel.has_rigid_base else -self._to_skin(added, self._interface_compliance)
        nonlinear_mm = around_mm + under * (under_mm - around_mm)
        return DeformedSkin(height_mm, linear_mm + nonlinear_mm, stiffening, nonlinear_mm)

    def thickness_change_mm(self, height_mm: SkinField) -> SkinField:
        """Return the change of the linear gel's thickness where pressure alone gives the skin this height."""
        if self.gel.has_rigid_base:
            return height_mm
        waves = forward_transform(height_mm, self.cells.patch.shape)
        return inverse_transform(waves * self._thickness_share, self.cells.patch.shape, self.cells.patch.shape)

    @cached_property
    def _thickness_share(self) -> Float[Any, "skin_rows half"]:
        """Change of thickness over height by pressure, per wave vector."""
        pressed, sunk = self._skin.fourier_symbols["normal"], -self._skin.interface_symbols[0].real
        share = 1 - np.divide(sunk, pressed, out=np.ones_like(sunk), where=pressed != 0)
        return self._skin.asarray(share)

    def _to_skin(self, waves: Any, compliance: Any) -> SkinField:
        """Return the field of all skin that tractions, given as waves, cause by a compliance."""
        shape = self.cells.patch.shape
        return inverse_transform((waves * compliance).sum(axis=-3), shape, shape)

    def scatter(self, change: SkinField) -> View:
        """Return the change of brightness that the camera observes, after scattering, for a change on all skin."""
        down, across = self.point_spread
        return down @ change @ across


@dataclass(frozen=True)
class InfluenceKernels:
    """Heights due to the traction on single cells, on the view and the skin around it that scatters light into the view."""

    forward: ForwardModel

    @cached_property
    def around(self) -> tuple[int, int]:
        """Numbers of cells of that skin above the view and left of it."""
        cells = self.forward.cells
        wanted = int(np.ceil(_SCATTERING_REACH * self.forward.point_spread_mm / cells.pitch_mm))
        down, across = (
            min(wanted, (skin - view) // 2) for skin, view in zip(cells.patch.shape, cells.shape, strict=True)
        )
        return down, across

    @cached_property
    def skin_indices(self) -> tuple[Int[Array, " rows"], Int[Array, " cols"]]:
        """Row and column indices of that skin in the periodic skin, in spatial order."""
        cells = self.forward.cells
        down, across = (
            np.arange(-beyond, view + beyond) % skin
            for beyond, view, skin in zip(self.around, cells.shape, cells.patch.shape, strict=True)
        )
        return down, across

    @property
    def skin_shape(self) -> tuple[int, int]:
        """Rows and columns of that skin."""
        return len(self.skin_indices[0]), len(self.skin_indices[1])

    def heights_of_cells(self, row: Indices, col: Indices) -> list[Float32[Array, "n skin_rows skin_cols"]]:
        """Return the height of that skin under unit pressure, unit shear along x and unit shear along y on each of these cells."""
        at = influence_window_indices(self.forward.cells, row, col)
        return [windows[at] for windows in self._height_windows]

    def sticking_shear_of_cells(self, row: Indices, col: Indices) -> list[Float32[Array, "n rows cols"]]:
        """Return the shear along x and y on the view that keeps the skin under unit pressure on each of these cells in place."""
        at = influence_window_indices(self.forward.cells, row, col)
        return [windows[at] for windows in self._sticking_windows]

    @cached_property
    def point_spread(self) -> tuple[Float32[Array, "rows skin_rows"], Float32[Array, "skin_cols cols"]]:
        """Weights with which light scatters from that skin into the cells of the view, one axis at a time."""
        (down, across), (rows, cols) = self.forward.point_spread, self.skin_indices
        return np.ascontiguousarray(down[:, rows]), np.ascontiguousarray(across[cols])

    def crop_to_skin(self, values: Float32[Array, "a b"]) -> Float32[Array, "skin_rows skin_cols"]:
        """Return a field of the periodic skin on that skin, in spatial order."""
        return values[np.ix_(*self.skin_indices)]

    @cached_property
    def _height_windows(self) -> list[Float32[Array, "rows cols skin_rows skin_cols"]]:
        return [influence_windows(self.forward.cells, each, self.around) for each in self.forward.compliance]

    @cached_property
    def _sticking_windows(self) -> list[Float32[Array, "rows cols rows cols"]]:
        return [influence_windows(self.forward.cells, each, (0, 0)) for each in self.forward.sticking_shear]


def influence_windows(cells: CellGrid, transfer: Array, around: tuple[int, int]) -> Array:
    """Return the responses to a traction on single cells, as windows into one array, from a transfer function.

    The window at `influence_window_indices` is the response to one cell of the view.
    """
    shape = cells.rows + 2 * around[0], cells.cols + 2 * around[1]
    return sliding_window_view(influence_kernel(cells, transfer, around), shape)


def influence_kernel(cells: CellGrid, transfer: Array, around: tuple[int, int]) -> Float32[Array, "tall wide"]:
    """Return the array of which `influence_windows` are windows."""
    skin, view = cells.patch.shape, cells.shape
    kernel = np.fft.irfft2(transfer, s=skin).astype(np.float32)
    down, across = (np.arange(1 - side - beyond, side + beyond) for side, beyond in zip(view, around, strict=True))
    return kernel[np.ix_(down % skin[0], across % skin[1])]


def influence_window_indices(cells: CellGrid, row: Indices, col: Indices) -> tuple[Indices, Indices]:
    """Return the indices of the windows of these cells; the first window is the last cell's."""
    rows, cols = cells.shape
    return rows - 1 - row, cols - 1 - col


def _gaussian_weights(cells: CellGrid, axis: int, sigma_mm: float) -> Float32[Array, "view skin"]:
    """Return Gaussian weights from every cell of the skin to every one of the view; the identity for zero width."""
    distance_mm = (np.arange(cells.shape[axis])[:, None] - cells.offsets(axis)) * cells.pitch_mm
    width_mm = max(sigma_mm, 1e-3 * cells.pitch_mm)
    reach_mm = np.arange(-200, 201) * cells.pitch_mm
    total = np.exp(-((reach_mm / width_mm) ** 2) / 2).sum()
    weights = np.exp(-((distance_mm / width_mm) ** 2) / 2) / total
    # Far weights would be subnormal numbers, with which processors multiply forty times more slowly.
    return np.where(weights < _SMALLEST_WEIGHT, 0, weights).astype(np.float32)

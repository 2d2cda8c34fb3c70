"""The forward model: tractions → change of the gel's thickness by its compliance → light that scatters into the view.

Tractions are in units of the shear modulus, so that everything here depends on the gel's geometry alone. `ForwardModel` computes
whole fields by Fourier transforms; `InfluenceKernels` gives the response to single cells, from which the inversion builds its
matrices. `ForwardModel` takes single fields or batches, in NumPy or torch (`ForwardModel.like`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

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

PARTS_OF_CELL = 3
"""Number of parts along each side of a cell to which the brightness law is applied."""
_SMALLEST_WEIGHT = 1e-9
_PRESSURE_ALONE = np.array([1, 0, 0], np.float32)[:, None, None]
_EDGE_THINNING = 0.1
"""Thinning over the gel's thickness from which gel under pressure counts wholly as lying under the object. The inversion puts a
little pressure beside the contact, where the gel is thicker; it does not make this gel a part of the contact."""
_SCATTERING_REACH = 3.0
"""Distance, in standard deviations of the point-spread, from which scattered light still reaches the view."""


@runtime_checkable
class Sight(Protocol):
    """How skin was observed along lines of sight (`observation.LinesOfSight`)."""

    def follow(self, field: SkinField, height_mm: SkinField, /) -> SkinField:
        """Return a field of the skin where the lines of sight through the points of its grid meet it."""

    def observe(self, change: View, /) -> View:
        """Return the change of brightness that is observed on the cells, of that on lines of sight."""


@dataclass(frozen=True)
class DeformedSkin:
    """The skin under tractions of the linear gel, and the tractions that a gel at finite strain needs for it."""

    height_mm: SkinField
    thickness_change_mm: SkinField
    """Change of the gel's thickness, including the part due to finite strain."""
    stiffening: SkinField
    """Ratio of the tractions at finite strain to those of the linear gel."""
    linear_mm: SkinField
    """The change of thickness of the linear gel."""


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
    def tangential_compliance(self) -> Complex64[Any, "2 3 skin_rows half"]:
        """Displacement of the skin along x and y over pressure and over shear along x and y, per wave vector."""
        parts = self._skin.fourier_symbols
        along_x = self._on_cells(1j * parts["bulge_x"], parts["xx"], parts["xy"])
        along_y = self._on_cells(1j * parts["bulge_y"], parts["xy"], parts["yy"])
        return array_namespace_of(along_x).stack([along_x, along_y])

    @cached_property
    def _skin(self) -> Skin:
        """The periodic skin of a gel with a shear modulus of one."""
        return Skin(self.cells.patch, replace(self.gel, shear_modulus_mpa=1.0), self.like)

    def _on_cells(self, *symbols: Array) -> Complex64[Any, "symbols skin_rows half"]:
        """Return symbols as one array. Between the middles of cells, tractions follow their Fourier series.

        Tractions that are uniform over each cell would be too smooth, and estimated loads would be too large at their edges.
        """
        waves = np.stack(symbols)
        return self._skin.asarray(waves.real) + 1j * self._skin.asarray(waves.imag)

    @cached_property
    def point_spread(self) -> tuple[Float32[Any, "rows skin_rows"], Float32[Any, "skin_cols cols"]]:
        """Weights with which light scatters from the skin into the cells of the view, one axis at a time."""
        return self._scattering_from([self.cells.offsets(axis) for axis in (0, 1)], 1)

    def _scattering_from(
        self, places: list[Float[Array, " _"]], parts: int
    ) -> tuple[Float32[Any, "rows down"], Float32[Any, "across cols"]]:
        """Return the weights with which light scatters into the view from parts of cells at these places on both axes."""
        # The signal of a cell is the mean over a cell, which is a point spread of variance pitch²/12 on each axis.
        width = float(np.hypot(self.point_spread_mm / self.cells.pitch_mm, 1 / np.sqrt(12)))
        sides = zip(self.cells.shape, places, strict=True)
        down, across = (_gaussian_weights(cells, place, width, parts) for cells, place in sides)
        return self._skin.asarray(down), self._skin.asarray(across.T)

    @cached_property
    def around(self) -> tuple[int, int]:
        """Numbers of cells of the skin above the view and left of it from which light scatters into it."""
        wanted = int(np.ceil(_SCATTERING_REACH * self.point_spread_mm / self.cells.pitch_mm))
        sides = zip(self.cells.patch.shape, self.cells.shape, strict=True)
        down, across = (min(wanted, (skin - view) // 2) for skin, view in sides)
        return down, across

    @cached_property
    def _part_places(self) -> list[Float[Array, " _"]]:
        """Places on both axes of the parts of the cells that scatter light into the view, in cells from its first one."""
        return [
            (np.arange(-beyond * PARTS_OF_CELL, (side + beyond) * PARTS_OF_CELL) + 0.5) / PARTS_OF_CELL - 0.5
            for side, beyond in zip(self.cells.shape, self.around, strict=True)
        ]

    @cached_property
    def _refining(self) -> tuple[Float32[Any, "down skin_rows"], Float32[Any, "skin_cols across"]]:
        """Weights of the interpolation from cells to their parts, one axis at a time."""
        down, across = map(_interpolation_weights, self._part_places, self.cells.patch.shape)
        return self._skin.asarray(down), self._skin.asarray(across.T)

    @cached_property
    def _part_scattering(self) -> tuple[Float32[Any, "rows down"], Float32[Any, "across cols"]]:
        return self._scattering_from(self._part_places, PARTS_OF_CELL)

    def observed_change(self, law: Callable[[SkinField], SkinField], skin: DeformedSkin, sight: Sight | None) -> View:
        """Return the change of brightness that is observed on the cells.

        Brightness has a kink where gel is neither thinner nor thicker, and skin appears displaced by its height. The law is
        therefore applied to parts of cells, where their lines of sight meet the skin, and the image is observed as a camera's is.
        """
        from_rows, from_cols = self._refining
        down, across = self._part_scattering
        thicker_mm = from_rows @ skin.thickness_change_mm @ from_cols
        if sight is None:
            return down @ law(thicker_mm) @ across
        thicker_mm = sight.follow(thicker_mm, from_rows @ skin.height_mm @ from_cols)
        return sight.observe(down @ law(thicker_mm) @ across)

    def slope_per_mm(self, slope_per_mm: Callable[[SkinField], SkinField], skin: DeformedSkin) -> SkinField:
        """Return the derivative of the brightness law on the skin that scatters light into the view, averaged over the parts of
        each cell: the law has a kink, and an iteration that took cells as wholes would jump to and fro across it."""
        from_rows, from_cols = self._refining
        parts = slope_per_mm(from_rows @ skin.thickness_change_mm @ from_cols)
        return from_rows.T @ parts @ from_cols.T / PARTS_OF_CELL**2

    def deform(self, tractions: Tractions) -> DeformedSkin:
        """Return all skin under tractions of the linear gel on the view, with thickness as in `correct_for_finite_strain`."""
        xp, gel, (rows, cols) = array_namespace_of(tractions), self.gel, tractions.shape[-2:]
        linear = self._to_skin(tractions, self._linear_compliances)
        height_mm, by_pressure_mm = linear[..., 0, :, :], linear[..., 2, :, :]
        linear_mm = height_mm - linear[..., 1, :, :]
        # An iteration far from the solution may press further than through the gel.
        stiffening = finite_strain_stiffening(height_mm, xp.clip(linear_mm, min=-gel.thickness_mm), gel)
        thickening_mm = finite_strain_thickening_mm(
            by_pressure_mm, max_over_grid(-linear_mm), gel, self.cells.patch, linear[..., 3:, :, :]
        )
        added = self._to_skin(tractions * (stiffening[..., None, :rows, :cols] - 1), self._added_compliances)
        around_mm, under_mm = gel.finite_strain * thickening_mm + added[..., 0, :, :], -added[..., 1, :, :]
        thinning = -linear_mm[..., :rows, :cols] / gel.thickness_mm
        under = xp.zeros_like(linear_mm)
        under[..., :rows, :cols] = xp.clip(thinning / _EDGE_THINNING, min=0, max=1) * (tractions[..., 0, :, :] > 0)
        nonlinear_mm = around_mm + under * (under_mm - around_mm)
        return DeformedSkin(height_mm, linear_mm + nonlinear_mm, stiffening, linear_mm)

    @cached_property
    def _linear_compliances(self) -> Complex64[Any, "5 3 skin_rows half"]:
        """Height of the skin and of the gel's bottom, change of thickness by pressure alone, and displacement along x and y."""
        by_pressure = self.compliance * self._skin.asarray(_PRESSURE_ALONE)
        each = self._height_compliance, self._interface_compliance, by_pressure, *self.tangential_compliance
        return array_namespace_of(by_pressure).stack(each)

    @cached_property
    def _added_compliances(self) -> Complex64[Any, "2 3 skin_rows half"]:
        """Change of thickness by shear alone, and height of the gel's bottom."""
        by_shear = self.compliance * self._skin.asarray(1 - _PRESSURE_ALONE)
        return array_namespace_of(by_shear).stack([by_shear, self._interface_compliance])

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

    def _to_skin(
        self, tractions: Tractions, compliances: Complex64[Any, "n 3 skin_rows half"]
    ) -> Float32[Any, "*batch n skin_rows skin_cols"]:
        """Return the fields of all skin that tractions cause by each of these compliances."""
        shape = self.cells.patch.shape
        waves = forward_transform(tractions, shape)
        return inverse_transform((waves[..., None, :, :, :] * compliances).sum(axis=-3), shape, shape)

    def scatter(self, change: SkinField) -> View:
        """Return the change of brightness that the camera observes, after scattering, for a change on all skin."""
        down, across = self.point_spread
        return down @ change @ across


@dataclass(frozen=True)
class InfluenceKernels:
    """Heights due to the traction on single cells, on the view and the skin around it that scatters light into the view."""

    forward: ForwardModel

    @cached_property
    def skin_indices(self) -> tuple[Int[Array, " rows"], Int[Array, " cols"]]:
        """Row and column indices of that skin in the periodic skin, in spatial order."""
        cells = self.forward.cells
        down, across = (
            np.arange(-beyond, view + beyond) % skin
            for beyond, view, skin in zip(self.forward.around, cells.shape, cells.patch.shape, strict=True)
        )
        return down, across

    @property
    def skin_shape(self) -> tuple[int, int]:
        """Rows and columns of that skin."""
        return len(self.skin_indices[0]), len(self.skin_indices[1])

    def heights_of_cells(self, row: Indices, col: Indices) -> Float32[Array, "n skin_rows skin_cols"]:
        """Return the height of that skin under unit pressure on each of these cells."""
        rows, cols = self.forward.cells.shape
        return self._height_windows[rows - 1 - row, cols - 1 - col]  # the first window is the last cell's

    def heights_of_shear(self, shear: Float32[Array, "n rows cols"]) -> Float32[Array, "twice_n skin_rows skin_cols"]:
        """Return the height of that skin under each of these fields of shear along x, then under each along y."""
        shape, (rows, cols) = self.forward.cells.patch.shape, self.skin_indices
        waves = forward_transform(shear, shape) * self.forward.compliance[1:, None]
        return inverse_transform(waves, shape, shape)[:, :, rows[:, None], cols].reshape(-1, *self.skin_shape)

    def tangential_between_cells(self, row: Indices, col: Indices) -> Float32[Array, "5 n n"]:
        """Return the displacement of each of these cells (rows) by unit tractions on each of them (columns): along x and along y by
        pressure, along x by shear along x and along y, and along y by shear along y."""
        return self._tangential_kernels.take(places_between_cells(self.forward.cells, row, col), axis=1)

    @cached_property
    def point_spread(self) -> tuple[Float32[Array, "rows skin_rows"], Float32[Array, "skin_cols cols"]]:
        """Weights with which light scatters from that skin into the cells of the view, one axis at a time."""
        (down, across), (rows, cols) = self.forward.point_spread, self.skin_indices
        return np.ascontiguousarray(down[:, rows]), np.ascontiguousarray(across[cols])

    def crop_to_skin(self, values: Float32[Array, "a b"]) -> Float32[Array, "skin_rows skin_cols"]:
        """Return a field of the periodic skin on that skin, in spatial order."""
        return values[np.ix_(*self.skin_indices)]

    @cached_property
    def _height_windows(self) -> Float32[Array, "rows cols skin_rows skin_cols"]:
        """Windows into the response to pressure: one for each cell of the view."""
        kernel = influence_kernel(self.forward.cells, self.forward.compliance[0], self.forward.around)
        return sliding_window_view(kernel, self.skin_shape)

    @cached_property
    def _tangential_kernels(self) -> Float32[Array, "5 places"]:
        """The displacements of `tangential_between_cells` by `places_between_cells`."""
        (by_pressure_x, xx, xy), (by_pressure_y, _, yy) = self.forward.tangential_compliance
        each = by_pressure_x, by_pressure_y, xx, xy, yy
        return np.stack([influence_kernel(self.forward.cells, one, (0, 0)).ravel() for one in each])


def influence_kernel(cells: CellGrid, transfer: Array, around: tuple[int, int]) -> Float32[Array, "tall wide"]:
    """Return the response of a transfer function to a traction on one cell, on the view and so many cells around it wherever in
    the view the cell is. The middle is the response of the cell itself."""
    skin, view = cells.patch.shape, cells.shape
    kernel = np.fft.irfft2(transfer, s=skin).astype(np.float32)
    down, across = (np.arange(1 - side - beyond, side + beyond) for side, beyond in zip(view, around, strict=True))
    return kernel[np.ix_(down % skin[0], across % skin[1])]


def places_between_cells(cells: CellGrid, row: Indices, col: Indices) -> Int[Array, "n n"]:
    """Return where the flattened `influence_kernel` without surroundings has the response of each cell to each (columns)."""
    wide = 2 * cells.cols - 1
    place = row * wide + col
    return np.subtract.outer(place, place - (cells.rows - 1) * wide - cells.cols + 1)


def _gaussian_weights(cells: int, places: Float[Array, " n"], width: float, parts: int) -> Float32[Array, "view n"]:
    """Return Gaussian weights from parts of cells at these places to every cell of the view, in cells from its first one."""
    total = np.exp(-((np.arange(-200, 201) / parts / width) ** 2) / 2).sum()
    weights = np.exp(-(((np.arange(cells)[:, None] - places) / width) ** 2) / 2) / total
    # Far weights would be subnormal numbers, with which processors multiply forty times more slowly.
    return np.where(weights < _SMALLEST_WEIGHT, 0, weights).astype(np.float32)


def _interpolation_weights(places: Float[Array, " n"], cells: int) -> Float32[Array, "n cells"]:
    """Return the weights of cubic convolution from periodic cells to places (Keys 1981; docs/force_physics.md).

    It is exact where the field is a parabola; linear interpolation would make the middle of a ball shallower.
    """
    first, weights = np.floor(places).astype(int) - 1, np.zeros((len(places), cells), np.float32)
    for step in range(4):
        away = np.abs(places - first - step)
        near, far = 1.5 * away**3 - 2.5 * away**2 + 1, -0.5 * away**3 + 2.5 * away**2 - 4 * away + 2
        weights[np.arange(len(places)), (first + step) % cells] += np.where(away < 1, near, far).astype(np.float32)
    return weights

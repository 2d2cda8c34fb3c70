"""The forward model: tractions → heights of the skin by the gel's compliance → light that scatters into the view.

Tractions are in units of the shear modulus, so that everything here depends on the gel's geometry alone. `ForwardModel` computes
whole fields by Fourier transforms; `InfluenceKernels` gives the response to single cells, from which the inversion builds its
matrices.

`identify_substrate` decides from the calibration whether the gel lies on a rigid or on a compliant base. A ball that is pressed in
above a compliant base raises less gel around it. The calibration, which assumes a rigid base, therefore attributes a faint bright
ring to a brightening slope of half the true value. Dents are not affected. In real sensors bulges brighten on average 2.2 times as
steeply as dents darken, so a ratio far below that identifies a compliant base, and the light parameters that it biases are replaced
by typical ones (docs/force_physics.md).
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Complex64, Float32, Int
from numpy import ndarray as Array
from numpy.lib.stride_tricks import sliding_window_view

from ninedtact.design import Gel
from ninedtact.force.traction.cell_grid import CellGrid
from ninedtact.force.traction.observation import BrightnessObservationModel
from ninedtact.mechanics.contact_arrays import forward_transform, inverse_transform
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance, layered_compliance
from ninedtact.mechanics.skin import Skin
from ninedtact.shape.depth import TYPICAL_GLOBAL_DIMMING, TYPICAL_POINT_SPREAD_MM, DepthCurve, GlobalDimmingModel

View = Float32[Array, "rows cols"]
SkinField = Float32[Array, "skin_rows skin_cols"]
Tractions = Float32[Array, "3 rows cols"]
"""Pressure, and shear along x and along y, over the shear modulus."""
Indices = Int[Array, " n"]

_SMALLEST_WEIGHT = 1e-9
_SCATTERING_REACH = 3.0
"""Distance, in standard deviations of the point-spread, from which scattered light still reaches the view."""


@dataclass(frozen=True)
class ForwardModel:
    """Heights as a linear function of tractions, and scattering of light; the brightness law is applied between the two."""

    cells: CellGrid
    thickness_mm: float
    poisson_ratio: float
    point_spread_mm: float
    """Standard deviation of the point-spread; zero where heights are observed."""
    base: Gel | None = None
    """Compliant base below the gel, with its shear modulus relative to that of the gel; None for a rigid base."""

    @cached_property
    def compliance(self) -> Complex64[Array, "3 skin_rows half"]:
        """Height over pressure and over shear along x and y, per wave vector."""
        gel = Gel(self.thickness_mm, 1.0, self.poisson_ratio)
        below = partial(bonded_layer_compliance, gel=gel) if self.base is None else layered_compliance((gel, self.base))
        parts = Skin(self.cells.patch, below, np.zeros(())).fourier_symbols
        up = np.stack([-parts["normal"] + 0j, 1j * parts["bulge_x"], 1j * parts["bulge_y"]])
        # A traction is uniform over its cell: its spectrum is that of a point times the sinc of each axis.
        wave_x, wave_y = self.cells.patch.wave_vectors
        turns = self.cells.pitch_mm / (2 * np.pi)
        return (up * np.sinc(wave_x * turns) * np.sinc(wave_y * turns)).astype(np.complex64)

    @cached_property
    def point_spread(self) -> tuple[Float32[Array, "rows skin_rows"], Float32[Array, "skin_cols cols"]]:
        """Weights with which light scatters from the skin into the cells of the view, one axis at a time."""
        # The signal of a cell is the mean over a cell, which is a point spread of variance pitch²/12 on each axis.
        sigma_mm = float(np.hypot(self.point_spread_mm, self.cells.pitch_mm / np.sqrt(12)))
        down, across = (_gaussian_weights(self.cells, axis, sigma_mm) for axis in (0, 1))
        return down, np.ascontiguousarray(across.T)

    def heights(self, tractions: Tractions) -> SkinField:
        """Return the height in mm of all skin under tractions on the view."""
        shape = self.cells.patch.shape
        waves = forward_transform(tractions, shape)
        return inverse_transform((waves * self.compliance).sum(axis=0), shape, shape)

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


def influence_windows(cells: CellGrid, transfer: Array, around: tuple[int, int]) -> Array:
    """Return the responses to a traction on single cells, as windows into one array, from a transfer function.

    The window at `influence_window_indices` is the response to one cell of the view.
    """
    skin, view = cells.patch.shape, cells.shape
    kernel = np.fft.irfft2(transfer, s=skin).astype(np.float32)
    down, across = (np.arange(1 - side - beyond, side + beyond) for side, beyond in zip(view, around, strict=True))
    shape = view[0] + 2 * around[0], view[1] + 2 * around[1]
    return sliding_window_view(kernel[np.ix_(down % skin[0], across % skin[1])], shape)


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


TYPICAL_SLOPE_RATIO = 2.2
"""Slope of bulges over the mean slope of dents: geometric mean of eight real sensors of five labs, which range from 1.8 to 2.9."""
COMPLIANT_BASE = Gel(6.0, 10.0)
"""Transparent layer of Shore A 45 that is moulded under a gel of Shore A 5; its modulus is relative to that of the gel."""

_MIN_RIGID_SLOPE_RATIO = 1.4
"""Smallest ratio for a rigid base: `TYPICAL_SLOPE_RATIO` less three standard deviations of its logarithm (0.15)."""


@dataclass(frozen=True)
class Substrate:
    """The base that the gel lies on, and the observation model that is valid above it."""

    observation_model: BrightnessObservationModel
    base: Gel | None = None
    """Compliant base with its shear modulus relative to that of the gel; None for a rigid base."""


def identify_substrate(observation_model: BrightnessObservationModel) -> Substrate:
    """Return the base, rigid or compliant, that the calibration's slopes of bulges and dents indicate.

    A rigid base comes with the calibration as it is, a compliant one with typical light parameters.
    """
    ratio = bulge_to_dent_slope_ratio(observation_model.curve)
    if ratio >= _MIN_RIGID_SLOPE_RATIO:
        return Substrate(observation_model)
    raised = TYPICAL_SLOPE_RATIO / ratio
    curve = observation_model.curve
    curve = replace(curve, brightening=tuple(raised * bright for bright in curve.brightening))
    return Substrate(
        BrightnessObservationModel(curve, GlobalDimmingModel(TYPICAL_GLOBAL_DIMMING), TYPICAL_POINT_SPREAD_MM),
        COMPLIANT_BASE,
    )


def bulge_to_dent_slope_ratio(curve: DepthCurve) -> float:
    """Return the slope of bulges over the mean slope of dents."""
    dents = curve.darkening[-1] / curve.indentation_mm[-1]
    return curve.brightening[-1] / curve.bulge_mm[-1] / dents

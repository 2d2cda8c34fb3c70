"""The skin as a linear elastic surface on a periodic square grid: Fourier operators from tractions to displacements, on the whole
grid or a part of it.

Beyond the sensing area the grid is padded, so that what leaves on one side and enters on the other is too faint to
matter: in an incompressible layer it falls off with a length of about the thickness (docs/mechanics.md has figures).

On a part of the grid the transform is twice as large as the field along each axis, or that of the whole grid where this is smaller,
and its kernel is cut from that of the whole grid. The part then yields exactly what the whole grid yields for tractions that are
zero outside the part, and a small contact costs a small transform.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.errors import InputError
from ninedtact.mechanics.layer_compliance import Compliance, ComplianceFunction, gel_compliance
from ninedtact.mechanics.numpy_or_torch_arrays import (
    ContactIndices,
    array_namespace_of,
    forward_transform,
    inverse_transform,
    take_contacts,
)

_MIN_POINTS_PER_SIDE = 8


@dataclass(frozen=True)
class PeriodicGrid:
    """A square grid centred on the sensor's origin; `InputError` below 8 x 8 points or without a positive pitch."""

    rows: int
    cols: int
    pitch_mm: float

    def __post_init__(self) -> None:
        if min(self.rows, self.cols) < _MIN_POINTS_PER_SIDE or not self.pitch_mm > 0:
            raise InputError(
                expected=f"a grid of at least {_MIN_POINTS_PER_SIDE} x {_MIN_POINTS_PER_SIDE} points with a pitch "
                "above zero",
                got=f"{self.rows} x {self.cols} points with a pitch of {self.pitch_mm} mm",
                remedy="give a finer pitch or a larger area",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """The number of points as (rows, cols)."""
        return self.rows, self.cols

    @property
    def width_mm(self) -> float:
        """The length of one period along x, which is the sum of the cells."""
        return self.cols * self.pitch_mm

    @property
    def height_mm(self) -> float:
        """The length of one period along y, which is the sum of the cells."""
        return self.rows * self.pitch_mm

    @property
    def cell_area_mm2(self) -> float:
        """The area of one grid cell."""
        return self.pitch_mm**2

    @cached_property
    def positions_mm(self) -> Float[Array, "2 rows cols"]:
        """The (x, y) of every point in the sensor's frame."""
        axes = [(np.arange(samples) - (samples - 1) / 2) * self.pitch_mm for samples in (self.cols, self.rows)]
        return np.stack(np.meshgrid(*axes))

    @cached_property
    def wave_vectors(self) -> tuple[Float[Array, "rows half"], Float[Array, "rows half"]]:
        """The (k_x, k_y) of every entry of the transform, in 1/mm."""
        turn = 2 * np.pi / self.pitch_mm
        kx, ky = np.meshgrid(np.fft.rfftfreq(self.cols) * turn, np.fft.fftfreq(self.rows) * turn)
        return kx, ky

    @cached_property
    def wave_directions(self) -> tuple[Float[Array, "rows half"], Float[Array, "rows half"]]:
        """The unit vector (k_x, k_y) / |k| of every entry of the transform.

        The highest wave of an even grid has no direction along its axis. A zero there keeps fields real, and makes even and
        odd grids agree.
        """
        kx, ky = (wave.copy() for wave in self.wave_vectors)
        if self.cols % 2 == 0:
            kx[:, -1] = 0
        if self.rows % 2 == 0:
            ky[self.rows // 2] = 0
        length = np.hypot(*self.wave_vectors)
        length[0, 0] = 1
        return kx / length, ky / length


def padded_grid(width_mm: float, height_mm: float, pitch_mm: float, margin_mm: float) -> PeriodicGrid:
    """Return the smallest grid of a quickly transformed size that has at least this margin on every side of the area."""
    from scipy.fft import next_fast_len

    sides = [int(np.ceil((side + 2 * margin_mm) / pitch_mm)) for side in (height_mm, width_mm)]
    rows, cols = (next_fast_len(side, real=True) for side in sides)
    return PeriodicGrid(rows, cols, pitch_mm)


ScalarField = Float[Any, "*batch rows cols"]
VectorField = Float[Any, "*batch 2 rows cols"]
PointMask = Bool[Any, "*batch rows cols"]


@dataclass(frozen=True)
class DisplacementOperators:
    """Operators from tractions on a grid to displacements of the skin.

    Every Fourier symbol is complex, because a product of complex and real arrays would convert the real one first. The names N,
    L, S and M are those of `layer_compliance`.
    """

    normal: Any
    """N: from pressure to inward displacement."""
    bulge: Any
    """−i M e (2 entries): from shear to outward displacement, and from pressure to tangential displacement."""
    tangential: tuple[Any, Any]
    """L e eᵀ + S (1 − e eᵀ): its entries xx and yy (2 entries), and xy."""
    shape: tuple[int, int]
    """The (rows, cols) of the transform."""
    field_shape: tuple[int, int]
    """The (rows, cols) of the fields."""
    max_normal_compliance_mm_per_mpa: Any
    """The largest compliance to pressure; for a batch of skins one for each, (batch, 1, 1)."""
    max_shear_compliance_mm_per_mpa: Any
    """The largest compliance to shear; for a batch of skins one for each, (batch, 1, 1, 1)."""
    inside: Any = None
    """One where the displacement is wanted and zero elsewhere, (batch, rows, cols), so that contacts with different active
    regions form one batch. None: wanted everywhere."""

    def select(self, indices: ContactIndices) -> "DisplacementOperators":
        """Return the operators of these contacts of a batch."""
        if self.normal.ndim == 2:
            return self
        symbols = (take_contacts(part, indices) for part in (self.normal, self.bulge, *self.tangential))
        normal, bulge, diagonal, crossed = symbols
        rest = self.max_normal_compliance_mm_per_mpa, self.max_shear_compliance_mm_per_mpa, self.inside
        each = (take_contacts(one, indices) for one in rest)
        return DisplacementOperators(normal, bulge, (diagonal, crossed), self.shape, self.field_shape, *each)

    @cached_property
    def xp(self) -> Any:
        """The array API namespace of the symbols."""
        return array_namespace_of(self.normal)

    def first_step_lengths(self, none: Any) -> tuple[Any, Any]:
        """Return the lengths of first gradient steps for pressure, (…, 1, 1), and shear, (…, 1, 1, 1), in MPa per mm.

        They are four over the largest compliance. none: a zero for each contact, (…, 1, 1).
        """
        normal, shear = self.max_normal_compliance_mm_per_mpa, self.max_shear_compliance_mm_per_mpa
        return none + 4 / normal, none[..., None] + 4 / shear

    def indentation_from_pressure_mm(self, pressure: ScalarField) -> ScalarField:
        """Return the inward displacement −u_z by pressure, in mm."""
        return self._to_space(self._to_waves(pressure) * self.normal)

    def bulge_from_shear_mm(self, shear: VectorField) -> ScalarField:
        """Return the outward displacement by shear, in mm: the bulge before a dragged object and the hollow behind it."""
        turned = self._to_waves(shear) * self.bulge
        return self._to_space(turned[..., 0, :, :] + turned[..., 1, :, :])

    def tangential_from_pressure_mm(self, pressure: ScalarField) -> VectorField:
        """Return the tangential displacement (u_x, u_y) by pressure, in mm."""
        return self._to_space(self._to_waves(pressure)[..., None, :, :] * self.bulge)

    def tangential_from_shear_mm(self, shear: VectorField) -> VectorField:
        """Return the tangential displacement (u_x, u_y) by shear, in mm."""
        return self._to_space(self._apply_tangential_block(self._to_waves(shear)))

    def displacement_mm(self, pressure: ScalarField, shear: VectorField) -> tuple[ScalarField, VectorField]:
        """Return the displacements u_z and (u_x, u_y) by pressure and shear together, in mm."""
        pressed, sheared = self._to_waves(pressure), self._to_waves(shear)
        turned = sheared * self.bulge
        upward = turned[..., 0, :, :] + turned[..., 1, :, :] - pressed * self.normal
        tangential = self._apply_tangential_block(sheared) + pressed[..., None, :, :] * self.bulge
        return self._to_space(upward), self._to_space(tangential)

    def _apply_tangential_block(self, wave: Any) -> Any:
        """Return the product with the 2 × 2 block L e eᵀ + S (1 − e eᵀ) in Fourier space."""
        diagonal, crossed = self.tangential
        product = wave * diagonal
        product[..., 0, :, :] += wave[..., 1, :, :] * crossed
        product[..., 1, :, :] += wave[..., 0, :, :] * crossed
        return product

    def _to_waves(self, field: Any) -> Any:
        return forward_transform(field, self.shape)

    def _to_space(self, wave: Any) -> Any:
        """Return the field of a transform without padding; it is zero outside `inside`."""
        field = inverse_transform(wave, self.shape, self.field_shape)
        if self.inside is None:
            return field
        return field * (self.inside if field.ndim == self.inside.ndim else self.inside[..., None, :, :])


@dataclass(frozen=True)
class Skin:
    """A periodic grid on a gel; fields have the array library, precision and device of `like`."""

    grid: PeriodicGrid
    gel: Gel
    like: Any = field(default_factory=lambda: np.zeros((), np.float32), compare=False)
    compliance_of: ComplianceFunction = gel_compliance
    """The compliance of the gel; that of a half-space has no base."""

    def asarray(self, values: Array) -> Any:
        """Return the values as an array in the library, precision and device of this skin."""
        if isinstance(self.like, np.ndarray):
            return np.ascontiguousarray(values, self.like.dtype)
        xp = array_namespace_of(self.like)
        return xp.asarray(np.ascontiguousarray(values), dtype=self.like.dtype, device=device(self.like))

    @cached_property
    def positions_mm(self) -> VectorField:
        """The (x, y) of every point as one array."""
        return self.asarray(self.grid.positions_mm)

    @cached_property
    def coordinates_mm(self) -> tuple[Any, Any]:
        """The x and the y of every point as two contiguous arrays."""
        return self.asarray(self.grid.positions_mm[0]), self.asarray(self.grid.positions_mm[1])

    @cached_property
    def shift_wave_numbers(self) -> tuple[Any, Any]:
        """The k_x (1, half) and k_y (rows, 1) that shift a field, in 1/mm; zero for the highest wave of an even grid."""
        length = np.hypot(*self.grid.wave_vectors)
        along, across = (unit * length for unit in self.grid.wave_directions)
        return self.asarray(along[:1]), self.asarray(across[:, :1])

    @cached_property
    def fourier_symbols(self) -> dict[str, Array]:
        """The factors of the transform of a traction: normal, xx, xy and yy, and bulge_x and bulge_y to be multiplied by i."""
        (e_x, e_y), compliance = self.grid.wave_directions, self._compliance
        difference = compliance.along - compliance.across
        return {
            "normal": compliance.normal,
            "bulge_x": -compliance.coupling * e_x,
            "bulge_y": -compliance.coupling * e_y,
            "xx": compliance.across + difference * e_x**2,
            "xy": difference * e_x * e_y,
            "yy": compliance.across + difference * e_y**2,
        }

    @cached_property
    def interface_symbols(self) -> tuple[Array, Array, Array]:
        """The factors of the transforms of pressure and of both shears that give the height of the gel's bottom, complex."""
        (e_x, e_y), compliance = self.grid.wave_directions, self._compliance
        bulge = -1j * compliance.interface_coupling
        return -compliance.interface_normal + 0j, bulge * e_x, bulge * e_y

    @cached_property
    def _compliance(self) -> Compliance:
        return self.compliance_of(np.hypot(*self.grid.wave_vectors), self.gel)

    @cached_property
    def _interface_arrays(self) -> tuple[Any, Any]:
        """The factors of the transform of pressure and, (2 entries), of that of shear, in the arrays of this skin."""
        pressure, *shear = (
            self.asarray(symbol.real) + 1j * self.asarray(symbol.imag) for symbol in self.interface_symbols
        )
        return pressure, array_namespace_of(pressure).stack(shear)

    def interface_height_mm(self, pressure: ScalarField, shear: VectorField | None = None) -> ScalarField:
        """Return the displacement of the gel's bottom along z under tractions on the skin, in mm; zero on a rigid base.

        shear: None for pressure alone.
        """
        if self.gel.has_rigid_base:
            return 0 * pressure
        from_pressure, from_shear = self._interface_arrays
        wave = forward_transform(pressure, self.grid.shape) * from_pressure
        if shear is not None:
            sheared = forward_transform(shear, self.grid.shape) * from_shear
            wave = wave + sheared[..., 0, :, :] + sheared[..., 1, :, :]
        return inverse_transform(wave, self.grid.shape, self.grid.shape)

    def thickness_change_by_pressure_mm(self, pressure: ScalarField) -> ScalarField:
        """Return the change of the gel's thickness by pressure alone, in mm, which is negative where it gets thinner."""
        wave = forward_transform(pressure, self.grid.shape) * self._thickness_by_pressure
        return inverse_transform(wave, self.grid.shape, self.grid.shape)

    @cached_property
    def _thickness_by_pressure(self) -> Any:
        """The factor of the transform of pressure that gives the change of the gel's thickness, in the arrays of this skin."""
        return -self.operators.normal - (0 if self.gel.has_rigid_base else self._interface_arrays[0])

    @cached_property
    def operators(self) -> DisplacementOperators:
        """The operators of the whole periodic grid."""
        return self._operators_from_symbols(self.fourier_symbols, self.grid.shape, self.grid.shape)

    def cropped_operators(self, rows: int, cols: int) -> DisplacementOperators:
        """Return the operators on a part of this many points, kept for the next call.

        They yield what the whole grid yields for tractions that are zero outside the part.
        """
        if (rows, cols) not in self._operators_by_shape:
            self._operators_by_shape[rows, cols] = self.build_cropped_operators(rows, cols)
        return self._operators_by_shape[rows, cols]

    def build_cropped_operators(self, rows: int, cols: int) -> DisplacementOperators:
        """Build the operators on a part of this many points from the kernels of the whole grid."""
        from scipy.fft import next_fast_len

        shape = min(next_fast_len(2 * rows - 1), self.grid.rows), min(2 * next_fast_len(cols), self.grid.cols)
        waves = {
            name: np.fft.rfft2(_crop_kernel(kernel, (rows, cols), shape)) for name, kernel in self._kernels.items()
        }
        symbols = {name: wave.imag if "bulge" in name else wave.real for name, wave in waves.items()}
        return self._operators_from_symbols(symbols, shape, (rows, cols))

    @cached_property
    def _operators_by_shape(self) -> dict[tuple[int, int], DisplacementOperators]:
        """The operators on parts of the grid that were built so far."""
        return {}

    @cached_property
    def _kernels(self) -> dict[str, Float[Array, "rows cols"]]:
        """The symbols in space: displacement by a traction on one cell. The bulges are odd, all others are even."""
        turned = {name: 1j * s if "bulge" in name else s for name, s in self.fourier_symbols.items()}
        return {name: np.fft.irfft2(s, s=self.grid.shape) for name, s in turned.items()}

    def _operators_from_symbols(
        self, symbols: dict[str, Array], shape: tuple[int, int], field_shape: tuple[int, int]
    ) -> DisplacementOperators:
        part = {name: self.asarray(symbol) + 0j for name, symbol in symbols.items()}
        stack = array_namespace_of(part["normal"]).stack
        bulge, diagonal = 1j * stack((part["bulge_x"], part["bulge_y"])), stack((part["xx"], part["yy"]))
        softest = (
            float(np.abs(symbols["normal"]).max()),
            float(max(np.abs(symbols[name]).max() for name in ("xx", "yy"))),
        )
        return DisplacementOperators(part["normal"], bulge, (diagonal, part["xy"]), shape, field_shape, *softest)


def gel_skin(grid: PeriodicGrid, gel: Gel, like: Any = None) -> Skin:
    """Return the skin of a gel; `like` as in `Skin`, by default a NumPy array in single precision."""
    return Skin(grid, gel, np.zeros((), np.float32) if like is None else like)


def _crop_kernel(
    kernel: Float[Array, "rows cols"], reach: tuple[int, int], shape: tuple[int, int]
) -> Float[Array, "n m"]:
    """Return a periodic kernel at offsets up to `reach` cells, laid out for a transform of another shape."""
    offsets = [np.arange(1 - cells, cells) for cells in reach]
    cut = np.zeros(shape)
    cut[np.ix_(offsets[0] % shape[0], offsets[1] % shape[1])] = kernel[
        np.ix_(offsets[0] % kernel.shape[0], offsets[1] % kernel.shape[1])
    ]
    return cut

"""From tractions to displacements by Fourier multiplication: one set of operators, for the whole periodic patch or for a
window of it.

In a window the transform is twice as large as the field and its kernel is cut from the patch's own, so that a window
answers exactly as the patch does with zeros around; a small contact then costs a small transform.

The skin: a patch of a grid with the compliance of what lies below it.

Beyond the sensing area the patch is padded, so that what leaves on one side and enters on the other is too faint to
matter: in an incompressible layer it falls off with a length of about the thickness (docs/mechanics.md has figures).
"""

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.array_namespace import array_namespace_of, forward_transform, inverse_transform
from ninedtact.mechanics.batching import ContactIndices, take_contacts
from ninedtact.mechanics.layer_compliance import ComplianceFunction, bonded_layer_compliance
from ninedtact.mechanics.periodic_grid import PeriodicGrid

ScalarField = Float[Any, "*batch rows cols"]
VectorField = Float[Any, "*batch 2 rows cols"]
PointMask = Bool[Any, "*batch rows cols"]


@dataclass(frozen=True)
class DisplacementOperators:
    """What the skin does under tractions on a grid. Every symbol is complex: complex times real would be converted first."""

    normal: Any
    """N: pressure → inward displacement."""
    bulge: Any
    """−i M e (2 entries): shear → outward displacement, and pressure → tangential displacement."""
    tangential: tuple[Any, Any]
    """L e eᵀ + S (1 − e eᵀ): xx and yy (2 entries), and xy."""
    shape: tuple[int, int]
    """Of the transform."""
    field_shape: tuple[int, int]
    """Of the fields."""
    softest_mm_per_mpa: Any
    """The largest compliance to shear; of a batch of skins, one for each, (batch, 1, 1, 1)."""
    inside: Any = None
    """One where the answer is wanted and zero elsewhere, (batch, rows, cols): what a window cuts off, as wide as the patch, so
    that contacts with windows of their own are one batch. None: everywhere."""

    def of(self, chosen: ContactIndices) -> "DisplacementOperators":
        """For the chosen contacts of a batch."""
        if self.normal.ndim == 2:
            return self
        symbols = (take_contacts(part, chosen) for part in (self.normal, self.bulge, *self.tangential))
        normal, bulge, diagonal, crossed = symbols
        rest = take_contacts(self.softest_mm_per_mpa, chosen), take_contacts(self.inside, chosen)
        return DisplacementOperators(normal, bulge, (diagonal, crossed), self.shape, self.field_shape, *rest)

    @cached_property
    def xp(self) -> Any:
        """The array library that all this is done with."""
        return array_namespace_of(self.normal)

    def sunk_mm(self, pressure: ScalarField) -> ScalarField:
        """Inward displacement by pressure, −u_z."""
        return self.back(self.wave(pressure) * self.normal)

    def raised_mm(self, shear: VectorField) -> ScalarField:
        """Outward displacement by shear: the bulge before a dragged object and the hollow behind it."""
        turned = self.wave(shear) * self.bulge
        return self.back(turned[..., 0, :, :] + turned[..., 1, :, :])

    def spread_mm(self, pressure: ScalarField) -> VectorField:
        """Tangential displacement by pressure."""
        return self.back(self.wave(pressure)[..., None, :, :] * self.bulge)

    def slid_mm(self, shear: VectorField) -> VectorField:
        """Tangential displacement by shear."""
        return self.back(self.sheared(self.wave(shear)))

    def displaced_mm(self, pressure: ScalarField, shear: VectorField) -> tuple[ScalarField, VectorField]:
        """u_z and (u_x, u_y) by both."""
        pressed, dragged = self.wave(pressure), self.wave(shear)
        turned = dragged * self.bulge
        upward = turned[..., 0, :, :] + turned[..., 1, :, :] - pressed * self.normal
        return self.back(upward), self.back(self.sheared(dragged) + pressed[..., None, :, :] * self.bulge)

    def sheared(self, wave: Any) -> Any:
        """The tangential 2 × 2 block in Fourier space."""
        diagonal, crossed = self.tangential
        return wave * diagonal + self.xp.flip(wave, axis=-3) * crossed

    def wave(self, field: Any) -> Any:
        """Into Fourier space, zeros around."""
        return forward_transform(field, self.shape)

    def back(self, wave: Any) -> Any:
        """Out of it, the padding cut off."""
        field = inverse_transform(wave, self.shape, self.field_shape)
        if self.inside is None:
            return field
        return field * (self.inside if field.ndim == self.inside.ndim else self.inside[..., None, :, :])


def _crop_kernel(
    kernel: Float[Array, "rows cols"], reach: tuple[int, int], shape: tuple[int, int]
) -> Float[Array, "n m"]:
    """A periodic kernel at offsets up to `reach` cells, laid out for a transform of another shape."""
    offsets = [np.arange(1 - cells, cells) for cells in reach]
    cut = np.zeros(shape)
    cut[np.ix_(offsets[0] % shape[0], offsets[1] % shape[1])] = kernel[np.ix_(*offsets)]
    return cut


@dataclass(frozen=True)
class Skin:
    """A patch with its compliance, in the array library, precision and device of `like`."""

    patch: PeriodicGrid
    compliance_of: ComplianceFunction
    like: Any = field(default_factory=lambda: np.zeros((), np.float32), compare=False)
    thickness_mm: float = np.inf
    """Of all that yields; no object is pressed as deep. Infinite where nothing is said of a base."""

    def asarray(self, values: Array) -> Any:
        """Numbers as an array like those of this skin."""
        if isinstance(self.like, np.ndarray):
            return np.ascontiguousarray(values, self.like.dtype)
        xp = array_namespace_of(self.like)
        return xp.asarray(np.ascontiguousarray(values), dtype=self.like.dtype, device=device(self.like))

    @cached_property
    def place_mm(self) -> VectorField:
        """(x, y) of every point."""
        return self.asarray(self.patch.place_mm)

    @cached_property
    def waves(self) -> tuple[Any, Any]:
        """k_x (1, half) and k_y (rows, 1) of the transform's entries, 1/mm; zero for the highest of an even grid."""
        length = np.hypot(*self.patch.waves)
        along, across = (unit * length for unit in self.patch.unit_waves)
        return self.asarray(along[:1]), self.asarray(across[:, :1])

    @cached_property
    def places_mm(self) -> tuple[Any, Any]:
        """x and y of every point, apart and whole in memory."""
        return self.asarray(self.patch.place_mm[0]), self.asarray(self.patch.place_mm[1])

    @cached_property
    def symbols(self) -> dict[str, Array]:
        """What the transform of a traction is multiplied by: N, xx, xy, yy, and by i times bulge_x, bulge_y."""
        (e_x, e_y), answer = self.patch.unit_waves, self.compliance_of(np.hypot(*self.patch.waves))
        difference = answer.along - answer.across
        return {
            "normal": answer.normal,
            "bulge_x": -answer.coupling * e_x,
            "bulge_y": -answer.coupling * e_y,
            "xx": answer.across + difference * e_x**2,
            "xy": difference * e_x * e_y,
            "yy": answer.across + difference * e_y**2,
        }

    @cached_property
    def response(self) -> DisplacementOperators:
        """Of the whole patch, periodic."""
        return self.response_of(self.symbols, self.patch.shape, self.patch.shape)

    def response_of(
        self, symbols: dict[str, Array], shape: tuple[int, int], field_shape: tuple[int, int]
    ) -> DisplacementOperators:
        """Operators from their symbols."""
        part = {name: self.asarray(symbol) + 0j for name, symbol in symbols.items()}
        stack = array_namespace_of(part["normal"]).stack
        bulge, diagonal = 1j * stack((part["bulge_x"], part["bulge_y"])), stack((part["xx"], part["yy"]))
        softest = float(array_namespace_of(diagonal).max(abs(diagonal)))
        return DisplacementOperators(part["normal"], bulge, (diagonal, part["xy"]), shape, field_shape, softest)

    @cached_property
    def kernels(self) -> dict[str, Float[Array, "rows cols"]]:
        """The symbols in space: displacement by a traction on one cell. All are even, but for the bulges, which are odd."""
        turned = {name: 1j * s if "bulge" in name else s for name, s in self.symbols.items()}
        return {name: np.fft.irfft2(s, s=self.patch.shape) for name, s in turned.items()}

    @cached_property
    def windows(self) -> dict[tuple[int, int], DisplacementOperators]:
        """Those made so far."""
        return {}

    def window(self, rows: int, cols: int) -> DisplacementOperators:
        """Operators on a window of this many points; the whole patch's answer to tractions that are zero outside it."""
        if (rows, cols) not in self.windows:
            self.windows[rows, cols] = self.new_window(rows, cols)
        return self.windows[rows, cols]

    def new_window(self, rows: int, cols: int) -> DisplacementOperators:
        """Kernels cut out of the patch's and transformed: even ones to real numbers, odd ones to imaginary ones."""
        from scipy.fft import next_fast_len

        shape = next_fast_len(2 * rows - 1), 2 * next_fast_len(cols)
        waves = {name: np.fft.rfft2(_crop_kernel(kernel, (rows, cols), shape)) for name, kernel in self.kernels.items()}
        symbols = {name: wave.imag if "bulge" in name else wave.real for name, wave in waves.items()}
        return self.response_of(symbols, shape, (rows, cols))


def gel_skin(patch: PeriodicGrid, gel: Gel, like: Any = None) -> Skin:
    """The skin of a gel on a rigid base; `like` as in `Skin`, single precision of NumPy unless said otherwise."""
    return Skin(
        patch,
        partial(bonded_layer_compliance, gel=gel),
        np.zeros((), np.float32) if like is None else like,
        gel.thickness_mm,
    )

"""The skin: a patch of a grid with the compliance of what lies below it.

Beyond the sensing area the patch is padded, so that what leaves on one side and enters on the other is too faint to
matter: in an incompressible layer it falls off with a length of about the thickness (docs/mechanics.md has figures).
"""

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.mechanics.gel import ComplianceOf, bonded_layer
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.patch import Patch
from ninedtact.mechanics.response import Response, Vectors, cut_out


@dataclass(frozen=True)
class Skin:
    """A patch with its compliance, in the array library, precision and device of `like`."""

    patch: Patch
    compliance_of: ComplianceOf
    like: Any = field(default_factory=lambda: np.zeros((), np.float32), compare=False)
    thickness_mm: float = np.inf
    """Of all that yields; no object is pressed as deep. Infinite where nothing is said of a base."""

    def asarray(self, values: Array) -> Any:
        """Numbers as an array like those of this skin."""
        if isinstance(self.like, np.ndarray):
            return np.ascontiguousarray(values, self.like.dtype)
        xp = library_of(self.like)
        return xp.asarray(np.ascontiguousarray(values), dtype=self.like.dtype, device=device(self.like))

    @cached_property
    def place_mm(self) -> Vectors:
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
    def response(self) -> Response:
        """Of the whole patch, periodic."""
        return self.response_of(self.symbols, self.patch.shape, self.patch.shape)

    def response_of(self, symbols: dict[str, Array], shape: tuple[int, int], field_shape: tuple[int, int]) -> Response:
        """Operators from their symbols."""
        part = {name: self.asarray(symbol) + 0j for name, symbol in symbols.items()}
        stack = library_of(part["normal"]).stack
        bulge, diagonal = 1j * stack((part["bulge_x"], part["bulge_y"])), stack((part["xx"], part["yy"]))
        softest = float(library_of(diagonal).max(abs(diagonal)))
        return Response(part["normal"], bulge, (diagonal, part["xy"]), shape, field_shape, softest)

    @cached_property
    def kernels(self) -> dict[str, Float[Array, "rows cols"]]:
        """The symbols in space: displacement by a traction on one cell. All are even, but for the bulges, which are odd."""
        turned = {name: 1j * s if "bulge" in name else s for name, s in self.symbols.items()}
        return {name: np.fft.irfft2(s, s=self.patch.shape) for name, s in turned.items()}

    @cached_property
    def windows(self) -> dict[tuple[int, int], Response]:
        """Those made so far."""
        return {}

    def window(self, rows: int, cols: int) -> Response:
        """Operators on a window of this many points; the whole patch's answer to tractions that are zero outside it."""
        if (rows, cols) not in self.windows:
            self.windows[rows, cols] = self.new_window(rows, cols)
        return self.windows[rows, cols]

    def new_window(self, rows: int, cols: int) -> Response:
        """Kernels cut out of the patch's and transformed: even ones to real numbers, odd ones to imaginary ones."""
        from scipy.fft import next_fast_len

        shape = next_fast_len(2 * rows - 1), 2 * next_fast_len(cols)
        waves = {name: np.fft.rfft2(cut_out(kernel, (rows, cols), shape)) for name, kernel in self.kernels.items()}
        symbols = {name: wave.imag if "bulge" in name else wave.real for name, wave in waves.items()}
        return self.response_of(symbols, shape, (rows, cols))


def gel_skin(patch: Patch, gel: Gel, like: Any = None) -> Skin:
    """The skin of a gel on a rigid base; `like` as in `Skin`, single precision of NumPy unless said otherwise."""
    return Skin(
        patch, partial(bonded_layer, gel=gel), np.zeros((), np.float32) if like is None else like, gel.thickness_mm
    )

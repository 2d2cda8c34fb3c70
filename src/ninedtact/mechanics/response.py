"""From tractions to displacements by Fourier multiplication: one set of operators, for the whole periodic patch or for a
window of it.

In a window the transform is twice as large as the field and its kernel is cut from the patch's own, so that a window
answers exactly as the patch does with zeros around; a small contact then costs a small transform.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from ninedtact.mechanics.halving import Chosen, some
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.transform import field_of, spectrum

Field = Float[Any, "*batch rows cols"]
Vectors = Float[Any, "*batch 2 rows cols"]
Points = Bool[Any, "*batch rows cols"]


@dataclass(frozen=True)
class Response:
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

    def of(self, chosen: Chosen) -> "Response":
        """For the chosen contacts of a batch."""
        if self.normal.ndim == 2:
            return self
        symbols = (some(part, chosen) for part in (self.normal, self.bulge, *self.tangential))
        normal, bulge, diagonal, crossed = symbols
        rest = some(self.softest_mm_per_mpa, chosen), some(self.inside, chosen)
        return Response(normal, bulge, (diagonal, crossed), self.shape, self.field_shape, *rest)

    @cached_property
    def xp(self) -> Any:
        """The array library that all this is done with."""
        return library_of(self.normal)

    def sunk_mm(self, pressure: Field) -> Field:
        """Inward displacement by pressure, −u_z."""
        return self.back(self.wave(pressure) * self.normal)

    def raised_mm(self, shear: Vectors) -> Field:
        """Outward displacement by shear: the bulge before a dragged object and the hollow behind it."""
        turned = self.wave(shear) * self.bulge
        return self.back(turned[..., 0, :, :] + turned[..., 1, :, :])

    def spread_mm(self, pressure: Field) -> Vectors:
        """Tangential displacement by pressure."""
        return self.back(self.wave(pressure)[..., None, :, :] * self.bulge)

    def slid_mm(self, shear: Vectors) -> Vectors:
        """Tangential displacement by shear."""
        return self.back(self.sheared(self.wave(shear)))

    def displaced_mm(self, pressure: Field, shear: Vectors) -> tuple[Field, Vectors]:
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
        return spectrum(field, self.shape)

    def back(self, wave: Any) -> Any:
        """Out of it, the padding cut off."""
        field = field_of(wave, self.shape, self.field_shape)
        if self.inside is None:
            return field
        return field * (self.inside if field.ndim == self.inside.ndim else self.inside[..., None, :, :])


def cut_out(kernel: Float[Array, "rows cols"], reach: tuple[int, int], shape: tuple[int, int]) -> Float[Array, "n m"]:
    """A periodic kernel at offsets up to `reach` cells, laid out for a transform of another shape."""
    offsets = [np.arange(1 - cells, cells) for cells in reach]
    cut = np.zeros(shape)
    cut[np.ix_(offsets[0] % shape[0], offsets[1] % shape[1])] = kernel[np.ix_(*offsets)]
    return cut

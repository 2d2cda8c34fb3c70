"""Pictures of many contacts at once, in the array library of their skin: what a GPU draws data sets with.

The same steps as `simulation.picture.Renderer`, which draws one picture with OpenCV and is what this is tested against: seen
height on the plane, law of light, point-spread, loss, lens. Noise and 8 bits are left to whoever stores the pictures.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Float

from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.per_contact import over_grid
from ninedtact.mechanics.transform import field_of, spectrum
from ninedtact.simulation.picture import Renderer
from ninedtact.simulation.seeing import FINER, STEPS

Fields = Float[Any, "batch rows cols"]
Places = Float[Any, "batch a b"]


@dataclass(frozen=True)
class BatchRenderer:
    """One sensor's way from many contacts to many pictures."""

    renderer: Renderer
    like: Any
    """Fields are made in this array's library, precision and device."""

    def factors(self, contacts: Contact) -> Float[Any, "batch raw_rows raw_cols"]:
        """Brightness of every raw pixel relative to untouched skin, one picture for each contact of the batch."""
        light = self.renderer.light
        seen = light.change(self.seen_mm(contacts))
        dark = library_of(seen).clip(-seen, min=0.0) * self.sensing
        lost = light.shade * library_of(seen).sum(dark, axis=(-2, -1), keepdims=True)
        return self.through_lens((1 + self.scattered(seen)) * (1 - lost))

    def pictures(self, contacts: Contact) -> Float[Any, "batch raw_rows raw_cols 3"]:
        """BGR pictures without noise, 0 to 255."""
        return self.factors(contacts)[..., None] * self.asarray(self.renderer.untouched)

    def seen_mm(self, contacts: Contact) -> Fields:
        """Height of the skin as the plane's points show it."""
        height, nearness = contacts.height_mm, self.renderer.light.nearness_per_mm
        x, y = (self.asarray(axis) + 0 * height[:, :1, :1] for axis in self.renderer.plane_mm)
        seen = self.looked_up(contacts, x, y)
        for _ in range(STEPS if nearness else 0):
            seen = self.looked_up(contacts, x * (1 + nearness * seen), y * (1 + nearness * seen))
        return seen

    def looked_up(self, contacts: Contact, x_mm: Places, y_mm: Places) -> Places:
        """Height of the skin at places of the sensor."""
        patch = contacts.skin.patch
        cols, rows = (
            (place - over_grid(middle, place)) / patch.pitch_mm + (points - 1) / 2
            for place, middle, points in zip((x_mm, y_mm), contacts.centre_mm, (patch.cols, patch.rows), strict=True)
        )
        return bilinear(contacts.height_mm, cols, rows)

    def scattered(self, field: Fields) -> Float[Any, "batch fine_rows fine_cols"]:
        """Through the point-spread, made finer by its waves."""
        plane = self.renderer.plane
        fine = plane.rows * FINER, plane.cols * FINER
        wave = spectrum(field, plane.shape) * self.spread
        xp, (upper, half) = library_of(wave), ((plane.rows + 1) // 2, wave.shape[-1])
        room = xp.zeros((wave.shape[0], fine[0], fine[1] // 2 + 1), dtype=wave.dtype, device=device(wave))
        room[:, :upper, :half] = wave[:, :upper, :]
        room[:, upper - plane.rows :, :half] = wave[:, upper:, :]
        return field_of(room, fine, fine)

    def through_lens(self, fine: Fields) -> Float[Any, "batch raw_rows raw_cols"]:
        """As each raw pixel sees the plane."""
        cols, rows = (self.asarray(axis) + 0 * fine[:, :1, :1] for axis in self.renderer.lens)
        return bilinear(fine, cols, rows)

    @cached_property
    def spread(self) -> Any:
        """The point-spread's transform, with the factor that the finer grid asks for."""
        kx, ky = self.renderer.plane.waves
        sigma_mm = self.renderer.light.scattering_mm
        return self.asarray(np.exp(-(sigma_mm**2) / 2 * (kx**2 + ky**2)) * FINER**2)

    @cached_property
    def sensing(self) -> Any:
        """Weights of the plane's points in the mean over which darkness is counted."""
        return self.asarray(self.renderer.sensing / self.renderer.sensing.sum())

    def asarray(self, values: Any) -> Any:
        """Numbers as an array like those of this renderer."""
        xp = library_of(self.like)
        return xp.asarray(np.ascontiguousarray(values, np.float32), dtype=self.like.dtype, device=device(self.like))


def bilinear(fields: Fields, cols: Places, rows: Places) -> Places:
    """Periodic fields between their points, each at places of its own."""
    xp, (many, height, width) = library_of(fields), fields.shape
    first_col, first_row = xp.floor(cols), xp.floor(rows)
    along, down = cols - first_col, rows - first_row
    left, right = (xp.astype(first_col + step, xp.int64) % width for step in (0, 1))
    upper, lower = (xp.astype(first_row + step, xp.int64) % height for step in (0, 1))
    start = xp.reshape(xp.arange(many, device=device(fields)) * (height * width), (-1, 1, 1))
    flat = xp.reshape(fields, (-1,))

    def at(row: Any, col: Any) -> Any:
        index = start + row * width + col
        return xp.reshape(xp.take(flat, xp.reshape(index, (-1,)), axis=0), index.shape)

    above = at(upper, left) + along * (at(upper, right) - at(upper, left))
    below = at(lower, left) + along * (at(lower, right) - at(lower, left))
    return above + down * (below - above)

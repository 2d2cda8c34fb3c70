"""Images of many contacts at once, in the array library of their skin: what a GPU draws data sets with.

The same steps as `simulation.image.Renderer`, which draws one image with OpenCV and is what this is tested against: seen
height on the plane, law of light, point-spread, loss, lens. Noise and 8 bits are left to whoever stores the images.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Float

from ninedtact.mechanics.array_namespace import array_namespace_of, forward_transform, inverse_transform
from ninedtact.mechanics.batching import expand_over_grid
from ninedtact.mechanics.contact import Contact
from ninedtact.simulation.renderer import Renderer
from ninedtact.simulation.seeing import FINER, STEPS

Fields = Float[Any, "batch rows cols"]
Places = Float[Any, "batch a b"]


@dataclass(frozen=True)
class BatchRenderer:
    """One sensor's way from many contacts to many images."""

    renderer: Renderer
    like: Any
    """Fields are made in this array's library, precision and device."""

    def factors(self, contacts: Contact) -> Float[Any, "batch raw_rows raw_cols"]:
        """Brightness of every raw pixel relative to untouched skin, one image for each contact of the batch."""
        light = self.renderer.light
        seen = light.brightness_change(self.seen_mm(contacts))
        dark = array_namespace_of(seen).clip(-seen, min=0.0) * self.sensing
        lost = light.global_dimming * array_namespace_of(seen).sum(dark, axis=(-2, -1), keepdims=True)
        return self.through_lens((1 + self.scattered(seen)) * (1 - lost))

    def images(self, contacts: Contact) -> Float[Any, "batch raw_rows raw_cols 3"]:
        """BGR images without noise, 0 to 255."""
        return self.factors(contacts)[..., None] * self.untouched

    def seen_mm(self, contacts: Contact) -> Fields:
        """Height of the skin as the plane's points show it."""
        height, nearness = contacts.height_mm, self.renderer.light.inverse_distance_per_mm
        x, y = (axis + 0 * height[:, :1, :1] for axis in self.plane_mm)
        seen = self.looked_up(contacts, x, y)
        for _ in range(STEPS if nearness else 0):
            seen = self.looked_up(contacts, x * (1 + nearness * seen), y * (1 + nearness * seen))
        return seen

    def looked_up(self, contacts: Contact, x_mm: Places, y_mm: Places) -> Places:
        """Height of the skin at places of the sensor."""
        patch = contacts.skin.patch
        cols, rows = (
            (place - expand_over_grid(middle, place)) / patch.pitch_mm + (points - 1) / 2
            for place, middle, points in zip((x_mm, y_mm), contacts.centre_mm, (patch.cols, patch.rows), strict=True)
        )
        return between(cols, rows, patch.shape).of_each(contacts.height_mm)

    def scattered(self, field: Fields) -> Float[Any, "batch fine_rows fine_cols"]:
        """Through the point-spread, made finer by its waves."""
        plane = self.renderer.plane
        fine = plane.rows * FINER, plane.cols * FINER
        wave = forward_transform(field, plane.shape) * self.spread
        xp, (upper, half) = array_namespace_of(wave), ((plane.rows + 1) // 2, wave.shape[-1])
        room = xp.zeros((wave.shape[0], fine[0], fine[1] // 2 + 1), dtype=wave.dtype, device=device(wave))
        room[:, :upper, :half] = wave[:, :upper, :]
        room[:, upper - plane.rows :, :half] = wave[:, upper:, :]
        return inverse_transform(room, fine, fine)

    def through_lens(self, fine: Fields) -> Float[Any, "batch raw_rows raw_cols"]:
        """As each raw pixel sees the plane."""
        return self.lens.of(fine)

    @cached_property
    def lens(self) -> "Between":
        """Where on the plane, made finer, each raw pixel looks: the same in all images."""
        plane, (cols, rows) = self.renderer.plane, (self.asarray(axis) for axis in self.renderer.lens)
        return between(cols, rows, (plane.rows * FINER, plane.cols * FINER))

    @cached_property
    def spread(self) -> Any:
        """The point-spread's transform, with the factor that the finer grid asks for."""
        kx, ky = self.renderer.plane.waves
        sigma_mm = self.renderer.light.point_spread_mm
        return self.asarray(np.exp(-(sigma_mm**2) / 2 * (kx**2 + ky**2)) * FINER**2)

    @cached_property
    def sensing(self) -> Any:
        """Weights of the plane's points in the mean over which darkness is counted."""
        return self.asarray(self.renderer.sensing / self.renderer.sensing.sum())

    @cached_property
    def plane_mm(self) -> tuple[Any, Any]:
        """x and y of the plane's points."""
        x, y = self.renderer.plane_mm
        return self.asarray(x), self.asarray(y)

    @cached_property
    def untouched(self) -> Any:
        """The untouched skin, BGR."""
        return self.asarray(self.renderer.reference)

    def asarray(self, values: Any) -> Any:
        """Numbers as an array like those of this renderer."""
        xp = array_namespace_of(self.like)
        return xp.asarray(np.ascontiguousarray(values, np.float32), dtype=self.like.dtype, device=device(self.like))


@dataclass(frozen=True)
class Between:
    """Places between the points of periodic fields, ready to be looked up."""

    corners: tuple[Any, Any, Any, Any]
    """Numbers of the points around each place, in a field laid out flat: upper left and right, lower left and right."""
    along: Any
    """How far each place is from left to right, 0 to 1."""
    down: Any

    def of(self, fields: Fields) -> Places:
        """The same places in each of many fields."""
        xp, many = array_namespace_of(fields), fields.shape[0]
        flat, shape = xp.reshape(fields, (many, -1)), (many, *self.along.shape)
        return self.mixed(
            *(xp.reshape(xp.take(flat, xp.reshape(corner, (-1,)), axis=1), shape) for corner in self.corners)
        )

    def of_each(self, fields: Fields) -> Places:
        """In each field places of its own."""
        xp, (many, height, width) = array_namespace_of(fields), fields.shape
        flat, start = xp.reshape(fields, (-1,)), xp.arange(many, device=device(fields)) * (height * width)
        indices = (corner + start[:, None, None] for corner in self.corners)
        return self.mixed(*(xp.reshape(xp.take(flat, xp.reshape(k, (-1,)), axis=0), k.shape) for k in indices))

    def mixed(self, upper: Places, upper_right: Places, lower: Places, lower_right: Places) -> Places:
        """Linearly."""
        above = upper + self.along * (upper_right - upper)
        below = lower + self.along * (lower_right - lower)
        return above + self.down * (below - above)


def between(cols: Float[Any, "*batch a b"], rows: Float[Any, "*batch a b"], shape: tuple[int, int]) -> Between:
    """These places of fields of this shape (rows, cols)."""
    xp, (height, width) = array_namespace_of(cols), shape
    first_col, first_row = xp.floor(cols), xp.floor(rows)
    left, right = (xp.astype(first_col + step, xp.int64) % width for step in (0, 1))
    upper, lower = (xp.astype(first_row + step, xp.int64) % height * width for step in (0, 1))
    return Between((upper + left, upper + right, lower + left, lower + right), cols - first_col, rows - first_row)

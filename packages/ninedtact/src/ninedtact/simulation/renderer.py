"""Renders raw images of contacts: lines of sight, brightness, scattering, lens and camera noise. `Renderer` renders one contact
with OpenCV, `BatchRenderer` many contacts of one sensor at once.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from array_api_compat import device
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.numpy_or_torch_arrays import (
    array_namespace_of,
    expand_over_grid,
    forward_transform,
    inverse_transform,
)
from ninedtact.mechanics.skin import PeriodicGrid, ScalarField, padded_grid
from ninedtact.quantities import BgrImage
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import (
    FIXED_POINT_STEPS,
    REFINEMENT,
    PixelToSkinMap,
    SightlineGrid,
    blur_and_refine_fields,
    grid_indices_at_positions,
    zero_pad_spectrum,
)

NOISE_MARGIN_PX = 61
"""Rows and columns by which the stored noise exceeds an image; every frame gets its own section."""
PLANE_PITCH_MM = 0.2
"""Pitch of the grid on which brightness is computed; scattering has smoothed all that is finer."""
SENSING_SHARE = 0.92
"""Share of the raw image's extent, along each axis, that the rectified image shows."""


@dataclass(frozen=True)
class CameraNoise:
    """Gaussian noise, equal in all colours and different in every image of one sensor.

    The noise is sampled once, because fresh noise would cost more than the rest of a frame. Frames get different sections of it.
    """

    grey_levels: float = 0.7
    """Standard deviation of one pixel in one image (as of real sensors, docs/figures.md)."""
    shape: tuple[int, int] = (480, 640)
    seed: int = 0

    @cached_property
    def _samples(self) -> Float32[Array, "rows cols"]:
        rows, cols = (side + NOISE_MARGIN_PX for side in self.shape)
        return np.random.default_rng(self.seed).normal(0, self.grey_levels, (rows, cols)).astype(np.float32)

    def add_to(self, image: Float32[Array, "rows cols 3"], number: int) -> UInt8[Array, "rows cols 3"]:
        """Return the 8-bit image with the noise of this frame number."""
        rows, cols = self.shape
        turn = number // NOISE_MARGIN_PX
        down, right = (step % NOISE_MARGIN_PX for step in (number * 17, (number + turn) * 31))
        cut = self._samples[down : down + rows, right : right + cols]
        return np.asarray(cv2.add(image, cv2.merge([cut, cut, cut]), dtype=cv2.CV_8U))


@dataclass(frozen=True)
class Renderer:
    """Renders the raw images of one sensor."""

    pixel_map: PixelToSkinMap
    reference: Float32[Array, "raw_rows raw_cols 3"]
    """The reference image (no contact) without noise, BGR, 0 to 255."""
    light: BrightnessModel
    noise: CameraNoise
    glare: Float32[Array, "raw_rows raw_cols"] | None = None
    """Share of the light of every pixel that is reflected and does not come through the gel; None for none."""

    def __call__(self, contact: Contact | None, number: int = 0) -> BgrImage:
        """Return the image of a contact (None: nothing touches); `number` picks the noise."""
        clean = self.reference if contact is None or not contact.touches else self.render_without_noise(contact)
        return self.noise.add_to(clean, number)

    def render_without_noise(self, contact: Contact) -> Float32[Array, "raw_rows raw_cols 3"]:
        """Return the image of a contact without noise, 0 to 255."""
        factor = self.brightness_factor(contact)
        return np.asarray(cv2.multiply(self.reference, cv2.merge([factor, factor, factor])))

    def brightness_factor(self, contact: Contact) -> Float32[Array, "raw_rows raw_cols"]:
        """Return the brightness of every raw pixel relative to the reference image."""
        sight = SightlineGrid(*self.plane_mm, self.light.inverse_distance_per_mm)
        height, thicker = (np.asarray(field, np.float32) for field in (contact.height_mm, contact.thickness_change_mm))
        thicker_mm = sight.sample(contact.skin.grid, contact.centre_mm, height, thicker)
        seen = self.light.brightness_change(thicker_mm).astype(np.float32)
        (diffuse,) = blur_and_refine_fields(self.plane, self.light.point_spread_mm, seen)
        level = 1 + self.light.image_dimming(seen[self.sensing])
        factor = (diffuse + 1) * np.float32(level)
        seen = np.asarray(cv2.remap(factor, *self.lens, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
        return seen if self.glare is None else 1 + (seen - 1) * (1 - self.glare)

    @cached_property
    def plane(self) -> PeriodicGrid:
        """The grid of the undeformed plane, which covers the view."""
        x, y = self.pixel_map.reach_mm
        return padded_grid(2 * x, 2 * y, PLANE_PITCH_MM, PLANE_PITCH_MM)

    @cached_property
    def plane_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of the points of `plane`."""
        x, y = (np.ascontiguousarray(axis, np.float32) for axis in self.plane.positions_mm)
        return x, y

    @cached_property
    def sensing(self) -> Bool[Array, "rows cols"]:
        """The points of `plane` over which darkening is averaged: the middle, about the sensing area."""
        (x, y), (far_x, far_y) = self.plane_mm, self.pixel_map.reach_mm
        return np.asarray((abs(x) < SENSING_SHARE * far_x) & (abs(y) < SENSING_SHARE * far_y))

    @cached_property
    def lens(self) -> tuple[Float32[Array, "raw_rows raw_cols"], Float32[Array, "raw_rows raw_cols"]]:
        """The column and the row of the refined plane that each raw pixel sees."""
        x, y = (self.pixel_map.plane_mm[..., axis] for axis in range(2))
        cols, rows = grid_indices_at_positions(self.plane, (0.0, 0.0), x, y, REFINEMENT)
        return np.ascontiguousarray(cols), np.ascontiguousarray(rows)


_Fields = Float[Any, "batch rows cols"]
_Sampled = Float[Any, "batch a b"]
_Image = Float[Any, "batch raw_rows raw_cols"]


@dataclass(frozen=True)
class BatchRenderer:
    """Renders many contacts of one sensor at once, in NumPy or torch, so that a GPU renders data sets.

    It computes the same optics as `Renderer`, which serves as its reference in the tests: height of the skin on the lines of
    sight, brightness model, point spread, global dimming, lens. Only the interpolation differs: OpenCV interpolates one field in
    NumPy and is several times faster there (docs/mechanics.md). The code that stores the images adds the noise and
    rounds to 8 bits.
    """

    renderer: Renderer
    like: Any
    """An array whose library, precision and device all fields have."""

    def brightness_factors(self, contacts: Contact) -> _Image:
        """Return the brightness of every raw pixel relative to the reference image, one image for each contact of the batch."""
        light, fine = self.renderer.light, self._fine_shape
        change = light.brightness_change(self._thickness_change_on_sightlines_mm(contacts))
        xp = array_namespace_of(change)
        dark = xp.clip(-change, min=0.0) * self._sensing_weights
        lost = light.global_dimming * xp.sum(dark, axis=(-2, -1), keepdims=True)
        wave = forward_transform(change, self.renderer.plane.shape) * self._point_spread
        diffuse = inverse_transform(zero_pad_spectrum(wave, self.renderer.plane), fine, fine)
        seen = self._lens_lookup.sample((1 + diffuse) * (1 - lost))
        return seen if self._gel_light is None else 1 + (seen - 1) * self._gel_light

    def images(self, contacts: Contact) -> Float[Any, "batch raw_rows raw_cols 3"]:
        """Return BGR images without noise, 0 to 255, one for each contact of the batch."""
        return self.brightness_factors(contacts)[..., None] * self._reference

    def _thickness_change_on_sightlines_mm(self, contacts: Contact) -> _Fields:
        """Return the change of the gel's thickness on the line of sight of every point of the plane."""
        height, per_mm = contacts.height_mm, self.renderer.light.inverse_distance_per_mm
        x, y = (axis + 0 * height[:, :1, :1] for axis in self._plane_mm)
        stretch = 1 + 0 * x
        for _ in range(FIXED_POINT_STEPS if per_mm else 0):
            stretch = 1 + per_mm * self._field_at(contacts, height, x * stretch, y * stretch)
        return self._field_at(contacts, contacts.thickness_change_mm, x * stretch, y * stretch)

    def _field_at(self, contacts: Contact, field: ScalarField, x_mm: _Sampled, y_mm: _Sampled) -> _Sampled:
        grid = contacts.skin.grid
        cols, rows = (
            (position - expand_over_grid(middle, position)) / grid.pitch_mm + (points - 1) / 2
            for position, middle, points in zip((x_mm, y_mm), contacts.centre_mm, (grid.cols, grid.rows), strict=True)
        )
        return _bilinear_lookup(cols, rows, grid.shape).sample_each(field)

    @property
    def _fine_shape(self) -> tuple[int, int]:
        """The (rows, cols) of the refined plane."""
        return self.renderer.plane.rows * REFINEMENT, self.renderer.plane.cols * REFINEMENT

    @cached_property
    def _lens_lookup(self) -> "_BilinearLookup":
        """The position on the refined plane that each raw pixel sees, which is the same in all images."""
        cols, rows = (self._asarray(axis) for axis in self.renderer.lens)
        return _bilinear_lookup(cols, rows, self._fine_shape)

    @cached_property
    def _point_spread(self) -> Any:
        """The transform of the point spread, times the factor that refinement requires."""
        kx, ky = self.renderer.plane.wave_vectors
        sigma_mm = self.renderer.light.point_spread_mm
        return self._asarray(np.exp(-(sigma_mm**2) / 2 * (kx**2 + ky**2)) * REFINEMENT**2)

    @cached_property
    def _sensing_weights(self) -> Any:
        """Weights of the plane's points in the mean over which darkness is averaged."""
        return self._asarray(self.renderer.sensing / self.renderer.sensing.sum())

    @cached_property
    def _plane_mm(self) -> tuple[Any, Any]:
        """The x and the y of the plane's points."""
        x, y = self.renderer.plane_mm
        return self._asarray(x), self._asarray(y)

    @cached_property
    def _reference(self) -> Any:
        """The reference image (no contact), BGR."""
        return self._asarray(self.renderer.reference)

    @cached_property
    def _gel_light(self) -> Any:
        """The share of the light of every pixel that comes through the gel; None where all of it does."""
        return None if self.renderer.glare is None else self._asarray(1 - self.renderer.glare)

    def _asarray(self, values: Any) -> Any:
        """Return values as an array in the library, precision and device of this renderer."""
        xp = array_namespace_of(self.like)
        return xp.asarray(np.ascontiguousarray(values, np.float32), dtype=self.like.dtype, device=device(self.like))


@dataclass(frozen=True)
class _BilinearLookup:
    """Positions between the points of periodic fields, prepared for bilinear interpolation."""

    corners: tuple[Any, Any, Any, Any]
    """Indices of the points around each position in a flat field: upper left and right, lower left and right."""
    along: Any
    """How far each position is from left to right, 0 to 1."""
    down: Any
    """How far each position is from the upper to the lower points, 0 to 1."""

    def sample(self, fields: _Fields) -> _Sampled:
        """Return the values of many fields at the same positions."""
        flat = array_namespace_of(fields).reshape(fields, (fields.shape[0], -1))
        return self._interpolate(*(flat[:, corner] for corner in self.corners))

    def sample_each(self, fields: _Fields) -> _Sampled:
        """Return the values of each field at positions of its own."""
        xp, many = array_namespace_of(fields), fields.shape[0]
        flat, each = xp.reshape(fields, (many, -1)), xp.arange(many, device=device(fields))[:, None, None]
        return self._interpolate(*(flat[each, corner] for corner in self.corners))

    def _interpolate(self, upper: _Sampled, upper_right: _Sampled, lower: _Sampled, lower_right: _Sampled) -> _Sampled:
        """Return the bilinear mean of the four points around each position."""
        above = upper + self.along * (upper_right - upper)
        below = lower + self.along * (lower_right - lower)
        return above + self.down * (below - above)


def _bilinear_lookup(
    cols: Float[Any, "*batch a b"], rows: Float[Any, "*batch a b"], shape: tuple[int, int]
) -> _BilinearLookup:
    """Return the look-up of these columns and rows in periodic fields of this shape (rows, cols)."""
    xp, (height, width) = array_namespace_of(cols), shape
    first_col, first_row = xp.floor(cols), xp.floor(rows)
    left, right = (xp.astype(first_col + step, xp.int32) % width for step in (0, 1))
    upper, lower = (xp.astype(first_row + step, xp.int32) % height * width for step in (0, 1))
    corners = (upper + left, upper + right, lower + left, lower + right)
    return _BilinearLookup(corners, cols - first_col, rows - first_row)

"""Renders the raw image of one contact with OpenCV: lines of sight, brightness, scattering, lens and camera noise."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.periodic_grid import PeriodicGrid, padded_grid
from ninedtact.simulation.illumination import BrightnessModel
from ninedtact.simulation.pixel_map import REFINEMENT, PixelMap, SightlineGrid, blur_and_refine_fields, grid_coordinates

NOISE_MARGIN_PX = 61
"""Rows and columns by which the stored noise exceeds an image; every frame gets its own section."""
PLANE_PITCH_MM = 0.2
"""Pitch of the grid on which brightness is computed; scattering has smoothed all that is finer."""
SENSING_SHARE = 0.92
"""Share of the raw image's extent, along each axis, that the rectified image shows."""

BgrImage = UInt8[Array, "raw_rows raw_cols 3"]


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
        down, right = (number * step % NOISE_MARGIN_PX for step in (17, 31))
        cut = self._samples[down : down + rows, right : right + cols]
        return np.asarray(cv2.add(image, cv2.merge([cut, cut, cut]), dtype=cv2.CV_8U))


@dataclass(frozen=True)
class Renderer:
    """Renders the raw images of one sensor."""

    pixel_map: PixelMap
    reference: Float32[Array, "raw_rows raw_cols 3"]
    """The reference image (no contact) without noise, BGR, 0 to 255."""
    light: BrightnessModel
    noise: CameraNoise

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
        height = np.asarray(contact.height_mm, np.float32)
        sight = SightlineGrid(*self.plane_mm, self.light.inverse_distance_per_mm)
        seen = self.light.brightness_change(sight.height_mm(contact.skin.grid, contact.centre_mm, height)).astype(
            np.float32
        )
        (diffuse,) = blur_and_refine_fields(self.plane, self.light.point_spread_mm, seen)
        level = 1 + self.light.image_dimming(seen[self.sensing])
        factor = (diffuse + 1) * np.float32(level)
        return np.asarray(cv2.remap(factor, *self.lens, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

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
        cols, rows = grid_coordinates(self.plane, (0.0, 0.0), x, y, REFINEMENT)
        return np.ascontiguousarray(cols), np.ascontiguousarray(rows)

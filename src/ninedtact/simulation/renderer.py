"""Noise of a camera, drawn once and dealt out: fresh noise for every frame would cost more than the frame.

Skin → image: what the sensor's camera would deliver, in its own lens, light, colours and noise.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.periodic_grid import PeriodicGrid, padded_grid
from ninedtact.simulation.illumination import BrightnessModel
from ninedtact.simulation.pixel_map import PixelMap
from ninedtact.simulation.seeing import FINER, Sight, grid, scattered

ROOM_PX = 61
"""By how much larger than an image the stored noise is, each way; every frame gets its own cut."""


@dataclass(frozen=True)
class CameraNoise:
    """Gaussian noise in grey levels, alike in all colours, different in every image of one sensor."""

    grey_levels: float = 0.7
    """Standard deviation of one pixel in one image (real sensors, docs/figures.md)."""
    shape: tuple[int, int] = (480, 640)
    seed: int = 0

    @cached_property
    def stored(self) -> Float32[Array, "rows cols"]:
        """The noise that images get cuts of, as three equal channels."""
        rows, cols = self.shape
        drawn = np.random.default_rng(self.seed).normal(0, self.grey_levels, (rows + ROOM_PX, cols + ROOM_PX))
        return drawn.astype(np.float32)

    def upon(self, image: Float32[Array, "rows cols 3"], number: int) -> UInt8[Array, "rows cols 3"]:
        """The image with the noise of this number, in 8 bits."""
        rows, cols = self.shape
        down, right = (number * step % ROOM_PX for step in (17, 31))
        cut = self.stored[down : down + rows, right : right + cols]
        return np.asarray(cv2.add(image, cv2.merge([cut, cut, cut]), dtype=cv2.CV_8U))


PLANE_PITCH_MM = 0.2
"""Grid on which brightness is computed; scattering has smoothed what is finer."""

SENSING = 0.92
"""Of what the raw image reaches, each way: the rectified image shows as much."""

BgrImage = UInt8[Array, "raw_rows raw_cols 3"]


@dataclass(frozen=True)
class Renderer:
    """One sensor's way from skin to image."""

    view: PixelMap
    untouched: Float32[Array, "raw_rows raw_cols 3"]
    """The untouched skin without noise, BGR, 0 to 255."""
    light: BrightnessModel
    noise: CameraNoise

    def __call__(self, contact: Contact | None, number: int = 0) -> BgrImage:
        """The image of this contact (None: nothing touches); `number` picks the noise."""
        clean = self.untouched if contact is None or not contact.touches else self.shone_on(contact)
        return self.noise.upon(clean, number)

    def shone_on(self, contact: Contact) -> Float32[Array, "raw_rows raw_cols 3"]:
        """The image without noise."""
        factor = self.factor(contact)
        return np.asarray(cv2.multiply(self.untouched, cv2.merge([factor, factor, factor])))

    def factor(self, contact: Contact) -> Float32[Array, "raw_rows raw_cols"]:
        """Brightness of every raw pixel relative to untouched skin."""
        height = np.asarray(contact.height_mm, np.float32)
        sight = Sight(*self.plane_mm, self.light.inverse_distance_per_mm)
        seen = self.light.change(sight.height_mm(contact.skin.patch, contact.centre_mm, height)).astype(np.float32)
        (diffuse,) = scattered(self.plane, self.light.point_spread_mm, seen)
        level = 1 + self.light.loss(seen[self.sensing])
        factor = (diffuse + 1) * np.float32(level)
        return np.asarray(cv2.remap(factor, *self.lens, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    @cached_property
    def plane(self) -> PeriodicGrid:
        """Grid of the untouched plane, which covers the view."""
        x, y = self.view.reach_mm
        return padded_grid(2 * x, 2 * y, PLANE_PITCH_MM, PLANE_PITCH_MM)

    @cached_property
    def plane_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of its points."""
        x, y = (np.ascontiguousarray(axis, np.float32) for axis in self.plane.place_mm)
        return x, y

    @cached_property
    def sensing(self) -> Bool[Array, "rows cols"]:
        """The points of the plane over which darkness is counted: the middle, about the sensing area."""
        (x, y), (far_x, far_y) = self.plane_mm, self.view.reach_mm
        return np.asarray((abs(x) < SENSING * far_x) & (abs(y) < SENSING * far_y))

    @cached_property
    def lens(self) -> tuple[Float32[Array, "raw_rows raw_cols"], Float32[Array, "raw_rows raw_cols"]]:
        """Column and row of the plane, made finer, that each raw pixel looks through."""
        x, y = (self.view.plane_mm[..., axis] for axis in range(2))
        cols, rows = grid(self.plane, (0.0, 0.0), x, y, FINER)
        return np.ascontiguousarray(cols), np.ascontiguousarray(rows)

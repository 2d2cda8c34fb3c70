"""Renders the rectified grey images of a calibrated sensor directly on the skin's grid, without a raw image in between."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.design import PUBLISHED_RECTIFIED_COLS, rectified_mm_per_px
from ninedtact.mechanics.contact_result import Contact
from ninedtact.quantities import centred_axis_mm
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact_train.population.sensor_population import CalibrationMisalignment, SampledSensor

_INVERSION_STEPS = 12
"""Iterations of the search for a pixel of the raw image; each reduces the error to a fifth."""

Grey = UInt8[Array, "rows cols"]
Plane = Float32[Array, "rows cols 2"]


@dataclass(frozen=True)
class RectifiedRenderer:
    """Renders the rectified grey images of one sensor."""

    renderer: Renderer
    """The renderer whose view is the rectified grid."""

    @cached_property
    def reference(self) -> Float32[Array, "rows cols"]:
        """The reference image (no contact) without noise."""
        return np.asarray(cv2.cvtColor(self.renderer.reference, cv2.COLOR_BGR2GRAY))

    def render(self, contact: Contact | None, rng: np.random.Generator) -> Grey:
        """Return the image of a contact (None: nothing touches) with noise from `rng`."""
        return self.add_noise(self.brightness_factor(contact), rng)

    def brightness_factor(self, contact: Contact | None) -> Float32[Array, "rows cols"] | None:
        """Return the brightness of every pixel relative to the reference image; None without contact."""
        return self.renderer.brightness_factor(contact) if contact is not None and contact.touches else None

    def add_noise(self, factor: Float32[Array, "rows cols"] | None, rng: np.random.Generator) -> Grey:
        """Return the image with this brightness relative to the reference image and with noise from `rng`."""
        clean = self.reference if factor is None else self.reference * factor
        noise = rng.standard_normal(clean.shape, np.float32) * np.float32(self.renderer.noise.grey_levels)
        return np.asarray(cv2.add(clean, noise, dtype=cv2.CV_8U))


def rectified_renderer(member: SampledSensor, size: tuple[int, int]) -> RectifiedRenderer:
    """Return the renderer of a sensor for images of (cols, rows). Small images are means over pixels and have less noise."""
    raw = member.renderer()
    plane = misaligned_pixel_positions_mm(size, rectified_mm_per_px(size, member.design), member.misalignment)
    pixels = raw_pixels_seeing(raw.pixel_map, plane)
    untouched = interpolate_image(raw.reference, pixels)
    glare = None if raw.glare is None else interpolate_image(raw.glare[..., None], pixels)
    calmer = member.noise_grey_levels * min(1.0, size[0] / PUBLISHED_RECTIFIED_COLS)
    rows, cols = plane.shape[:2]
    noise = CameraNoise(calmer, (rows, cols))
    return RectifiedRenderer(Renderer(PixelToSkinMap(plane), untouched, raw.light, noise, glare))


def misaligned_pixel_positions_mm(
    size: tuple[int, int], mm_per_px: float, misalignment: CalibrationMisalignment
) -> Plane:
    """Return where on the skin the pixels of a rectified image of (cols, rows) truly lie, given the error of its calibration."""
    x, y = np.meshgrid(*(centred_axis_mm(side, mm_per_px) for side in size))
    cos, sin = np.cos(misalignment.turn_rad), np.sin(misalignment.turn_rad)
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return (misalignment.scale * turned + misalignment.offset_mm).astype(np.float32)


def raw_pixels_seeing(view: PixelToSkinMap, plane_mm: Plane) -> Plane:
    """Return the pixels (x, y) of the raw image that see these positions: the inverse of the view, by fixed-point iteration."""
    rows, cols = view.raw_shape
    across = (view.plane_mm[rows // 2, -1, 0] - view.plane_mm[rows // 2, 0, 0]) / (cols - 1)
    last = np.array([cols - 1, rows - 1], np.float32)
    px = last / 2 + plane_mm / across
    for _ in range(_INVERSION_STEPS):
        px = np.clip(px, 0, last).astype(np.float32)
        px = px - (interpolate_image(view.plane_mm, px) - plane_mm) / across
    return px.astype(np.float32)


def interpolate_image(field: Float32[Array, "raw_rows raw_cols n"], px: Plane) -> Float32[Array, "rows cols *n"]:
    """Return an image at these pixels (x, y) by linear interpolation; one of a single channel has none afterwards."""
    x, y = (np.ascontiguousarray(px[..., axis]) for axis in range(2))
    return np.asarray(cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

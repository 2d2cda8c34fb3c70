"""What a calibrated sensor delivers: grey images on the skin's own grid, drawn there, not on the raw image first."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.design import SensingArea, SensorDesign
from ninedtact.mechanics.contact import Contact
from ninedtact.quantities import centred_axis_mm
from ninedtact.simulation.pixel_map import PixelMap
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.sensor_population import CalibrationMisalignment, SampledSensor

FULL_COLS, FULL_MM_PER_PX = 460, 0.0522
"""The published rectified image of 24 mm; smaller ones show the same skin with larger pixels, wider skin has larger ones too."""
STEPS = 12
"""Of the search for a place in the raw image; each leaves a fifth of the error of the one before."""

Grey = UInt8[Array, "rows cols"]
Plane = Float32[Array, "rows cols 2"]


@dataclass(frozen=True)
class GreyEye:
    """One sensor's way from skin to rectified grey images."""

    renderer: Renderer
    """Its view is the rectified grid."""

    @cached_property
    def untouched(self) -> Float32[Array, "rows cols"]:
        """Without noise."""
        return np.asarray(cv2.cvtColor(self.renderer.reference, cv2.COLOR_BGR2GRAY))

    def image(self, contact: Contact | None, rng: np.random.Generator) -> Grey:
        """Of this contact (None: nothing touches), with noise of its own."""
        return self.shot(self.factor(contact), rng)

    def factor(self, contact: Contact | None) -> Float32[Array, "rows cols"] | None:
        """Brightness relative to untouched skin; None where nothing touches."""
        return self.renderer.brightness_factor(contact) if contact is not None and contact.touches else None

    def shot(self, factor: Float32[Array, "rows cols"] | None, rng: np.random.Generator) -> Grey:
        """The image, with noise of its own, of skin that is this much brighter than untouched."""
        clean = self.untouched if factor is None else self.untouched * factor
        noise = rng.standard_normal(clean.shape, np.float32) * np.float32(self.renderer.noise.grey_levels)
        return np.asarray(cv2.add(clean, noise, dtype=cv2.CV_8U))


def mm_per_px(size: tuple[int, int], design: SensorDesign = SensorDesign()) -> float:
    """Of rectified images of this size (cols, rows), as wide as the sensing area."""
    return FULL_MM_PER_PX * FULL_COLS / size[0] * (design.sensing_area.width_mm / SensingArea().width_mm)


def grey_eye(member: SampledSensor, size: tuple[int, int]) -> GreyEye:
    """The eye of a member, for images of (cols, rows). Small images are means over pixels, with less noise."""
    raw = member.renderer()
    plane = read_places(size, mm_per_px(size, member.design), member.misalignment)
    untouched = looked_up(raw.reference, raw_places(raw.pixel_map, plane))
    calmer = member.noise_grey_levels * min(1.0, size[0] / FULL_COLS)
    rows, cols = plane.shape[:2]
    noise = CameraNoise(calmer, (rows, cols))
    return GreyEye(Renderer(PixelMap(plane), untouched, raw.light, noise))


def read_places(size: tuple[int, int], mm_per_px: float, misreading: CalibrationMisalignment) -> Plane:
    """Where on the skin the pixels of the rectified image truly lie."""
    x, y = np.meshgrid(*(centred_axis_mm(side, mm_per_px) for side in size))
    cos, sin = np.cos(misreading.turn_rad), np.sin(misreading.turn_rad)
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return (misreading.scale * turned + misreading.offset_mm).astype(np.float32)


def raw_places(view: PixelMap, plane_mm: Plane) -> Plane:
    """Pixels (x, y) of the raw image that see these places: the view read backwards, step by step."""
    rows, cols = view.raw_shape
    across = (view.plane_mm[rows // 2, -1, 0] - view.plane_mm[rows // 2, 0, 0]) / (cols - 1)
    last = np.array([cols - 1, rows - 1], np.float32)
    px = last / 2 + plane_mm / across
    for _ in range(STEPS):
        px = np.clip(px, 0, last).astype(np.float32)
        px = px - (looked_up(view.plane_mm, px) - plane_mm) / across
    return px.astype(np.float32)


def looked_up(field: Float32[Array, "raw_rows raw_cols n"], px: Plane) -> Float32[Array, "rows cols n"]:
    """An image at these pixels (x, y), linearly."""
    x, y = (np.ascontiguousarray(px[..., axis]) for axis in range(2))
    return np.asarray(cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

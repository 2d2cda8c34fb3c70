"""The digital twin of a calibrated sensor, from gel, light, lens, reference image and noise of its own calibration images."""

import numpy as np
from scipy.interpolate import RBFInterpolator

from ninedtact.design import Gel, SensingArea
from ninedtact.quantities import BgrImage, skin_grid_mm
from ninedtact.shape.lens_and_rectification import OUT_OF_VIEW_PX, Rectification
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap, coarse_pixel_grid, interpolate_pixel_map
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.twin import Twin

INVERSION_STRIDE_PX = 23
"""Distance in rows and columns of the points of the rectified grid through which the inverse is interpolated; lenses are smooth."""


def assemble_twin(
    name: str,
    gel: Gel,
    light: BrightnessModel,
    rectify: Rectification,
    reference: BgrImage,
    noise_grey_levels: float,
    area: SensingArea = SensingArea(),
) -> Twin:
    """Return the twin with this gel, light, rectification, reference image, noise and sensing area."""
    noise = CameraNoise(noise_grey_levels, rectify.raw_shape)
    return Twin(
        name,
        gel,
        Renderer(_invert_rectification(rectify), reference.astype(np.float32), light, noise),
        area_mm=area.size_mm,
        gel_mm=area.gel_mm,
    )


def _invert_rectification(rectify: Rectification) -> PixelToSkinMap:
    """Return the inverse of the rectification: the point on the skin of each raw pixel, extrapolated smoothly beyond the grid."""
    samples = np.s_[::INVERSION_STRIDE_PX, ::INVERSION_STRIDE_PX]
    grid_mm = skin_grid_mm(rectify.source_px.shape[:2], rectify.mm_per_px)
    skin_mm = np.column_stack([axis[samples].ravel() for axis in grid_mm])
    raw_px = rectify.source_px[samples].reshape(-1, 2).astype(float)
    is_in_view = (raw_px != OUT_OF_VIEW_PX).any(axis=1)
    unit_px = max(rectify.raw_shape) / 2
    inverse = RBFInterpolator(raw_px[is_in_view] / unit_px, skin_mm[is_in_view], kernel="cubic", degree=2)
    return interpolate_pixel_map(inverse(coarse_pixel_grid(rectify.raw_shape) / unit_px), rectify.raw_shape)

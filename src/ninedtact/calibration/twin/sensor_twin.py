"""A calibrated sensor → its twin: the gel, light, lens, image and noise that its own four images told."""

import numpy as np
from scipy.interpolate import RBFInterpolator

from ninedtact.calibration.brightness import BgrImage
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import Gel
from ninedtact.errors import CalibrationError
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.shape.rectification import Rectification, skin_grid_mm
from ninedtact.simulation.illumination import BrightnessModel
from ninedtact.simulation.pixel_map import PixelMap, coarse_pixel_grid, interpolate_pixel_map
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.twin import Twin

EVERY_PX = 23
"""Of the rectified grid, to read it backwards: lenses are smooth."""


class TwinMissing(CalibrationError):
    """A sensor that has no twin yet."""


def build_sensor_twin(folder: SensorFolder) -> Twin:
    """The twin in a sensor's folder; raises `TwinMissing`, and `SensorFolderDamaged` where its images are gone."""
    table = folder.record.twin
    if table is None:
        raise TwinMissing(
            f"expected {folder.path} to hold a twin, got a sensor without one; run ninedtact simulate fit --sensor {folder.path}"
        )
    untouched = folder.stored_image("ball_reference").image
    return build_twin(folder.id, table.gel, table.light, folder.rectification, untouched, table.noise_grey_levels)


def build_twin(
    name: str, gel: Gel, light: BrightnessModel, rectify: Rectification, untouched: BgrImage, noise_grey_levels: float
) -> Twin:
    """The twin of a sensor, on the untouched image that it was calibrated from."""
    noise = CameraNoise(noise_grey_levels, rectify.raw_shape)
    renderer = Renderer(_invert_rectification(rectify), untouched.astype(np.float32), light, noise)
    return Twin(
        name,
        lambda wave_number: bonded_layer_compliance(wave_number, gel),
        renderer,
        thickness_mm=gel.thickness_mm,
    )


def _invert_rectification(rectify: Rectification) -> PixelMap:
    """The rectification read backwards: where each raw pixel looks, continued smoothly beyond the rectified grid."""
    shape, every = rectify.source_px.shape[:2], np.s_[::EVERY_PX, ::EVERY_PX]
    place = np.column_stack([axis[every].ravel() for axis in skin_grid_mm(shape, rectify.mm_per_px)])
    source = rectify.source_px[every].reshape(-1, 2).astype(float)
    unit_px = max(rectify.raw_shape) / 2
    backwards = RBFInterpolator(source / unit_px, place, kernel="cubic", degree=2)
    return interpolate_pixel_map(backwards(coarse_pixel_grid(rectify.raw_shape) / unit_px), rectify.raw_shape)

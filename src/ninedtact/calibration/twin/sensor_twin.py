"""The digital twin of a calibrated sensor: gel, light, lens, reference image and noise from its own calibration images. In: a
sensor folder. Out: a `Twin` for simulation, from `build_sensor_twin`.
"""

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
"""Every how many rows and columns of the rectified grid the inverse is sampled; lenses are smooth."""


class TwinMissing(CalibrationError):
    """The sensor's calibration contains no twin."""


def build_sensor_twin(folder: SensorFolder) -> Twin:
    """Return the twin of a sensor folder; raises `TwinMissing`, and `SensorFolderDamaged` where its images are missing."""
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
    """Return the twin of a sensor, based on the reference image from its calibration."""
    noise = CameraNoise(noise_grey_levels, rectify.raw_shape)
    renderer = Renderer(_invert_rectification(rectify), untouched.astype(np.float32), light, noise)
    return Twin(
        name,
        lambda wave_number: bonded_layer_compliance(wave_number, gel),
        renderer,
        thickness_mm=gel.thickness_mm,
    )


def _invert_rectification(rectify: Rectification) -> PixelMap:
    """Return the inverse of the rectification: the point on the skin of each raw pixel, extrapolated smoothly beyond the grid."""
    shape, every = rectify.source_px.shape[:2], np.s_[::EVERY_PX, ::EVERY_PX]
    place = np.column_stack([axis[every].ravel() for axis in skin_grid_mm(shape, rectify.mm_per_px)])
    source = rectify.source_px[every].reshape(-1, 2).astype(float)
    unit_px = max(rectify.raw_shape) / 2
    backwards = RBFInterpolator(source / unit_px, place, kernel="cubic", degree=2)
    return interpolate_pixel_map(backwards(coarse_pixel_grid(rectify.raw_shape) / unit_px), rectify.raw_shape)

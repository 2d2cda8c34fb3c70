"""The digital twin of a calibrated sensor: gel, light, lens, reference image and noise from its own calibration images. In: a
sensor folder. Out: a `Twin` for simulation, from `build_twin_from_folder`; `make_twin_table` makes the folder's table of it from
the fits.
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import RBFInterpolator

from ninedtact.calibration.original_9dtact.folder_format import OUT_OF_VIEW_PX
from ninedtact.calibration.press_brightness import BgrImage
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.sensor_toml_schema import (
    BoardPressFitTable,
    FittedParameterTable,
    TwinFitQuality,
    TwinTable,
)
from ninedtact.calibration.twin.ball_press_fit import FitUncertainty, TwinFit
from ninedtact.calibration.twin.lens_refinement import BoardPressFit
from ninedtact.design import Gel
from ninedtact.errors import CalibrationError
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.quantities import skin_grid_mm
from ninedtact.shape.rectification import Rectification
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap, coarse_pixel_grid, interpolate_pixel_map
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.twin import Twin

EVERY_PX = 23
"""Every how many rows and columns of the rectified grid the inverse is sampled; lenses are smooth."""


class TwinMissing(CalibrationError):
    """The sensor's calibration contains no twin."""


def build_twin_from_folder(folder: SensorFolder) -> Twin:
    """Return the twin of a sensor folder, whose skin has the size of its design.

    Raises `TwinMissing`, and `SensorFolderDamaged` where its images are missing.
    """
    table = folder.record.twin
    if table is None:
        raise TwinMissing(
            f"expected {folder.path} to hold a twin, got a sensor without one; run: {folder.completion_command}"
        )
    untouched = folder.stored_image("ball_reference").image
    twin = assemble_twin(folder.id, table.gel, table.light, folder.rectification, untouched, table.noise_grey_levels)
    area = folder.record.design.sensing_area
    return replace(twin, area_mm=area.size_mm, gel_mm=area.gel_mm)


def assemble_twin(
    name: str, gel: Gel, light: BrightnessModel, rectify: Rectification, untouched: BgrImage, noise_grey_levels: float
) -> Twin:
    """Return the twin with this gel, light, rectification, reference image and noise, and a skin of the published size."""

    def correct_contact(contact: Contact, indenter: Indenter | None = None) -> Contact:
        return correct_for_finite_strain(contact, gel.thickness_mm, indenter, gel.finite_strain)

    noise = CameraNoise(noise_grey_levels, rectify.raw_shape)
    renderer = Renderer(_invert_rectification(rectify), untouched.astype(np.float32), light, noise)
    linear = Twin(
        name,
        lambda wave_number: bonded_layer_compliance(wave_number, gel),
        renderer,
        thickness_mm=gel.thickness_mm,
    )
    return replace(linear, correct_contact=correct_contact) if gel.finite_strain else linear


def _invert_rectification(rectify: Rectification) -> PixelToSkinMap:
    """Return the inverse of the rectification: the point on the skin of each raw pixel, extrapolated smoothly beyond the grid."""
    shape, every = rectify.source_px.shape[:2], np.s_[::EVERY_PX, ::EVERY_PX]
    place = np.column_stack([axis[every].ravel() for axis in skin_grid_mm(shape, rectify.mm_per_px)])
    source = rectify.source_px[every].reshape(-1, 2).astype(float)
    unit_px, known = max(rectify.raw_shape) / 2, (source != OUT_OF_VIEW_PX).any(axis=1)
    backwards = RBFInterpolator(source[known] / unit_px, place[known], kernel="cubic", degree=2)
    return interpolate_pixel_map(backwards(coarse_pixel_grid(rectify.raw_shape) / unit_px), rectify.raw_shape)


def make_twin_table(fit: TwinFit, noise_grey_levels: float, told: BoardPressFit | None) -> TwinTable:
    """Return the twin from the ball press, and from the board where its image agrees with the prediction."""
    return TwinTable(
        fitted_gel(fit),
        fit.light,
        noise_grey_levels,
        _twin_fit_quality(fit),
        None if told is None else _board_press_table(told, fit),
    )


def fitted_gel(fit: TwinFit) -> Gel:
    """Return the design's gel with the fitted thickness and share of finite strain."""
    found = {name: fit.parameters[name] for name in ("thickness_mm", "finite_strain")}
    return replace(fit.forward.design.gel, **found)


def _twin_fit_quality(fit: TwinFit) -> TwinFitQuality:
    """Return how the twin was fitted, and how well it explains the press."""
    sure = fit.confidence
    return TwinFitQuality(
        radial_rmse_grey_levels=fit.radial_rmse_grey_levels,
        image_rmse_grey_levels=fit.image_rmse_grey_levels,
        depth_mm=fit.parameters["depth_mm"],
        drag_mm=fit.drag_mm,
        effective_observations=sure.points,
        duration_s=fit.seconds,
        parameters={
            name: FittedParameterTable(value, sure.deviation.get(name), *_strongest_correlation(sure, name))
            for name, value in fit.parameters.items()
        },
    )


def _board_press_table(told: BoardPressFit, fit: TwinFit) -> BoardPressFitTable:
    """Return the fit to the board image. The depth of the imprints is as uncertain as that of the ball, on which the brightness
    model rests.
    """
    depth_mm, ball = told.press.depth_mm, fit.confidence.deviation["depth_mm"] / fit.parameters["depth_mm"]
    return BoardPressFitTable(
        accepted=told.accepted,
        depth_mm=depth_mm,
        depth_std_mm=float(np.hypot(told.deviation.depth_mm, ball * depth_mm)),
        inverse_distance_per_mm=told.press.inverse_distance_per_mm,
        inverse_distance_std_per_mm=told.deviation.inverse_distance_per_mm,
        point_spread_mm=told.press.point_spread_mm,
        residual_rms_grey_levels=told.rest_grey,
        contrast_grey_levels=told.contrast_grey_levels,
    )


def _strongest_correlation(sure: FitUncertainty, name: str) -> tuple[str | None, float | None]:
    """Return the parameter with which a searched parameter is most correlated, and their correlation."""
    return sure.closest(name) if name in sure.deviation else (None, None)

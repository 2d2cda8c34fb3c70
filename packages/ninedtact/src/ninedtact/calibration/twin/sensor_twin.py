"""The digital twin of a calibrated sensor, from gel, light, lens, reference image and noise of its own calibration images
(`assemble_twin`), and the table that a sensor folder keeps of it (`make_twin_table`, from the fits).
"""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.interpolate import RBFInterpolator

from ninedtact.calibration.press_brightness import BgrImage
from ninedtact.calibration.sensor_toml_schema import (
    BoardPressFitTable,
    FittedParameterTable,
    TwinFitQuality,
    TwinTable,
)
from ninedtact.calibration.twin.ball_press_fit import FitUncertainty, TwinFit
from ninedtact.calibration.twin.lens_refinement import BoardPressFit
from ninedtact.design import Gel, SensingArea
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.quantities import skin_grid_mm
from ninedtact.shape.rectification import OUT_OF_VIEW_PX, Rectification
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
        partial(bonded_layer_compliance, gel=gel),
        Renderer(_invert_rectification(rectify), reference.astype(np.float32), light, noise),
        area_mm=area.size_mm,
        thickness_mm=gel.thickness_mm,
        gel_mm=area.gel_mm,
        finite_strain=gel.finite_strain,
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


def make_twin_table(fit: TwinFit, noise_grey_levels: float, board_press_fit: BoardPressFit | None) -> TwinTable:
    """Return the twin from the ball press, and from the board where its image agrees with the prediction."""
    return TwinTable(
        fitted_gel(fit),
        fit.light,
        noise_grey_levels,
        _twin_fit_quality(fit),
        None if board_press_fit is None else _board_press_table(board_press_fit, fit),
    )


def fitted_gel(fit: TwinFit) -> Gel:
    """Return the design's gel with the fitted thickness and share of finite strain."""
    return replace(
        fit.forward.design.gel,
        thickness_mm=fit.press.thickness_mm,
        finite_strain=fit.press.finite_strain,
    )


def _twin_fit_quality(fit: TwinFit) -> TwinFitQuality:
    """Return how the twin was fitted, and how well it explains the press."""
    uncertainty = fit.uncertainty
    return TwinFitQuality(
        radial_rmse_grey_levels=fit.radial_rmse_grey_levels,
        image_rmse_grey_levels=fit.image_rmse_grey_levels,
        depth_mm=fit.press.depth_mm,
        drag_mm=fit.press.drag_mm,
        effective_observations=uncertainty.effective_observations,
        duration_s=fit.duration_s,
        parameters={
            name: FittedParameterTable(
                value, uncertainty.standard_deviations.get(name), *_strongest_correlation(uncertainty, name)
            )
            for name, value in fit.parameters.items()
        },
    )


def _board_press_table(board_press_fit: BoardPressFit, fit: TwinFit) -> BoardPressFitTable:
    """Return the fit to the board image. The depth of the imprints is as uncertain as that of the ball, on which the brightness
    model rests.
    """
    press = board_press_fit.press
    standard_deviations = board_press_fit.standard_deviations
    return BoardPressFitTable(
        accepted=board_press_fit.accepted,
        depth_mm=press.depth_mm,
        depth_std_mm=float(np.hypot(standard_deviations.depth_mm, fit.relative_depth_std * press.depth_mm)),
        inverse_distance_per_mm=press.inverse_distance_per_mm,
        inverse_distance_std_per_mm=standard_deviations.inverse_distance_per_mm,
        point_spread_mm=press.point_spread_mm,
        residual_rms_grey_levels=board_press_fit.residual_rms_grey_levels,
        contrast_grey_levels=board_press_fit.contrast_grey_levels,
    )


def _strongest_correlation(uncertainty: FitUncertainty, name: str) -> tuple[str | None, float | None]:
    """Return the parameter with which a searched parameter is most correlated, and their correlation."""
    if name not in uncertainty.standard_deviations:
        return None, None
    return uncertainty.most_correlated_parameter(name)

"""The table that a sensor folder keeps of its twin: gel, light and noise, and how well they were fitted."""

import numpy as np

from ninedtact.calibration.sensor_toml_schema import (
    BoardPressFitTable,
    FittedParameterTable,
    TwinFitQuality,
    TwinTable,
)
from ninedtact.calibration.twin.ball_press_fit import TwinFit
from ninedtact.calibration.twin.fit_uncertainty import FitUncertainty
from ninedtact.calibration.twin.lens_refinement import BoardPressFit


def make_twin_table(fit: TwinFit, noise_grey_levels: float, board_press_fit: BoardPressFit | None) -> TwinTable:
    """Return the twin from the ball press, and from the board where its image agrees with the prediction."""
    return TwinTable(
        fit.gel,
        fit.light,
        noise_grey_levels,
        _twin_fit_quality(fit),
        None if board_press_fit is None else _board_press_table(board_press_fit, fit),
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

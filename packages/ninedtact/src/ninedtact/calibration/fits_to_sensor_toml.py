"""The fits of a calibration as tables of `sensor.toml`: lens, depth, twin, and the quality of each press for the certificate."""

from dataclasses import fields
from functools import partial

import numpy as np

from ninedtact.calibration.ball.ball_press import BallFit, simulate_height_noise_mm
from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.board.lens_fit import rms_vector_length
from ninedtact.calibration.brightness_change import overexposed_share
from ninedtact.calibration.sensor_toml_schema import (
    BallQuality,
    BoardPressFitTable,
    BoardQuality,
    DepthTable,
    FittedParameterTable,
    LensModelTable,
    PinMapTable,
    SecondPressQuality,
    TwinFitQuality,
    TwinTable,
    make_lens_model_table,
    make_pin_map_table,
)
from ninedtact.calibration.settings import LensKind
from ninedtact.calibration.twin.ball_press_fit import TwinFit
from ninedtact.calibration.twin.fit_parameters import FitUncertainty
from ninedtact.calibration.twin.lens_refinement import BoardPressFit
from ninedtact.design import SensorDesign
from ninedtact.mechanics.base_deflection import STIFFENING
from ninedtact.quantities import BgrImage
from ninedtact.shape.depth import Smoothing
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.simulation.calibration_press_models import BallPressParameters


def lens_to_toml_table(board: BoardFit, kind: LensKind) -> LensModelTable | PinMapTable:
    """Return the chosen lens as a table of `sensor.toml`."""
    if kind == "paper":
        return make_pin_map_table(board.published_map.projection)
    return make_lens_model_table(board.lens, None if board.correction is None else board.correction.correction)


def depth_curve_to_toml_table(
    ball: BallFit, rectify: Rectification, reference: BgrImage, noise_grey_levels: float, smoothing: Smoothing
) -> DepthTable:
    """Return the calibrated depth as a table of `sensor.toml`. reference: the raw image of the skin before the ball."""
    reader = partial(ball.reader, source=rectify.height_source)
    return DepthTable(
        ball.method,
        simulate_height_noise_mm(reader, rectify, reference, noise_grey_levels),
        smoothing,
        ball.curve,
        ball.loss,
        ball.deblurring,
        STIFFENING if ball.base_deflection is None else ball.base_deflection.stiffening,
    )


def twin_to_toml_table(fit: TwinFit, noise_grey_levels: float, board_press_fit: BoardPressFit | None) -> TwinTable:
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


def fitted_ball_press(table: TwinTable) -> BallPressParameters:
    """Return the press of the ball as it was fitted, of a sensor with this table."""
    found = table.fit.parameters
    return BallPressParameters(**{field.name: found[field.name].value for field in fields(BallPressParameters)})


def make_board_quality(board: BoardFit, rectify: Rectification, kind: LensKind) -> BoardQuality:
    """Return the quality of the camera calibration."""
    lens = board.lens_of_kind(kind)
    is_corrected = kind == "model" and board.correction is not None
    return BoardQuality(
        pins_found=int(board.found.sum()),
        pins_expected=board.board.count,
        missing_pins=board.missing_pins,
        leave_one_out_rms_mm=rms_vector_length(lens.leave_one_out_errors_mm),
        leave_one_out_max_mm=float(np.hypot(*lens.leave_one_out_errors_mm.T).max()),
        published_method_rms_mm=board.published_map.leave_one_out_rms_mm,
        mm_per_px=rectify.mm_per_px,
        mm_per_px_std=lens.relative_scale_std * rectify.mm_per_px,
        contrast_grey_levels=float(np.median(board.contrast)),
        noise_grey_levels=board.camera_noise_grey_levels,
        lens=kind,
        camera_rotation_deg=board.mounting,
        uncorrected_rms_mm=board.lens_fit.leave_one_out_rms_mm if is_corrected else None,
    )


def make_ball_quality(reference: BgrImage, ball: BallFit, design: SensorDesign, noise_mm: float) -> BallQuality:
    """Return the quality of the depth calibration."""
    circle = ball.press.circle
    return BallQuality(
        method=ball.method,
        contact_radius_px=circle.radius_px,
        contact_radius_mm=ball.press.edge_radius_mm,
        ball_radius_mm=design.ball.radius_mm,
        max_indentation_mm=ball.max_indentation_mm,
        reconstruction_mae_mm=ball.reconstruction_mae_mm,
        cross_validation_mae_mm=ball.cross_validation_mae_mm,
        range_mm=ball.range_mm,
        noise_mm=noise_mm,
        darkening_grey_levels=circle.darkening_grey_levels,
        asymmetry=circle.asymmetry,
        overexposed_fraction=overexposed_share(reference),
    )


def make_second_press_quality(twin: TwinFit, alone: TwinFit) -> SecondPressQuality:
    """Return the quality of a second press. twin: the fit of the first ball and this press. alone: that of the first ball alone."""
    (second,), deviations = twin.further, twin.uncertainty.standard_deviations
    pressed, first, first_alone = (
        second.object,
        deviations["depth_mm"],
        alone.uncertainty.standard_deviations["depth_mm"],
    )
    return SecondPressQuality(
        pressed.radius_mm,
        second.press.depth_mm,
        deviations["press_2_depth_mm"],
        second.residual_rms_grey_levels,
        twin.press.depth_mm,
        first,
        alone.press.depth_mm,
        first_alone,
        *(pressed.known_depth or (pressed.radius_mm, 0.0)),
        second.implied.mm,
        second.implied.std_mm,
    )

"""The calibration procedure: four images → one calibrated sensor. `calibrate` runs the steps from top to bottom (board, lens, ball,
refinement, certificate); `repeat_calibration` runs them on the images stored in a sensor folder, by any method.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from ninedtact.calibration.ball.ball_fit import BallFit, fit_ball
from ninedtact.calibration.ball.contact_circle import reference_drift_warnings
from ninedtact.calibration.ball.physics_method import PhysicsDepthFit
from ninedtact.calibration.board.board_fit import (
    BoardFit,
    anchored_mm_per_px_std,
    fit_board,
    fit_published_pin_map,
    integer_pin_centres_px,
    published_leave_one_out_errors_mm,
)
from ninedtact.calibration.board.lens_fit import rms_vector_length
from ninedtact.calibration.brightness import OVEREXPOSED, BgrImage, to_grey_float
from ninedtact.calibration.certificate.checks import unusual_fit_warnings
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    BallQuality,
    BoardPressTable,
    BoardQuality,
    Certificate,
    DepthTable,
    FittedParameterTable,
    GridTable,
    LensModelTable,
    PinMapTable,
    SensorRecord,
    TwinFitQuality,
    TwinTable,
)
from ninedtact.calibration.twin.ball_press_fit import ParameterPrior, ParameterUncertainty, TwinFit
from ninedtact.calibration.twin.ball_press_model import ParameterVector
from ninedtact.calibration.twin.lens_refinement import BoardPressFit, JointCalibration, refine_board_and_ball
from ninedtact.design import Gel, SensorDesign
from ninedtact.shape.depth import DepthMethod, Smoothing
from ninedtact.shape.lens import Projection, central_mm_per_px
from ninedtact.shape.rectification import Area, CameraRotation, Rectification, rectification_of_projection
from ninedtact.simulation.sensor_population import fit_deviation

LensKind = Literal["model", "paper"]


@dataclass(frozen=True)
class CalibrationImages:
    """The four raw images, (rows, cols, 3) BGR."""

    board_reference: BgrImage
    board: BgrImage
    ball_reference: BgrImage
    ball: BgrImage


@dataclass(frozen=True)
class CalibrationSettings:
    """Settings of a calibration; the defaults suit every sensor seen so far."""

    lens: LensKind = "model"
    """`paper` reproduces the paper's map (central anchors, equidistant grid, cubic radial basis)."""
    camera_rotation_deg: CameraRotation | Literal["auto"] = "auto"
    """Angle from the image's columns to the sensor's x axis, clockwise on the screen."""
    method: DepthMethod = "physics"
    """`physics` fits contact mechanics and light; `ratio` pairs the ball's cap with the brightness factor, `table` with grey
    differences (the paper's)."""
    smoothing: Smoothing = Smoothing()


@dataclass(frozen=True)
class Calibration:
    """A calibrated sensor, with the images and fits from which it was made."""

    images: CalibrationImages
    board: BoardFit
    ball: BallFit
    rectify: Rectification
    record: SensorRecord


def calibrate(
    images: CalibrationImages,
    design: SensorDesign = SensorDesign(),
    settings: CalibrationSettings = CalibrationSettings(),
    sensor_id: str = "9dtact",
    on_step: Callable[[str], None] = lambda step: None,
) -> Calibration:
    """Calibrate a sensor; raises `BoardNotFound`, `BallPressUnusable`, `ImageUnusable`, whose messages say what to do.

    on_step: called with what is fitted next, in words. Linear algebra runs on one thread meanwhile: its matrices are small, so that
    several threads would mostly wait for each other, at three times the processor time.
    """
    with threadpool_limits(1):
        return _calibrate(images, design, settings, sensor_id, on_step)


def _calibrate(
    images: CalibrationImages,
    design: SensorDesign,
    settings: CalibrationSettings,
    sensor_id: str,
    on_step: Callable[[str], None],
) -> Calibration:
    """Calibrate a sensor, as `calibrate` does."""
    on_step("finding the pins of the board and fitting the lens to them")
    board = fit_board(images.board_reference, images.board, design.pin_board, settings.camera_rotation_deg)
    found = _fit_board_and_ball(images, board, design, settings, on_step)
    board, rectify, ball = found.board, found.rectify, found.ball
    record = SensorRecord(
        format=SENSOR_FORMAT,
        id=sensor_id,
        created=datetime.now(UTC).replace(microsecond=0),
        software=version("ninedtact"),
        design=design,
        grid=GridTable(rectify.mm_per_px, *rectify.raw_shape, rectify.calibrated_area_mm, board.mounting),
        lens=_lens_table(board, settings.lens),
        depth=_depth_table(ball, settings),
        twin=None if ball.physical is None else _twin_table(ball.physical, board.noise, found.told),
        certificate=_make_certificate(images, board, ball, rectify, settings),
    )
    return Calibration(images, board, ball, rectify, record)


def _fit_board_and_ball(
    images: CalibrationImages,
    board: BoardFit,
    design: SensorDesign,
    settings: CalibrationSettings,
    on_step: Callable[[str], None],
) -> JointCalibration:
    """Fit lens and depth; by the method `physics`, board and ball are fitted together."""

    def lens(board: BoardFit) -> Rectification:
        return build_rectification(board, design, settings.lens)

    def ball(
        rectify: Rectification, beliefs: tuple[ParameterPrior, ...] = (), near: ParameterVector | None = None
    ) -> BallFit:
        presses, how = (images.ball_reference, images.ball), (settings.method, settings.smoothing)
        on_step("fitting gel and light to the image of the ball")
        found = fit_ball(rectify, *presses, design, *how, beliefs, near)
        on_step("fitting the depth of the pins and the lens to the image of the board")
        return found

    rectify = lens(board)
    first = JointCalibration(board, rectify, ball(rectify))
    if settings.lens == "paper":
        return first
    return refine_board_and_ball(first, (images.board_reference, images.board), lens, ball)


def build_rectification(board: BoardFit, design: SensorDesign, kind: LensKind) -> Rectification:
    """Return the rectification of the design's grid through the lens fitted to the board."""
    projection, raw_mm_per_px = _choose_projection(board, kind)
    rows, cols = board.change.shape
    mm_per_px = raw_mm_per_px * max(rows, cols) / design.field_of_view.raw_long_side_px
    return rectification_of_projection(
        projection, design.field_of_view, mm_per_px, (rows, cols), calibrated_area_mm(design)
    )


def _choose_projection(board: BoardFit, kind: LensKind) -> tuple[Projection, float]:
    """Return the projection and its mm per raw pixel around the centre."""
    if kind == "paper":
        return fit_published_pin_map(board)
    return board.lens, central_mm_per_px(board.lens, board.board.pitch_mm)


def _lens_table(board: BoardFit, kind: LensKind) -> LensModelTable | PinMapTable:
    """Return the chosen lens as a table of `sensor.toml`."""
    if kind == "paper":
        points_px = integer_pin_centres_px(board)
        return PinMapTable([(x, y) for x, y in board.points_mm.tolist()], [(x, y) for x, y in points_px.tolist()])
    lens = board.lens
    return LensModelTable(lens.homography, lens.centre, lens.radial, lens.tangential)  # type: ignore[arg-type]


def _depth_table(ball: BallFit, settings: CalibrationSettings) -> DepthTable:
    """Return the chosen depth curve as a table of `sensor.toml`."""
    return DepthTable(settings.method, ball.noise_mm, settings.smoothing, ball.curve, ball.loss, ball.deblurring)


def _twin_table(physical: PhysicsDepthFit, noise_grey_levels: float, told: BoardPressFit | None) -> TwinTable:
    """Return the twin from the ball press, and from the board where its image agrees with the prediction."""
    fit = physical.fit
    return TwinTable(
        _fitted_gel(fit),
        fit.light,
        noise_grey_levels,
        _twin_fit_quality(fit),
        None if told is None else _board_press_table(told, fit),
    )


def _fitted_gel(fit: TwinFit) -> Gel:
    """Return the design's gel with the fitted thickness."""
    return replace(fit.forward.design.gel, thickness_mm=fit.parameters["thickness_mm"])


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


def _board_press_table(told: BoardPressFit, fit: TwinFit) -> BoardPressTable:
    """Return the fit to the board image. The depth of the imprints is as uncertain as that of the ball, on which the brightness
    model rests.
    """
    depth_mm, ball = told.press.depth_mm, fit.confidence.deviation["depth_mm"] / fit.parameters["depth_mm"]
    return BoardPressTable(
        accepted=told.accepted,
        depth_mm=depth_mm,
        depth_std_mm=float(np.hypot(told.deviation.depth_mm, ball * depth_mm)),
        inverse_distance_per_mm=told.press.inverse_distance_per_mm,
        inverse_distance_std_per_mm=told.deviation.inverse_distance_per_mm,
        point_spread_mm=told.press.point_spread_mm,
        residual_rms_grey_levels=told.rest_grey,
        contrast_grey_levels=told.contrast_grey_levels,
    )


def _strongest_correlation(sure: ParameterUncertainty, name: str) -> tuple[str | None, float | None]:
    """Return the parameter with which a searched parameter is most correlated, and their correlation."""
    return sure.closest(name) if name in sure.deviation else (None, None)


def calibrated_area_mm(design: SensorDesign) -> Area:
    """Return the area up to one pitch beyond the outermost pins: leaving out an outermost pin tests the lens that far."""
    board = design.pin_board
    x, y = (board.cols + 1) / 2 * board.pitch_mm, (board.rows + 1) / 2 * board.pitch_mm
    return -x, x, -y, y


def _make_certificate(
    images: CalibrationImages, board: BoardFit, ball: BallFit, rectify: Rectification, settings: CalibrationSettings
) -> Certificate:
    """Return the quality figures of both calibrations, and warnings in words."""
    return Certificate(
        _board_quality(board, rectify, settings.lens),
        _ball_quality(images, ball),
        [
            *_board_warnings(board),
            *ball.warnings,
            *reference_drift_warnings(images.board_reference, images.ball_reference),
            *_fit_warnings(ball.physical),
        ],
    )


def _fit_warnings(physical: PhysicsDepthFit | None) -> list[str]:
    """Return the warnings about light and gel as they were fitted."""
    if physical is None:
        return []
    design = physical.fit.forward.design
    deviation = fit_deviation(physical.fit.light, _fitted_gel(physical.fit), design)
    return unusual_fit_warnings(deviation, design)


def _board_quality(board: BoardFit, rectify: Rectification, lens: LensKind) -> BoardQuality:
    """Return the quality of the camera calibration."""
    seen_mm, centres_px = board.points_mm[board.found], integer_pin_centres_px(board)[board.found]
    original_mm = published_leave_one_out_errors_mm(seen_mm, centres_px)
    leave_one_out_errors_mm = original_mm if lens == "paper" else board.lens_fit.leave_one_out_errors_mm
    return BoardQuality(
        pins_found=int(board.found.sum()),
        pins_expected=board.board.count,
        missing_pins=board.missing_pins,
        leave_one_out_rms_mm=rms_vector_length(leave_one_out_errors_mm),
        leave_one_out_max_mm=float(np.hypot(*leave_one_out_errors_mm.T).max()),
        published_method_rms_mm=rms_vector_length(original_mm),
        mm_per_px=rectify.mm_per_px,
        mm_per_px_std=_relative_scale_std(board, lens) * rectify.mm_per_px,
        contrast_grey_levels=float(np.median(board.contrast)),
        noise_grey_levels=board.noise,
        lens=lens,
        camera_rotation_deg=board.mounting,
    )


def _relative_scale_std(board: BoardFit, lens: LensKind) -> float:
    """Return the relative standard error of mm per pixel."""
    pitch_mm = board.board.pitch_mm
    if lens == "paper":
        _, scale = fit_published_pin_map(board)
        return anchored_mm_per_px_std(board.points_mm, integer_pin_centres_px(board), pitch_mm) / scale
    return board.lens_fit.mm_per_px_std(pitch_mm) / central_mm_per_px(board.lens, pitch_mm)


def _ball_quality(images: CalibrationImages, ball: BallFit) -> BallQuality:
    """Return the quality of the depth calibration."""
    circle = ball.press.circle
    return BallQuality(
        method=ball.method,
        contact_radius_px=circle.radius_px,
        contact_radius_mm=ball.press.edge_radius_mm,
        ball_radius_mm=ball.press.ball.radius_mm,
        max_indentation_mm=ball.max_indentation_mm,
        reconstruction_mae_mm=ball.reconstruction_mae_mm,
        cross_validation_mae_mm=ball.cross_validation_mae_mm,
        range_mm=ball.curve.max_indentation_mm,
        noise_mm=ball.noise_mm,
        darkening_grey_levels=circle.drop,
        asymmetry=circle.asymmetry,
        overexposed_fraction=float((to_grey_float(images.ball_reference) >= OVEREXPOSED).mean()),
    )


def _board_warnings(board: BoardFit) -> list[str]:
    """Return the warnings about the board press."""
    found = []
    if board.missing_pins:
        found.append(
            f"found {int(board.found.sum())} of {board.board.count} pins; predicted from the others: "
            f"{'; '.join(board.missing_pins)}; press harder there, or hold the board flatter, for a better lens"
        )
    if board.lens_fit.leave_one_out_rms_mm > 0.04 * board.board.pitch_mm:
        found.append(
            f"pins are predicted only to {board.lens_fit.leave_one_out_rms_mm:.2f} mm (0.03 to 0.06 mm is usual); "
            "focus the camera and press the board evenly"
        )
    return found


def repeat_calibration(folder: SensorFolder, method: DepthMethod) -> Calibration:
    """Calibrate from the stored images, with the stored design, lens and mounting.

    Raises `SensorFolderDamaged` where images are missing (imported sensors have none), and what `calibrate` raises.
    """
    names = CalibrationImages.__dataclass_fields__
    images = CalibrationImages(**{name: folder.stored_image(name).image for name in names})
    record = folder.record
    lens: LensKind = "paper" if isinstance(record.lens, PinMapTable) else "model"
    settings = CalibrationSettings(lens, record.grid.camera_rotation_deg, method, record.depth.smoothing)
    return calibrate(images, record.design, settings, record.id)

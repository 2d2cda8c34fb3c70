"""The calibration procedure: four images → one calibrated sensor. `calibrate` runs the steps from top to bottom (board, lens, ball,
refinement, certificate); `repeat_calibration` runs them on the images stored in a sensor folder, by any method, or with new images
of a ball. Without images of a ball the result only rectifies; with an imported rectification only the ball is fitted.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Literal, get_args

import numpy as np
from threadpoolctl import threadpool_limits

from ninedtact.calibration.ball.ball_fit import BallFit, TwinDepthFit, fit_ball
from ninedtact.calibration.ball.contact_circle import reference_mismatch_warnings
from ninedtact.calibration.board.board_fit import (
    BoardFit,
    fit_board,
    fit_published_projection,
    published_leave_one_out_errors_mm,
    published_mm_per_px_std,
    truncated_spot_centroids_px,
)
from ninedtact.calibration.board.lens_fit import rms_vector_length
from ninedtact.calibration.certificate.checks import unusual_fit_warnings
from ninedtact.calibration.press_brightness import (
    OVEREXPOSED,
    BgrImage,
    estimate_camera_noise,
    flat_fielded_brightness_change,
    to_grey_float,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    BallQuality,
    BoardQuality,
    Certificate,
    DepthTable,
    GridTable,
    LensModelTable,
    PinMapTable,
    SensorTomlRecord,
    make_lens_correction_table,
)
from ninedtact.calibration.twin.ball_press_fit import ParameterPrior
from ninedtact.calibration.twin.ball_press_model import ParameterVector
from ninedtact.calibration.twin.lens_refinement import BoardPressFit, JointCalibration, refine_board_and_ball
from ninedtact.calibration.twin.sensor_twin import fitted_gel, make_twin_table
from ninedtact.design import SensorDesign
from ninedtact.errors import InputError
from ninedtact.shape.depth import DepthMethod, Smoothing
from ninedtact.shape.lens import Projection, central_mm_per_px
from ninedtact.shape.rectification import Area, CameraRotation, Rectification, rectification_of_projection
from ninedtact.simulation.sensor_population import deviation_from_population

LensKind = Literal["model", "paper"]


@dataclass(frozen=True)
class CalibrationImages:
    """The raw images of skin, board, skin and ball, (rows, cols, 3) BGR; the pair of the board or of the ball may be missing."""

    board_reference: BgrImage | None = None
    board: BgrImage | None = None
    ball_reference: BgrImage | None = None
    ball: BgrImage | None = None

    @property
    def board_pair(self) -> tuple[BgrImage, BgrImage] | None:
        """The skin before the board and under it; None where the board was not pressed."""
        return None if self.board_reference is None or self.board is None else (self.board_reference, self.board)

    @property
    def ball_pair(self) -> tuple[BgrImage, BgrImage] | None:
        """The skin before the ball and under it; None where the ball was not pressed."""
        return None if self.ball_reference is None or self.ball is None else (self.ball_reference, self.ball)


class CalibrationImagesMissing(InputError):
    """Too few images: those of the board are needed, or an imported rectification and those of the ball."""


class CalibrationSettingUnknown(InputError):
    """A choice of a calibration is none of those that exist."""


@dataclass(frozen=True)
class CalibrationSettings:
    """Choices of a calibration: lens, camera rotation, depth method and smoothing; the defaults suit every sensor seen so far.

    Raises `CalibrationSettingUnknown` for a choice that does not exist.
    """

    lens: LensKind = "model"
    """`paper` reproduces the paper's map (central anchors, equidistant grid, cubic radial basis)."""
    camera_rotation_deg: CameraRotation | Literal["auto"] = "auto"
    """Angle from the image's columns to the sensor's x axis, clockwise on the screen."""
    method: DepthMethod = "physics"
    """`physics` fits contact mechanics and light; `ratio` pairs the ball's cap with the brightness factor, `table` with grey
    differences (the paper's)."""
    smoothing: Smoothing = Smoothing()

    def __post_init__(self) -> None:
        rotations = (*get_args(CameraRotation), "auto")
        choices = {"lens": get_args(LensKind), "camera_rotation_deg": rotations, "method": get_args(DepthMethod)}
        for name, allowed in choices.items():
            if (value := getattr(self, name)) not in allowed:
                expected = ", ".join(map(repr, allowed))
                raise CalibrationSettingUnknown(f"expected {name} to be one of {expected}, got {value!r}; correct it")


@dataclass(frozen=True)
class Calibration:
    """A calibrated sensor, with the images and fits from which it was made."""

    images: CalibrationImages
    board_fit: BoardFit | None
    """None where the rectification was imported."""
    ball_fit: BallFit | None
    """None where there are no images of a ball."""
    rectify: Rectification
    record: SensorTomlRecord
    imported: SensorFolder | None = None
    """The imported sensor whose rectification this calibration uses."""

    @property
    def board(self) -> BoardFit:
        """The fit of the board, of a calibration that has one."""
        assert self.board_fit is not None, "expected a calibration with a board, got an imported rectification"
        return self.board_fit

    @property
    def ball(self) -> BallFit:
        """The fit of the ball, of a calibration that has one."""
        assert self.ball_fit is not None, "expected a calibration with a ball, got one with the board alone"
        return self.ball_fit


def calibrate(
    images: CalibrationImages,
    design: SensorDesign = SensorDesign(),
    settings: CalibrationSettings = CalibrationSettings(),
    sensor_id: str = "9dtact",
    on_step: Callable[[str], None] = lambda step: None,
    imported: SensorFolder | None = None,
) -> Calibration:
    """Calibrate a sensor; raises `BoardNotFound`, `BallPressUnusable`, `ImageUnusable`, whose messages say what to do, and
    `CalibrationImagesMissing`.

    on_step: called with what is fitted next, in words. imported: a sensor whose rectification is used in place of a board's. Linear
    algebra runs on one thread meanwhile: its matrices are small, so that several threads would mostly wait for each other, at three
    times the processor time.
    """
    with threadpool_limits(1):
        return _calibrate(images, design, settings, sensor_id, on_step, imported)


def _calibrate(
    images: CalibrationImages,
    design: SensorDesign,
    settings: CalibrationSettings,
    sensor_id: str,
    on_step: Callable[[str], None],
    imported: SensorFolder | None,
) -> Calibration:
    """Calibrate a sensor, as `calibrate` does."""
    board: BoardFit | None = None
    ball: BallFit | None = None
    board_press_fit: BoardPressFit | None = None
    if imported is not None and images.ball_pair is not None:
        on_step("fitting gel and light to the image of the ball")
        rectify = imported.rectification
        ball = fit_ball(rectify, *images.ball_pair, design, settings.method, settings.smoothing)
        grid = imported.record.grid
        lens = imported.record.lens
        noise_grey_levels = estimate_camera_noise(flat_fielded_brightness_change(*images.ball_pair))
    elif imported is None and images.board_pair is not None:
        on_step("finding the pins of the board and fitting the lens to them")
        board = fit_board(*images.board_pair, design.pin_board, settings.camera_rotation_deg)
        rectify = build_rectification(board, design, settings.lens)
        if images.ball_pair is not None:
            joint = _fit_board_and_ball(images.board_pair, images.ball_pair, board, rectify, design, settings, on_step)
            board = joint.board
            rectify = joint.rectify
            ball = joint.ball
            board_press_fit = joint.board_press_fit
        grid = GridTable(rectify.mm_per_px, *rectify.raw_shape, rectify.calibrated_area_mm, board.mounting)
        lens = _lens_table(board, settings.lens)
        noise_grey_levels = estimate_camera_noise(board.change)
    else:
        raise CalibrationImagesMissing(
            "expected images of the board, or an imported rectification and images of the ball, got neither; give the images of one"
        )
    physical = None if ball is None else ball.physical
    record = SensorTomlRecord(
        format=SENSOR_FORMAT,
        id=sensor_id,
        created=datetime.now(UTC).replace(microsecond=0),
        software=version("ninedtact"),
        design=design,
        grid=grid,
        lens=lens,
        depth=None if ball is None else _depth_table(ball, settings),
        twin=None if physical is None else make_twin_table(physical.fit, noise_grey_levels, board_press_fit),
        certificate=_make_certificate(images, board, ball, rectify, settings),
    )
    return Calibration(images, board, ball, rectify, record, imported)


def _fit_board_and_ball(
    board_images: tuple[BgrImage, BgrImage],
    ball_images: tuple[BgrImage, BgrImage],
    board: BoardFit,
    rectify: Rectification,
    design: SensorDesign,
    settings: CalibrationSettings,
    on_step: Callable[[str], None],
) -> JointCalibration:
    """Fit lens and depth; by the method `physics`, board and ball are fitted together."""

    # The twin predicts the board through a lens model alone, and the ball by physics alone.
    is_refined = settings.lens != "paper" and settings.method == "physics" and board.correction is None

    def rectification_of(board: BoardFit) -> Rectification:
        return build_rectification(board, design, settings.lens)

    def fit_ball_through(
        rectify: Rectification, priors: tuple[ParameterPrior, ...] = (), initial: ParameterVector | None = None
    ) -> BallFit:
        on_step("fitting gel and light to the image of the ball")
        ball = fit_ball(rectify, *ball_images, design, settings.method, settings.smoothing, priors, initial)
        if is_refined:
            on_step("fitting the depth of the pins and the lens to the image of the board")
        return ball

    separate = JointCalibration(board, rectify, fit_ball_through(rectify))
    if not is_refined:
        return separate
    return refine_board_and_ball(separate, board_images, rectification_of, fit_ball_through)


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
        return fit_published_projection(board)
    return board.projection, central_mm_per_px(board.projection, board.board.pitch_mm)


def _lens_table(board: BoardFit, kind: LensKind) -> LensModelTable | PinMapTable:
    """Return the chosen lens as a table of `sensor.toml`."""
    if kind == "paper":
        points_px = truncated_spot_centroids_px(board)
        return PinMapTable([(x, y) for x, y in board.points_mm.tolist()], [(x, y) for x, y in points_px.tolist()])
    lens = board.lens
    table = None if board.correction is None else make_lens_correction_table(board.correction.correction)
    return LensModelTable(lens.homography, lens.centre, lens.radial, lens.tangential, table)  # type: ignore[arg-type]


def _depth_table(ball: BallFit, settings: CalibrationSettings) -> DepthTable:
    """Return the chosen depth curve as a table of `sensor.toml`."""
    return DepthTable(settings.method, ball.noise_mm, settings.smoothing, ball.curve, ball.loss, ball.deblurring)


def calibrated_area_mm(design: SensorDesign) -> Area:
    """Return the area up to one pitch beyond the outermost pins: leaving out an outermost pin tests the lens that far."""
    board = design.pin_board
    half_width_mm = (board.cols + 1) / 2 * board.pitch_mm
    half_height_mm = (board.rows + 1) / 2 * board.pitch_mm
    return -half_width_mm, half_width_mm, -half_height_mm, half_height_mm


def _make_certificate(
    images: CalibrationImages,
    board: BoardFit | None,
    ball: BallFit | None,
    rectify: Rectification,
    settings: CalibrationSettings,
) -> Certificate:
    """Return the quality figures of both calibrations, and warnings in words."""
    warnings = [IMPORTED_LENS_WARNING] if board is None else board.warnings
    warnings += [BALL_MISSING_WARNING] if ball is None else [*ball.warnings, *_fit_warnings(ball.physical)]
    if images.board_pair is not None and images.ball_pair is not None:
        warnings += reference_mismatch_warnings(images.board_pair[0], images.ball_pair[0])
    return Certificate(
        None if board is None else _board_quality(board, rectify, settings.lens),
        None if ball is None or images.ball_pair is None else _ball_quality(images.ball_pair[0], ball),
        warnings,
    )


IMPORTED_LENS_WARNING = (
    "the rectification was imported from the original project and is used as it is; no pin tests it here, and the scale in mm is "
    "that of the import; press the pin board and calibrate again for a lens with known errors"
)
BALL_MISSING_WARNING = (
    "no ball has been pressed: heights, force, 'ninedtact check' and the twin are missing; to add them, press the ball and run "
    "'ninedtact calibrate' with --ball-reference, --ball and this folder as --out"
)


def _fit_warnings(physical: TwinDepthFit | None) -> list[str]:
    """Return the warnings about light and gel as they were fitted."""
    if physical is None:
        return []
    design = physical.fit.forward.design
    deviation = deviation_from_population(physical.fit.light, fitted_gel(physical.fit), design)
    return unusual_fit_warnings(deviation, design)


def _board_quality(board: BoardFit, rectify: Rectification, lens: LensKind) -> BoardQuality:
    """Return the quality of the camera calibration."""
    centroids_px = truncated_spot_centroids_px(board)[board.found]
    published_errors_mm = published_leave_one_out_errors_mm(board.points_mm[board.found], centroids_px)
    leave_one_out_errors_mm = published_errors_mm if lens == "paper" else board.leave_one_out_errors_mm
    is_corrected = lens == "model" and board.correction is not None
    return BoardQuality(
        pins_found=int(board.found.sum()),
        pins_expected=board.board.count,
        missing_pins=board.missing_pins,
        leave_one_out_rms_mm=rms_vector_length(leave_one_out_errors_mm),
        leave_one_out_max_mm=float(np.hypot(*leave_one_out_errors_mm.T).max()),
        published_method_rms_mm=rms_vector_length(published_errors_mm),
        mm_per_px=rectify.mm_per_px,
        mm_per_px_std=_relative_scale_std(board, lens) * rectify.mm_per_px,
        contrast_grey_levels=float(np.median(board.contrast)),
        noise_grey_levels=estimate_camera_noise(board.change),
        lens=lens,
        camera_rotation_deg=board.mounting,
        uncorrected_rms_mm=board.lens_fit.leave_one_out_rms_mm if is_corrected else None,
    )


def _relative_scale_std(board: BoardFit, lens: LensKind) -> float:
    """Return the relative standard error of mm per pixel."""
    pitch_mm = board.board.pitch_mm
    if lens == "paper":
        _, scale = fit_published_projection(board)
        return published_mm_per_px_std(board.points_mm, truncated_spot_centroids_px(board), pitch_mm) / scale
    return board.lens_fit.mm_per_px_std(pitch_mm) / central_mm_per_px(board.lens, pitch_mm)


def _ball_quality(reference: BgrImage, ball: BallFit) -> BallQuality:
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
        overexposed_fraction=float((to_grey_float(reference) >= OVEREXPOSED).mean()),
    )


def repeat_calibration(
    folder: SensorFolder,
    method: DepthMethod,
    ball: tuple[BgrImage, BgrImage] | None = None,
    design: SensorDesign | None = None,
    on_step: Callable[[str], None] = lambda step: None,
) -> Calibration:
    """Calibrate from the stored images, with the stored lens and mounting, or through the imported rectification.

    ball: new images of the skin before the ball and under it, in place of stored ones. design: in place of the stored one. Raises
    `SensorFolderDamaged` where images are missing, `DepthNotCalibrated` where none of a ball are stored or given, and what
    `calibrate` raises.
    """
    names = ("ball_reference", "ball") if folder.is_imported else ("board_reference", "board", "ball_reference", "ball")
    new = {} if ball is None else {"ball_reference": ball[0], "ball": ball[1]}
    images = CalibrationImages(
        **{name: new[name] if name in new else folder.stored_image(name).image for name in names}
    )
    record = folder.record
    lens: LensKind = "paper" if isinstance(record.lens, PinMapTable) else "model"
    smoothing = Smoothing() if record.depth is None else record.depth.smoothing
    settings = CalibrationSettings(lens, record.grid.camera_rotation_deg, method, smoothing)
    imported = folder if folder.is_imported else None
    return calibrate(images, design or record.design, settings, record.id, on_step, imported)

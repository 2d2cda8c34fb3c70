"""Four images → one sensor: the whole calibration, top-down.

A sensor's folder → the calibration that its own images give, by any method.
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Literal

import numpy as np

from ninedtact.calibration.ball.ball_fit import BallFit, Method, fit_ball
from ninedtact.calibration.ball.contact_circle import reference_warnings
from ninedtact.calibration.ball.physics_method import PhysicalBall
from ninedtact.calibration.board.board_fit import BoardFit, fit_board
from ninedtact.calibration.board.lattice import Mounting
from ninedtact.calibration.board.lens_fit import rms_length
from ninedtact.calibration.board.published_method import (
    anchored_mm_per_px_error,
    integer_centres,
    left_out_errors_mm,
    paper_projection,
)
from ninedtact.calibration.brightness import OVEREXPOSED, Image, grey_float
from ninedtact.calibration.lens_refinement import BoardPressFit, Together, in_turns
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.sensor_record import (
    FORMAT,
    BallFigures,
    BoardFigures,
    Certificate,
    Depth,
    FitFigures,
    FittedParameter,
    Grid,
    ImprintFigures,
    LensTable,
    PinTable,
    SensorRecord,
    TwinTable,
)
from ninedtact.calibration.twin.ball_press_fit import Belief, Confidence, TwinFit
from ninedtact.calibration.twin.ball_press_model import Vector
from ninedtact.capture.image_file import read_image
from ninedtact.design import SensorDesign
from ninedtact.shape.depth import Smoothing
from ninedtact.shape.lens import Projection, central_mm_per_px
from ninedtact.shape.rectification import Area, Rectification, rectification

LensKind = Literal["lens", "paper"]


@dataclass(frozen=True)
class CalibrationImages:
    """The four raw images, (rows, cols, 3) BGR."""

    board_reference: Image
    board: Image
    ball_reference: Image
    ball: Image


@dataclass(frozen=True)
class CalibrationSettings:
    """How to calibrate; the defaults suit every sensor seen so far."""

    lens: LensKind = "lens"
    """`paper` reproduces the paper's map (central anchors, equidistant grid, cubic radial basis)."""
    mounting_deg: Mounting | Literal["auto"] = "auto"
    """Angle from the image's columns to the sensor's x axis, clockwise on the screen."""
    method: Method = "physics"
    """`physics` fits contact mechanics and light; `ratio` pairs the ball's cap with the brightness factor, `table` with grey
    differences (the paper's)."""
    smoothing: Smoothing = Smoothing()


@dataclass(frozen=True)
class Calibration:
    """A calibrated sensor with all that it was made from."""

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
) -> Calibration:
    """Calibrate a sensor; raises `BoardNotFound`, `BallRefused`, `ImageUnusable`, each saying what to do."""
    board = fit_board(images.board_reference, images.board, design.pin_board, settings.mounting_deg)
    found = explained(images, board, design, settings)
    board, rectify, ball = found.board, found.rectify, found.ball
    record = SensorRecord(
        format=FORMAT,
        id=sensor_id,
        created=datetime.now(UTC).replace(microsecond=0),
        software=version("ninedtact"),
        design=design,
        grid=Grid(rectify.mm_per_px, *rectify.raw_shape, rectify.calibrated_area_mm, board.mounting),
        lens=lens_table(board, settings.lens),
        depth=depth_table(ball, settings),
        twin=None if ball.physical is None else twin_table(ball.physical, board.noise, found.told),
        certificate=certificate(images, board, ball, rectify, settings),
    )
    return Calibration(images, board, ball, rectify, record)


def explained(
    images: CalibrationImages, board: BoardFit, design: SensorDesign, settings: CalibrationSettings
) -> Together:
    """Lens and depth; by physics, board and ball together."""

    def lens(board: BoardFit) -> Rectification:
        return lens_on_grid(board, design, settings.lens)

    def ball(rectify: Rectification, beliefs: tuple[Belief, ...] = (), near: Vector | None = None) -> BallFit:
        presses, how = (images.ball_reference, images.ball), (settings.method, settings.smoothing)
        return fit_ball(rectify, *presses, design, *how, beliefs, near)

    rectify = lens(board)
    first = Together(board, rectify, ball(rectify))
    if settings.lens == "paper":
        return first
    return in_turns(first, (images.board_reference, images.board), lens, ball)


def lens_on_grid(board: BoardFit, design: SensorDesign, kind: LensKind) -> Rectification:
    """The rectified grid that the design asks for, seen through the lens that the board gave."""
    projection, raw_mm_per_px = chosen_lens(board, kind)
    rows, cols = board.change.shape
    mm_per_px = raw_mm_per_px * max(rows, cols) / design.field_of_view.raw_long_side_px
    return rectification(projection, design.field_of_view, mm_per_px, (rows, cols), calibrated_area_mm(design))


def chosen_lens(board: BoardFit, kind: LensKind) -> tuple[Projection, float]:
    """The projection and its mm per raw pixel around the centre."""
    if kind == "paper":
        return paper_projection(board)
    return board.lens, central_mm_per_px(board.lens, board.board.pitch_mm)


def lens_table(board: BoardFit, kind: LensKind) -> LensTable | PinTable:
    """The chosen lens as the sensor's file holds it."""
    if kind == "paper":
        points_px = integer_centres(board)
        return PinTable([(x, y) for x, y in board.points_mm.tolist()], [(x, y) for x, y in points_px.tolist()])
    lens = board.lens
    return LensTable(lens.homography, lens.centre, lens.radial, lens.tangential)  # type: ignore[arg-type]


def depth_table(ball: BallFit, settings: CalibrationSettings) -> Depth:
    """The chosen depth reading as the sensor's file holds it."""
    return Depth(settings.method, ball.noise_mm, settings.smoothing, ball.curve, ball.loss, ball.deblurring)


def twin_table(physical: PhysicalBall, noise_grey_levels: float, told: BoardPressFit | None) -> TwinTable:
    """The twin that the ball press told, and the board where it was like what it draws."""
    fit = physical.fit
    gel = replace(fit.forward.design.gel, thickness_mm=fit.named["thickness_mm"])
    return TwinTable(
        gel, fit.light, noise_grey_levels, fit_figures(fit), None if told is None else imprint_figures(told, fit)
    )


def fit_figures(fit: TwinFit) -> FitFigures:
    """How the twin was found, and how well it explains the press."""
    sure = fit.confidence
    return FitFigures(
        rmse_grey_radial=fit.rmse_grey_radial,
        rmse_grey_image=fit.rmse_grey_image,
        depth_mm=fit.named["depth_mm"],
        drag_mm=fit.drag_mm,
        independent_points=sure.points,
        seconds=fit.seconds,
        parameters={
            name: FittedParameter(value, sure.deviation.get(name), *closest(sure, name))
            for name, value in fit.named.items()
        },
    )


def imprint_figures(told: BoardPressFit, fit: TwinFit) -> ImprintFigures:
    """What the board's image told of its imprints; their depth is as uncertain as the ball's, by which light tells depth."""
    depth_mm, ball = told.press.depth_mm, fit.confidence.deviation["depth_mm"] / fit.named["depth_mm"]
    return ImprintFigures(
        believed=told.believed,
        depth_mm=depth_mm,
        depth_error_mm=float(np.hypot(told.deviation.depth_mm, ball * depth_mm)),
        nearness_per_mm=told.press.nearness_per_mm,
        nearness_error_per_mm=told.deviation.nearness_per_mm,
        point_spread_mm=told.press.point_spread_mm,
        unexplained_grey=told.rest_grey,
        contrast_grey=told.contrast_grey,
    )


def closest(sure: Confidence, name: str) -> tuple[str | None, float | None]:
    """What a searched parameter is hardest to tell from, and their correlation."""
    return sure.closest(name) if name in sure.deviation else (None, None)


def calibrated_area_mm(design: SensorDesign) -> Area:
    """One pitch beyond the outermost pins: as far as leaving out an outermost pin tests the lens."""
    board = design.pin_board
    x, y = (board.cols + 1) / 2 * board.pitch_mm, (board.rows + 1) / 2 * board.pitch_mm
    return -x, x, -y, y


def certificate(
    images: CalibrationImages, board: BoardFit, ball: BallFit, rectify: Rectification, settings: CalibrationSettings
) -> Certificate:
    """All figures, and what a person should know in words."""
    return Certificate(
        board_figures(board, rectify, settings.lens),
        ball_figures(images, ball),
        [
            *board_warnings(board),
            *ball.warnings,
            *reference_warnings(images.board_reference, images.ball_reference),
        ],
    )


def board_figures(board: BoardFit, rectify: Rectification, lens: LensKind) -> BoardFigures:
    """How good the camera calibration is."""
    seen_mm, centres_px = board.points_mm[board.found], integer_centres(board)[board.found]
    original_mm = left_out_errors_mm(seen_mm, centres_px)
    left_out_mm = original_mm if lens == "paper" else board.lens_fit.left_out_mm
    return BoardFigures(
        pins_found=int(board.found.sum()),
        pins_expected=board.board.count,
        missing=board.missing,
        loo_rms_mm=rms_length(left_out_mm),
        loo_max_mm=float(np.hypot(*left_out_mm.T).max()),
        loo_rms_mm_original=rms_length(original_mm),
        mm_per_px=rectify.mm_per_px,
        mm_per_px_error=scale_error(board, lens) * rectify.mm_per_px,
        contrast_grey_levels=float(np.median(board.contrast)),
        noise_grey_levels=board.noise,
        lens=lens,
        mounting_deg=board.mounting,
    )


def scale_error(board: BoardFit, lens: LensKind) -> float:
    """Standard error of mm per pixel, relative."""
    pitch_mm = board.board.pitch_mm
    if lens == "paper":
        _, scale = paper_projection(board)
        return anchored_mm_per_px_error(board.points_mm, integer_centres(board), pitch_mm) / scale
    return board.lens_fit.mm_per_px_error(pitch_mm) / central_mm_per_px(board.lens, pitch_mm)


def ball_figures(images: CalibrationImages, ball: BallFit) -> BallFigures:
    """How good the depth calibration is."""
    circle = ball.press.circle
    return BallFigures(
        method=ball.method,
        radius_px=circle.radius_px,
        radius_mm=ball.press.edge_radius_mm,
        ball_radius_mm=ball.press.ball.radius_mm,
        deepest_mm=ball.deepest_mm,
        fit_mae_mm=ball.fit_mae_mm,
        half_mae_mm=ball.half_mae_mm,
        range_mm=ball.curve.max_indentation_mm,
        noise_mm=ball.noise_mm,
        drop_grey_levels=circle.drop,
        asymmetry=circle.asymmetry,
        overexposed=float((grey_float(images.ball_reference) >= OVEREXPOSED).mean()),
    )


def board_warnings(board: BoardFit) -> list[str]:
    """What a person should know about the board press."""
    found = []
    if board.missing:
        found.append(
            f"found {int(board.found.sum())} of {board.board.count} pins; predicted from the others: "
            f"{'; '.join(board.missing)}; press harder there, or hold the board flatter, for a better lens"
        )
    if board.lens_fit.left_out_rms_mm > 0.04 * board.board.pitch_mm:
        found.append(
            f"pins are predicted only to {board.lens_fit.left_out_rms_mm:.2f} mm (0.03 to 0.06 mm is usual); "
            "focus the camera and press the board evenly"
        )
    return found


def calibrated_again(folder: SensorFolder, method: Method) -> Calibration:
    """Calibrate from the stored images, with the stored design, lens and mounting.

    Raises `SensorFolderDamaged` where images are missing (imported sensors have none), and what `calibrate` raises.
    """
    names = CalibrationImages.__dataclass_fields__
    images = CalibrationImages(**{name: folder.image(name, read_image).image for name in names})
    record = folder.record
    lens: LensKind = "paper" if isinstance(record.lens, PinTable) else "lens"
    settings = CalibrationSettings(lens, record.grid.mounting_deg, method, record.depth.smoothing)
    return calibrate(images, record.design, settings, record.id)

"""The calibration procedure: four images → one calibrated sensor. `calibrate` runs the steps from top to bottom (board, lens, ball,
refinement, certificate); `repeat_calibration` runs them on the images stored in a sensor folder, by any method, or with new images
of a ball. Without images of a ball the result only rectifies; with an imported rectification only the ball is fitted.

The refinement alternates two fits. The ball image gives light and gel, by which the twin predicts the board image; the board image
gives the depth of its imprints, the viewing distance and so the lens; the ball is then fitted again through that lens.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from itertools import chain

from msgspec import structs
from threadpoolctl import threadpool_limits

from ninedtact.bounds import checks_arguments
from ninedtact.calibration.ball.ball_fit import TwinBallFit, fit_ball, fit_ball_by_physics
from ninedtact.calibration.ball.ball_press import BallFit, find_ball_press
from ninedtact.calibration.ball.contact_circle import BallPressUnusable, reference_mismatch_warnings
from ninedtact.calibration.ball.second_press import find_second_presses
from ninedtact.calibration.board.board_fit import BoardFit, build_rectification, fit_board
from ninedtact.calibration.brightness_change import (
    different_skin_warnings,
    estimate_camera_noise,
    flat_fielded_brightness_change,
)
from ninedtact.calibration.certificate.checks import little_gain_warnings, press_through_gel_warnings
from ninedtact.calibration.certificate.length_evidence import assess_stated_lengths
from ninedtact.calibration.diagnosis import find_image_cause, find_probable_cause
from ninedtact.calibration.fits_to_sensor_toml import (
    depth_curve_to_toml_table,
    lens_to_toml_table,
    make_ball_quality,
    make_board_quality,
    make_second_press_quality,
    twin_to_toml_table,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    Certificate,
    GridTable,
    LensModelTable,
    PinMapTable,
    PixelMapTable,
    ProbableCause,
    SecondPressQuality,
    SensorTomlRecord,
    require_sensor_id,
)
from ninedtact.calibration.settings import CalibrationSettings, LensKind
from ninedtact.calibration.twin.ball_press_fit import TwinFit, fit_twin_to_ball_press
from ninedtact.calibration.twin.lens_refinement import BoardPressFit, fit_board_press_and_lens, refine_board_lens
from ninedtact.calibration.twin.observed_presses import ObservedBoardPress
from ninedtact.design import SECOND_KINDS, SecondKind, SensorDesign
from ninedtact.errors import CalibrationError, InputError
from ninedtact.quantities import BgrImage, Frame, HeightSource
from ninedtact.shape.depth import DepthMethod, Smoothing
from ninedtact.shape.lens_and_rectification import Rectification

_MAX_ALTERNATIONS = 2
"""Number of alternations between board and ball. The first starts from the light of a preliminary lens and viewing distance; the
second corrects the effect of that.
"""


BOARD_NAMES, BALL_NAMES = ("board_reference", "board"), ("ball_reference", "ball")
"""Names of the two images of each press, as fields of `CalibrationImages` and as files of a folder."""


def second_image_names(kind: SecondKind) -> tuple[str, str]:
    """Return the names of the two images of a second press, likewise."""
    return f"{kind}_reference", kind


@checks_arguments
@dataclass(frozen=True)
class CalibrationImages:
    """The raw images of skin, board, skin and ball, (rows, cols, 3) BGR; the pair of the board or of the ball may be missing.

    A second press, of a ball of another radius or of a flat end at a known depth, tells the base of the gel, and so the true depth.
    """

    board_reference: BgrImage | None = None
    board: BgrImage | None = None
    ball_reference: BgrImage | None = None
    ball: BgrImage | None = None
    second_ball_reference: BgrImage | None = None
    second_ball: BgrImage | None = None
    flat_end_reference: BgrImage | None = None
    flat_end: BgrImage | None = None

    @property
    def board_pair(self) -> tuple[BgrImage, BgrImage] | None:
        """The skin before the board and under it; None where the board was not pressed."""
        return None if self.board_reference is None or self.board is None else (self.board_reference, self.board)

    @property
    def ball_pair(self) -> tuple[BgrImage, BgrImage] | None:
        """The skin before the ball and under it; None where the ball was not pressed."""
        return None if self.ball_reference is None or self.ball is None else (self.ball_reference, self.ball)

    @property
    def second_pairs(self) -> dict[SecondKind, tuple[BgrImage, BgrImage]]:
        """The skin before each second object that was pressed, and under it."""
        pairs = {kind: [getattr(self, name) for name in second_image_names(kind)] for kind in SECOND_KINDS}
        return {kind: (pair[0], pair[1]) for kind, pair in pairs.items() if all(image is not None for image in pair)}


@dataclass(frozen=True)
class CalibrationFits:
    """The fits of board and ball, and the rectification through which the ball was fitted."""

    board: BoardFit | None
    """None where the rectification was imported."""
    rectify: Rectification
    ball: BallFit | None = None
    """None where there are no images of a ball."""
    board_press: BoardPressFit | None = None
    """The fit of the twin to the board image; None where no twin predicts it."""

    @property
    def twin(self) -> TwinFit | None:
        """The fit of the twin to the ball image; None where the method of the ball's fit has no twin."""
        return self.ball.twin_fit if isinstance(self.ball, TwinBallFit) else None


@dataclass(frozen=True)
class Calibration:
    """A calibrated sensor, with the images and fits from which it was made."""

    images: CalibrationImages
    fits: CalibrationFits
    record: SensorTomlRecord
    imported: SensorFolder | None = None
    """The imported sensor whose rectification this calibration uses."""

    @property
    def rectify(self) -> Rectification:
        """The rectification of the sensor."""
        return self.fits.rectify

    @property
    def board(self) -> BoardFit:
        """The fit of the board, of a calibration that has one."""
        assert self.fits.board is not None, "expected a calibration with a board, got an imported rectification"
        return self.fits.board

    @property
    def ball(self) -> BallFit:
        """The fit of the ball, of a calibration that has one."""
        assert self.fits.ball is not None, "expected a calibration with a ball, got one with the board alone"
        return self.fits.ball


@checks_arguments
def calibrate(
    images: CalibrationImages,
    design: SensorDesign = SensorDesign(),
    settings: CalibrationSettings = CalibrationSettings(),
    sensor_id: str = "9dtact",
    on_step: Callable[[str], None] = lambda step: None,
    imported: SensorFolder | None = None,
) -> Calibration:
    """Calibrate a sensor; raises `BoardNotFound`, `BallPressUnusable`, `CalibrationError`, whose messages say what to do, and
    `InputError`.

    on_step: called with what is fitted next, in words. imported: a sensor whose rectification is used in place of a board's. Linear
    algebra runs on one thread meanwhile: its matrices are small, so that several threads would mostly wait for each other, at three
    times the processor time.
    """
    require_sensor_id(sensor_id)
    with threadpool_limits(1):
        cause = find_image_cause(images.board_pair, images.ball_pair)
        try:
            fits = _fit_presses(images, design, settings, on_step, imported)
        except CalibrationError as refusal:
            if cause is not None:
                refusal.append(cause.sentence)
            raise
        record = _make_record(images, fits, design, settings, sensor_id, imported, cause)
    return Calibration(images, fits, record, imported)


def _fit_presses(
    images: CalibrationImages,
    design: SensorDesign,
    settings: CalibrationSettings,
    on_step: Callable[[str], None],
    imported: SensorFolder | None,
) -> CalibrationFits:
    """Fit the lens to the board, unless it is imported, and the depth to the ball, unless its images are missing."""
    board: BoardFit | None = None
    if imported is not None and images.ball_pair is not None:
        rectify = imported.rectification
    elif imported is None and images.board_pair is not None:
        on_step("finding the pins of the board and fitting the lens to them")
        board = fit_board(*images.board_pair, design.pin_board, settings.camera_rotation_deg, settings.camera_mirrored)
        rectify = build_rectification(board, design, settings.lens)
    else:
        raise InputError(
            expected="images of the board, or an imported rectification and images of the ball",
            got="neither",
            remedy="give the images of one",
        )
    if images.ball_pair is None:
        return CalibrationFits(board, rectify)
    on_step("fitting gel and light to the image of the ball")
    second = find_second_presses(rectify, images.second_pairs, design, settings.method)
    ball = fit_ball(rectify, *images.ball_pair, design, settings.method, settings.smoothing, second)
    fits = CalibrationFits(board, rectify, ball)
    # The twin predicts the board through a lens model alone.
    if board is None or board.correction is not None or settings.lens == "paper":
        return fits
    return _alternate_board_and_ball(fits, images, design, settings, on_step)


def _alternate_board_and_ball(
    fits: CalibrationFits,
    images: CalibrationImages,
    design: SensorDesign,
    settings: CalibrationSettings,
    on_step: Callable[[str], None],
) -> CalibrationFits:
    """Return the fits after lens and ball were fitted in turn, each with what the image of the other shows.

    Where the board image disagrees with the twin's prediction, or the ball cannot be fitted through the refined lens, the fits stay
    as they were before. Without a twin, nothing is fitted again.
    """
    for _ in range(_MAX_ALTERNATIONS):
        board, twin, board_pair, ball_pair = fits.board, fits.twin, images.board_pair, images.ball_pair
        if board is None or twin is None or board_pair is None or ball_pair is None:
            return fits
        on_step("fitting the depth of the pins and the lens to the image of the board")
        before, after = (fits.rectify(Frame(image)) for image in board_pair)
        board_press = fit_board_press_and_lens(ObservedBoardPress(before, after, board), twin, fits.board_press)
        if not board_press.accepted:
            return replace(fits, board_press=fits.board_press or board_press)
        refined = refine_board_lens(board, twin, board_press)
        rectify = build_rectification(refined, design)
        on_step("fitting gel and light to the image of the ball")
        try:
            press = find_ball_press(rectify, *ball_pair, design.ball, "physics")
            second = find_second_presses(rectify, images.second_pairs, design, settings.method)
            # What the board tells of the view may lead to another base, which is estimated anew once.
            base = None if fits.board_press is None else twin.base
            ball = fit_ball_by_physics(press, design, board_press.priors, twin.presses, second, base)
        except BallPressUnusable:
            return fits
        fits = CalibrationFits(refined, rectify, ball, board_press)
    return fits


def _make_record(
    images: CalibrationImages,
    fits: CalibrationFits,
    design: SensorDesign,
    settings: CalibrationSettings,
    sensor_id: str,
    imported: SensorFolder | None,
    cause_in_images: ProbableCause | None,
) -> SensorTomlRecord:
    """Return the calibration as the tables of `sensor.toml`."""
    board, rectify = fits.board, fits.rectify
    grid: GridTable
    lens: LensModelTable | PinMapTable | PixelMapTable
    if board is None:
        assert imported is not None, "expected a fit of the board or an imported rectification, got neither"
        grid, lens = imported.record.grid, imported.record.lens
    else:
        grid = GridTable(
            rectify.mm_per_px, *rectify.raw_shape, rectify.calibrated_area_mm, board.mounting, settings.camera_mirrored
        )
        lens = lens_to_toml_table(board, settings.lens)
    depth, twin, ball_quality = None, None, None
    if fits.ball is not None and images.ball_pair is not None:
        # A height against an averaged reference contains the noise of one image.
        noise_grey_levels = estimate_camera_noise(flat_fielded_brightness_change(*images.ball_pair))
        depth = depth_curve_to_toml_table(
            fits.ball, rectify, images.ball_pair[0], noise_grey_levels, settings.smoothing
        )
        ball_quality = make_ball_quality(images.ball_pair[0], fits.ball, design, depth.noise_mm)
        if fits.twin is not None:
            noise_grey_levels = noise_grey_levels if board is None else board.camera_noise_grey_levels
            twin = twin_to_toml_table(fits.twin, noise_grey_levels, fits.board_press)
    board_quality = None if board is None else make_board_quality(board, rectify, settings.lens)
    lengths = assess_stated_lengths(board, fits.twin, design)
    second = _second_press_qualities(images, fits, design)
    warnings = _warnings(images, fits, design) + little_gain_warnings(second)
    certificate = Certificate(
        board_quality, ball_quality, second.get("second_ball"), second.get("flat_end"), lengths, warnings
    )
    is_impossible = fits.ball is not None and bool(press_through_gel_warnings(fits.ball.max_indentation_mm, design.gel))
    cause = find_probable_cause(certificate, cause_in_images, _turned_board_warning(fits), is_impossible)
    return SensorTomlRecord(
        format=SENSOR_FORMAT,
        id=sensor_id,
        created=datetime.now(UTC).replace(microsecond=0),
        software=version("ninedtact"),
        design=design,
        grid=grid,
        lens=lens,
        depth=depth,
        twin=twin,
        certificate=structs.replace(certificate, cause=cause),
    )


IMPORTED_LENS_WARNING = (
    "the rectification was imported from the original project and is used as it is; no pin tests it here, and the scale in mm is "
    "that of the import; press the pin board and calibrate again for a lens with known errors"
)
_MAX_OUT_OF_VIEW = 0.08
"""Share of the height map that the camera may not see: at most 0.01 of real sensors, 0.17 where the board is turned by 90°."""
TURNED_BOARD_WARNING = (
    "{:.0%} of the height map is out of the camera's view: the board lies across the image, or the mode of the camera cuts it; "
    "were the board or the camera turned by 90° (--camera-rotation-deg), or the design's numbers of rows and columns exchanged?"
)
BALL_MISSING_WARNING = (
    "no ball has been pressed: heights, force, 'ninedtact check' and the twin are missing; to add them, press the ball and run "
    "'ninedtact calibrate' with --ball-reference, --ball and this folder as --out"
)


def _warnings(images: CalibrationImages, fits: CalibrationFits, design: SensorDesign) -> list[str]:
    """Return what makes the calibration doubtful, in words."""
    warnings = [IMPORTED_LENS_WARNING] if fits.board is None else fits.board.warnings
    turned = _turned_board_warning(fits)
    warnings += [] if turned is None else [turned]
    warnings += [BALL_MISSING_WARNING] if fits.ball is None else []
    if fits.ball is not None:
        warnings += press_through_gel_warnings(fits.ball.max_indentation_mm, design.gel)
    if images.board_pair is not None and images.ball_pair is not None:
        references = images.board_pair[0], images.ball_pair[0]
        warnings += [*reference_mismatch_warnings(*references), *different_skin_warnings(*references)]
    for kind, (reference, _) in images.second_pairs.items():
        if images.ball_pair is not None:
            warnings += different_skin_warnings(images.ball_pair[0], reference, "ball", kind.replace("_", " "))
    return warnings


def _second_press_qualities(
    images: CalibrationImages, fits: CalibrationFits, design: SensorDesign
) -> dict[SecondKind, SecondPressQuality]:
    """Return the quality of every second press.

    The first press is fitted again alone, and of several second presses with each alone, to compare its depth.
    """
    if fits.ball is None or fits.twin is None or not fits.twin.further:
        return {}
    priors = () if fits.board_press is None else fits.board_press.priors
    fit_with = partial(fit_twin_to_ball_press, fits.ball.press, design, priors)
    alone, presses = fit_with(), find_second_presses(fits.rectify, images.second_pairs, design, "physics")
    with_each = {one.object.kind: fits.twin if len(presses) == 1 else fit_with(further=(one,)) for one in presses}
    return {kind: make_second_press_quality(twin, alone) for kind, twin in with_each.items()}


def _turned_board_warning(fits: CalibrationFits) -> str | None:
    """Return that much of the height map is out of view, in words, or None."""
    out_of_view = float((fits.rectify.height_source == HeightSource.OUT_OF_VIEW).mean())
    return (
        TURNED_BOARD_WARNING.format(out_of_view) if fits.board is not None and out_of_view > _MAX_OUT_OF_VIEW else None
    )


def repeat_calibration(
    folder: SensorFolder,
    method: DepthMethod,
    new: CalibrationImages = CalibrationImages(),
    design: SensorDesign | None = None,
    on_step: Callable[[str], None] = lambda step: None,
    smoothing: Smoothing | None = None,
) -> Calibration:
    """Calibrate from the stored images, with the stored lens and mounting, or through the imported rectification.

    new: images of the ball and of second presses in place of stored ones; the method `physics` alone uses second presses. design,
    smoothing: in place of the stored ones. Raises `SensorFolderDamaged` where images are missing, `CalibrationError` where
    none of a ball are stored or given, and what `calibrate` raises.
    """
    names = BALL_NAMES if folder.is_imported else (*BOARD_NAMES, *BALL_NAMES)
    given = {name: image for name, image in vars(new).items() if image is not None}
    seconds = (second_image_names(kind) for kind in SECOND_KINDS if method == "physics")
    names = (*names, *chain.from_iterable(pair for pair in seconds if {*pair} <= {*given, *folder.record.images}))
    images = CalibrationImages(
        **{name: given[name] if name in given else folder.stored_image(name).image for name in names}
    )
    record = folder.record
    lens: LensKind = "paper" if isinstance(record.lens, PinMapTable) else "model"
    smoothing = smoothing or (Smoothing() if record.depth is None else record.depth.smoothing)
    settings = CalibrationSettings(
        lens, record.grid.camera_rotation_deg, method, smoothing, record.grid.camera_mirrored
    )
    imported = folder if folder.is_imported else None
    return calibrate(images, design or record.design, settings, record.id, on_step, imported)

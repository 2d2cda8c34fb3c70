"""The pin board is found and the lens recovered, on known lenses and on real images; what is no board is refused."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from known_sensor import KnownSensor, with_board

from ninedtact.calibration.board.board_fit import BoardFit, fit_board
from ninedtact.calibration.board.detection import BoardNotFound, find_board_candidate
from ninedtact.calibration.board.lens_fit import rms_vector_length
from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.design import PinBoard, SensorDesign
from ninedtact.errors import CalibrationError
from ninedtact.quantities import Frame

BOARD = PinBoard()


def lens_error_mm(found, known, board: PinBoard = BOARD) -> float:
    """RMS over the board's area of where a found lens puts a point that the known lens shows."""
    x, y = np.meshgrid(*[np.linspace(-1, 1, 15) * (n - 1) / 2 * board.pitch_mm for n in (board.cols, board.rows)])
    points = np.column_stack([x.ravel(), y.ravel()])
    return rms_vector_length(found.to_mm(known.to_px(points)) - points)


@pytest.fixture(scope="module")
def straight() -> BoardFit:
    """The board of the known sensor."""
    images = KnownSensor().images()
    return fit_board(images.board_reference, images.board, BOARD)


def test_a_known_lens_is_recovered(straight: BoardFit) -> None:
    assert straight.found.all()
    assert lens_error_mm(straight.lens, KnownSensor().lens) < 0.01 and straight.correction is None
    assert straight.lens_fit.leave_one_out_rms_mm < 0.02


@pytest.mark.parametrize("board", [PinBoard(8, 10, 2.0)], ids=str)
def test_any_board(board: PinBoard) -> None:
    sensor = with_board(board)
    images = sensor.images()
    fit = fit_board(images.board_reference, images.board, board)
    assert fit.found.all() and lens_error_mm(fit.lens, sensor.lens, board) < 0.02 * board.pitch_mm


def test_missing_pins_are_predicted_and_named() -> None:
    sensor = KnownSensor()
    images = sensor.images(skip=(0, 30, 44))
    fit = fit_board(images.board_reference, images.board, BOARD)
    assert fit.missing_pins == ["column 1, row 1", "column 4, row 4", "column 9, row 5"]
    truth_px = sensor.lens.to_px(fit.points_mm[~fit.found])
    assert np.abs(fit.points_px[~fit.found] - truth_px).max() < 1.0


def test_pins_that_lie_beyond_the_image_are_predicted() -> None:
    """A camera that is turned a little and mounted off the middle leaves a corner of the board out of view."""
    camera = np.column_stack([cv2.getRotationMatrix2D((319.5, 239.5), 8, 1)[:, :2], (0.0, 0.0)])
    camera[:, 2] = np.array([319.5, 239.5]) - camera[:, :2] @ (319.5, 239.5) + (0, 60)
    straight = KnownSensor().images()
    images = CalibrationImages(
        *(
            cv2.warpAffine(image, camera, (640, 480), borderMode=cv2.BORDER_REPLICATE)
            for image in (straight.board_reference, straight.board)
        )
    )
    made = calibrate(images)
    truth_px = KnownSensor().lens.to_px(made.board.points_mm) @ camera[:, :2].T + camera[:, 2]
    assert ((truth_px < 0) | (truth_px > (639, 479))).any() and made.record.certificate.board.pins_found < 63
    assert np.abs(made.board.points_px - truth_px).max() < 1.5


def test_too_many_missing_pins_are_counted() -> None:
    images = KnownSensor().images(skip=tuple(range(20, 34)))
    with pytest.raises(BoardNotFound, match="expected 63 pins") as refusal:
        fit_board(images.board_reference, images.board, BOARD)
    assert 30 <= refusal.value.found_pins <= 52 and refusal.value.expected_pins == 63


@pytest.mark.parametrize(("turns", "mounting"), [(1, "auto"), (2, "known"), (3, "known")])
def test_a_turned_camera_sees_the_same_skin(turns: int, mounting: str, straight: BoardFit) -> None:
    """np.rot90 turns the image counter-clockwise, so the sensor's x axis turns to −90° per turn on the screen."""
    images = KnownSensor().turned(turns)
    way = "auto" if mounting == "auto" else (-90 * turns) % 360
    fit = fit_board(images.board_reference, images.board, BOARD, way)
    centre = straight.lens.to_px(np.array([[4.0, 2.0]]))[0]
    seen = np.array(turned_px(centre, turns))
    found = fit.lens.to_mm(seen[None])[0]
    # "auto" cannot tell 0° from 180°, nor 90° from 270°.
    ways = [(4.0, 2.0)] if mounting == "known" else [(4.0, 2.0), (-4.0, -2.0)]
    assert min(np.hypot(*(found - way)) for way in ways) < 0.02


def turned_px(point, turns: int):
    """Where a pixel of a 640×480 image lies after np.rot90."""
    x, y, cols, rows = *point, 640, 480
    for _ in range(turns):
        x, y, cols, rows = y, cols - 1 - x, rows, cols
    return x, y


@pytest.fixture(scope="module")
def board_a(real_images: dict[str, CalibrationImages]) -> BoardFit:
    """The board of sensor A."""
    return fit_board(real_images["a"].board_reference, real_images["a"].board, BOARD)


ALTERED = {
    "faint": lambda image, reference: reference + 0.5 * (image - reference),
    "vignetted": lambda image, reference: image * vignette()[..., None],
    "glaring": lambda image, reference: image + 150 * glare()[..., None],
    "dimmed since": lambda image, reference: image if image is reference else 0.9 * image - 3,
    "half the size": lambda image, reference: cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
    "twice the size": lambda image, reference: cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC),
}


def vignette():
    y, x = np.mgrid[-1:1:480j, -1:1:640j]
    return 1 / (1 + 2 * (x**2 + y**2) ** 2)


def glare():
    y, x = np.mgrid[:480, :640]
    return np.exp(-((x - 640) ** 2 + (y - 60) ** 2) / 2 / 50**2)


@pytest.mark.parametrize("how", ALTERED)
def test_other_light_and_size(how: str, real_images: dict[str, CalibrationImages]) -> None:
    images = real_images["a"]
    reference, press = images.board_reference.astype(float), images.board.astype(float)
    altered = [np.clip(ALTERED[how](one, reference), 0, 255).astype(np.uint8) for one in (reference, press)]
    fit = fit_board(*altered, BOARD)
    assert fit.found.sum() >= 62 and fit.lens_fit.leave_one_out_rms_mm < 0.06


def test_swapped_images_are_named(real_images: dict[str, CalibrationImages]) -> None:
    images = real_images["a"]
    with pytest.raises(BoardNotFound, match="swapped"):
        fit_board(images.board, images.board_reference, BOARD)


def test_untouched_skin_is_no_board(real_images: dict[str, CalibrationImages]) -> None:
    images = real_images["j"]
    with pytest.raises(BoardNotFound, match="nothing touched"):
        fit_board(images.ball_reference, images.ball, BOARD)


@pytest.mark.parametrize(("level", "word"), [(0, "lit"), (255, "overexposed")])
def test_dark_and_burnt_images_are_refused(level: int, word: str) -> None:
    flat = np.full((480, 640, 3), level, np.uint8)
    with pytest.raises(CalibrationError, match=word):
        fit_board(flat, flat, BOARD)


def test_the_papers_way_passes_through_its_pins(board_a: BoardFit) -> None:
    pin_map = board_a.published_map
    assert np.allclose(pin_map.projection.to_px(board_a.points_mm), pin_map.points_px, atol=1e-6)
    assert pin_map.mm_per_px == pytest.approx(0.0510150969, rel=2e-3)  # what the original code stored for this sensor


def dent_px(points_px: np.ndarray) -> np.ndarray:
    """A smooth displacement of up to 14 pixels near a corner, which no lens model follows."""
    squared = ((points_px - np.array([90.0, 100.0])) ** 2).sum(axis=-1, keepdims=True)
    return 14 * np.exp(-squared / (2 * 100.0**2)) * np.array([1.0, -0.6])


def dented(image: np.ndarray) -> np.ndarray:
    """The image as seen through glass that displaces it by `dent_px`."""
    rows, cols = image.shape[:2]
    source = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).astype(float)
    source += dent_px(source)
    return cv2.remap(
        image, *np.moveaxis(source.astype(np.float32), -1, 0), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )


def test_a_smooth_correction_follows_what_no_lens_model_does(tmp_path: Path) -> None:
    sensor = KnownSensor()
    images = CalibrationImages(
        **{name: dented(image) for name, image in vars(sensor.images()).items() if image is not None}
    )
    made = calibrate(images, settings=CalibrationSettings(method="ratio"))
    fit, folder = made.board, save_sensor(tmp_path / "sensor", made)
    assert fit.correction is not None
    left_out_mm = rms_vector_length(fit.leave_one_out_errors_mm)
    assert (
        left_out_mm < fit.published_map.leave_one_out_rms_mm and left_out_mm < 0.6 * fit.lens_fit.leave_one_out_rms_mm
    )
    # Between the pins as well, the corrected lens is nearer to what is known.
    points_mm = np.stack(np.meshgrid(np.linspace(-9, 9, 25), np.linspace(-7, 7, 25)), axis=-1).reshape(-1, 2)
    straight_px = sensor.lens.to_px(points_mm)
    known_px = straight_px
    for _ in range(30):
        known_px = straight_px - dent_px(known_px)
    corrected, alone = (rms_vector_length(one.to_px(points_mm) - known_px) for one in (fit.projection, fit.lens))
    assert corrected < 0.6 * alone

    loaded, page = load_sensor(folder.path), (folder.path / "certificate.html").read_text()
    np.testing.assert_array_equal(loaded.rectification.source_px, made.rectify.source_px)
    assert loaded.record == folder.record and "with a smooth correction on top of the lens model" in page


@pytest.mark.parametrize("letter", "aj")
def test_real_boards_need_no_correction_until_they_are_dented(
    letter: str, real_images: dict[str, CalibrationImages]
) -> None:
    images = real_images[letter]
    plain = fit_board(images.board_reference, images.board, BOARD)
    assert plain.found.sum() == 63 and plain.correction is None
    assert plain.lens_fit.leave_one_out_rms_mm < 0.8 * plain.published_map.leave_one_out_rms_mm
    fit = fit_board(dented(images.board_reference), dented(images.board), BOARD)
    original_mm, left_out_mm = fit.published_map.leave_one_out_rms_mm, rms_vector_length(fit.leave_one_out_errors_mm)
    assert left_out_mm < 0.95 * original_mm < original_mm < fit.lens_fit.leave_one_out_rms_mm


def dark_columns(left: float, *contrasts: float) -> np.ndarray:
    """A change of light with dark spots 40 pixels apart: columns of four spots, each column with its contrast."""
    y, x = np.mgrid[:300, :400]
    across = sum(each * np.exp(-((x - left - 40 * n) ** 2) / 2 / 5.0**2) for n, each in enumerate(contrasts))
    down = sum(np.exp(-((y - 80 - 40 * n) ** 2) / 2 / 5.0**2) for n in range(4))
    return (-across * down).astype(np.float32)


@pytest.mark.parametrize(("board", "mounting"), [(PinBoard(4, 5), 0), (PinBoard(5, 4), 90)])
def test_the_orientation_in_which_the_board_has_most_contrast_is_taken(board: PinBoard, mounting: int) -> None:
    candidate = find_board_candidate(dark_columns(100, 5, 5, 5, 5, 5), board, "auto")
    assert candidate is not None and (candidate.mounting, len(candidate.lattice)) == (mounting, 20)


def test_a_mirrored_camera_gives_the_same_skin(real_images: dict[str, CalibrationImages]) -> None:
    """With --camera-mirrored, mirrored images are rectified to the picture of the unmirrored ones."""
    images = real_images["a"]
    mirrored = CalibrationImages(
        **{name: np.ascontiguousarray(image[:, ::-1]) for name, image in vars(images).items() if image is not None}
    )
    plain, mirror = (
        calibrate(each, settings=CalibrationSettings(method="ratio", camera_mirrored=each is mirrored))
        for each in (images, mirrored)
    )
    assert mirror.record.grid.camera_mirrored and not plain.record.grid.camera_mirrored
    grey, same = plain.rectify(Frame(images.ball)).grey, mirror.rectify(Frame(mirrored.ball)).grey
    assert np.abs(grey - same).mean() < 0.2 < 1 < np.abs(grey - same[:, ::-1]).mean()
    np.testing.assert_allclose(plain.ball.max_indentation_mm, mirror.ball.max_indentation_mm, atol=0.02)


def test_a_board_across_the_image_is_warned_of(real_images: dict[str, CalibrationImages]) -> None:
    """Rows and columns that were exchanged turn the axes by 90° though every pin fits; a part of the height map is out of view."""
    for rows, cols, is_warned in ((7, 9, False), (9, 7, True)):
        design = replace(SensorDesign(), pin_board=replace(BOARD, rows=rows, cols=cols))
        pair = CalibrationImages(real_images["a"].board_reference, real_images["a"].board)
        warnings = calibrate(pair, design).record.certificate.warnings
        assert any("17% of the height map is out of the camera's view" in text for text in warnings) == is_warned


def test_a_mode_that_cuts_the_board_is_named(real_images: dict[str, CalibrationImages]) -> None:
    pair = (
        np.ascontiguousarray(cv2.resize(image, None, fx=2, fy=2)[120:840])
        for image in (real_images["a"].board_reference, real_images["a"].board)
    )
    with pytest.raises(BoardNotFound, match="pins lie beyond the border of the image: this mode of the camera cuts"):
        fit_board(*pair, BOARD)


@pytest.mark.parametrize(("rows", "cols"), [(7, 8), (6, 9), (6, 8), (8, 7)])
def test_a_design_with_fewer_pins_than_the_board_is_refused(
    rows: int, cols: int, real_images: dict[str, CalibrationImages]
) -> None:
    """It would leave open which pin is in the middle of the skin."""
    for letter in "aij":
        with pytest.raises(CalibrationError, match=r"another row or column of pins .* --design\.pin-board\.cols"):
            fit_board(*real_images[letter].board_pair, replace(BOARD, rows=rows, cols=cols))

"""One cause is named for the images of a calibration, with its evidence, and none for good ones."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from msgspec import structs

from ninedtact.calibration.certificate.checks import overall_check_level
from ninedtact.calibration.diagnosis import find_image_cause, find_probable_cause
from ninedtact.calibration.procedure import Calibration, CalibrationImages, calibrate
from ninedtact.design import SensorDesign
from ninedtact.errors import CalibrationError
from ninedtact.quantities import BgrImage

ALL, BALL = ("board_reference", "board", "ball_reference", "ball"), ("ball_reference", "ball")


def times(image: BgrImage, factor: object) -> BgrImage:
    return np.clip(np.rint(image * np.asarray(factor)), 0, 255).astype(np.uint8)


def blurred(image: BgrImage, sigma_px: float) -> BgrImage:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px))


def specked(image: BgrImage) -> BgrImage:
    return np.asarray(cv2.circle(image.copy(), (150, 120), 9, tuple(0.5 * image[120, 150]), cv2.FILLED))


def flipped(image: BgrImage, code: int) -> BgrImage:
    return np.asarray(cv2.flip(image, code))


def noisily_blurred(image: BgrImage, sigma_px: float) -> BgrImage:
    noise = np.random.default_rng(int(image.sum())).normal(0, 0.6, image.shape)
    return times(blurred(image.astype(np.float32), sigma_px) + noise, 1)


def as_jpeg(image: BgrImage, quality: int) -> BgrImage:
    return np.asarray(
        cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
    )


def zoomed(image: BgrImage) -> BgrImage:
    rows, cols = image.shape[:2]
    return np.asarray(cv2.resize(image[12 : rows - 12, 16 : cols - 16], (cols, rows)))


def banded(image: BgrImage) -> BgrImage:
    return times(image, 1 + 0.02 * np.sin(np.arange(image.shape[0]) / 27)[:, None, None])


FAULTS: dict[str, tuple[tuple[str, ...], Callable[[BgrImage], BgrImage], str]] = {
    "dim": (ALL, lambda image: times(image, 0.5), "dim"),
    "all blurred": (ALL, lambda image: blurred(image, 5), "out of focus"),
    "ball blurred": (("ball",), lambda image: blurred(image, 3), "out of focus"),
    "brighter under the ball": (("ball",), lambda image: times(image, 1.06), "gain changed"),
    "dimmer for the ball": (BALL, lambda image: times(image, 0.9), "gain changed"),
    "speck": (("ball",), specked, "dirt or damage"),
    "mirrored for the ball": (BALL, lambda image: np.ascontiguousarray(image[:, ::-1]), "image mirrored"),
    "board mirrored": (("board",), lambda image: flipped(image, 1), "image mirrored"),
    "ball upside down": (("ball",), lambda image: flipped(image, 0), "image mirrored"),
    "references mirrored": (("board_reference", "ball_reference"), lambda image: flipped(image, 1), "image mirrored"),
    "board shifted": (("board",), lambda image: np.roll(image, (3, 8), (0, 1)), "camera moved"),
    "ball shifted": (("ball",), lambda image: np.roll(image, (-4, 3), (0, 1)), "camera moved"),
    "zoomed for the ball": (BALL, zoomed, "camera moved"),
    "reference before the ball blurred": (("ball_reference",), lambda image: noisily_blurred(image, 3), "out of focus"),
    "reference before the board blurred": (
        ("board_reference",),
        lambda image: noisily_blurred(image, 3),
        "out of focus",
    ),
    "board blurred": (("board",), lambda image: noisily_blurred(image, 4), "out of focus"),
    "bands before the ball": (("ball_reference",), banded, "light uneven"),
    "compressed": (ALL, lambda image: as_jpeg(image, 40), "compressed"),
    "references dim": (("board_reference", "ball_reference"), lambda image: times(image, 0.5), "gain changed"),
    "one channel full": (ALL, lambda image: times(image, (0.75, 0.9, 1.75)), "overexposed"),
}


def cause_of(images: CalibrationImages) -> str | None:
    found = find_image_cause(images.board_pair, images.ball_pair)
    return None if found is None else found.cause


@pytest.mark.parametrize("letter", "aij")
def test_good_images_have_no_cause(letter: str, real_images: dict[str, CalibrationImages]) -> None:
    assert cause_of(real_images[letter]) is None


@pytest.mark.parametrize(("names", "spoil", "cause"), FAULTS.values(), ids=FAULTS)
def test_a_fault_of_the_images_is_named(
    names: tuple[str, ...],
    spoil: Callable[[BgrImage], BgrImage],
    cause: str,
    real_images: dict[str, CalibrationImages],
) -> None:
    for letter in "aj":
        images = real_images[letter]
        assert cause_of(replace(images, **{name: spoil(getattr(images, name)) for name in names})) == cause


def test_the_ball_of_another_sensor_is_named(real_images: dict[str, CalibrationImages]) -> None:
    other = real_images["i"]
    mixed = replace(real_images["a"], ball_reference=other.ball_reference, ball=other.ball)
    assert cause_of(mixed) == "another sensor's gel"


def test_a_refused_calibration_says_the_cause(real_images: dict[str, CalibrationImages]) -> None:
    images = real_images["j"]  # its ball shows no contact
    soft = CalibrationImages(**{name: blurred(getattr(images, name), 6) for name in ALL})
    with pytest.raises(CalibrationError, match=r"most probable cause: out of focus, because .*; focus the camera"):
        calibrate(soft)


def test_fits_tell_a_turned_board_and_wrong_lengths(calibrated_a: Calibration) -> None:
    certificate = calibrated_a.record.certificate
    assert certificate is not None and certificate.lengths is not None and certificate.cause is None
    assert find_probable_cause(certificate, None, None, False) is None
    turned = find_probable_cause(certificate, None, "17% is out of view; were rows and columns exchanged?", False)
    assert turned is not None and (turned.cause, turned.because) == ("board turned", "17% is out of view")
    lengths = structs.replace(certificate.lengths, pitch_wrong_probability=0.6)
    doubtful = structs.replace(certificate, lengths=lengths)
    found = find_probable_cause(doubtful, None, None, False)
    assert found is not None and found.cause == "wrong pitch of the board" and "60%" in found.because
    assert overall_check_level(structs.replace(certificate, cause=found)) == "warn"


def test_exchanged_rows_and_columns_are_a_turned_board(real_images: dict[str, CalibrationImages]) -> None:
    design, images = SensorDesign(), real_images["a"]
    board = replace(design.pin_board, rows=design.pin_board.cols, cols=design.pin_board.rows)
    board_alone = replace(images, ball_reference=None, ball=None)
    certificate = calibrate(board_alone, replace(design, pin_board=board)).record.certificate
    assert certificate is not None and certificate.cause is not None
    assert certificate.cause.cause == "board turned"
    assert certificate.cause.sentence.startswith("most probable cause: board turned, because 17%")

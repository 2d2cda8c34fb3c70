"""Images that cannot be a press: dark, white, without structure, exchanged, with a failed LED, of another sensor."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from ninedtact.calibration.drift.reference_check import load_reference_image_checker
from ninedtact.calibration.procedure import CalibrationImages
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.errors import InputError
from ninedtact.force.estimator_loading import build_estimator
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import EstimateWarning, Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.image_plausibility import ImageImplausible, find_image_warnings, require_plausible_image
from ninedtact.shape.lens_and_rectification import to_grey_float
from ninedtact.shape.sharpness import lacks_detail_of
from ninedtact.shape.skin_identity import shows_another_skin
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import default_twin

UNLIKE = EstimateWarning.IMAGE_UNLIKE_REFERENCE
Image = np.ndarray


def warnings_of(sensor: SensorFolder, reference: Image, image: Image) -> tuple[EstimateWarning, ...]:
    depth_reader = sensor.shape.depth_reader(Frame(reference))
    rectified = sensor.shape.rectify(Frame(image))
    return find_image_warnings(rectified, depth_reader.reference, depth_reader(rectified))


def require_plausible(sensor: SensorFolder, reference: Image, image: Image) -> None:
    depth_reader = sensor.shape.depth_reader(Frame(reference))
    rectified = sensor.shape.rectify(Frame(image))
    require_plausible_image("press.png", rectified, depth_reader.reference, depth_reader(rectified))


def with_failed_led(image: Image, part: float) -> Image:
    """One corner darker by a part."""
    y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    shade = 1 - part * np.exp(-((x - 60) ** 2 + (y - 60) ** 2) / 2 / 130**2)
    return (image * shade[..., None]).astype(np.uint8)


WRONG = {
    "black": (lambda image: 0 * image, EstimateWarning.IMAGE_DARK),
    "white": (lambda image: 0 * image + 255, EstimateWarning.IMAGE_OVEREXPOSED),
    "uniform": (lambda image: 0 * image + 150, UNLIKE),
    "noise": (lambda image: np.random.default_rng(0).integers(0, 255, image.shape, dtype=np.uint8), UNLIKE),
    "exposure changed": (lambda image: (0.85 * image).astype(np.uint8), UNLIKE),
    "dim LED": (lambda image: with_failed_led(image, 0.15), UNLIKE),
}


@pytest.mark.parametrize("name", WRONG)
def test_an_image_that_is_no_press_is_named(name: str, twin_sensor: SensorFolder) -> None:
    spoil, expected = WRONG[name]
    reference = default_twin().renderer(None, 1)
    assert warnings_of(twin_sensor, reference, spoil(reference)) == (expected,)
    with pytest.raises(ImageImplausible, match=r"^press.png: expected .*, got .*; "):
        require_plausible(twin_sensor, reference, spoil(reference))


@pytest.mark.parametrize("name", ["black", "uniform"])
def test_an_estimator_by_itself_knows_nothing_of_an_image_that_is_no_press(
    name: str, sensor_a: SensorFolder, real_data: Path
) -> None:
    image = read_image(real_data / "sensor_a" / "ball_reference.png")
    depth_reader, frame = sensor_a.shape.depth_reader(Frame(image)), Frame(WRONG[name][0](image))
    rectified = sensor_a.shape.rectify(frame)
    reading = Reading(frame, rectified, depth_reader(rectified), reference=depth_reader.reference)
    found = build_estimator("physics", sensor_a.shape, sensor_a.gel).estimate(reading)
    assert not found.wrench.six.any() and not np.isfinite(found.std).any() and found.warnings == (WRONG[name][1],)


@pytest.mark.parametrize(
    "press", [(Ball(4.0), 1.8), (Ball(8.0), 1.2), (FlatPunch(3.0), 0.8)], ids=["ball", "wide ball", "punch"]
)
def test_a_press_is_plausible_and_exchanged_images_are_not(press: tuple, twin_sensor: SensorFolder) -> None:
    twin = default_twin()
    reference = twin.renderer(None, 1)
    pressed = twin.renderer(ScriptedPress(press[1]).simulate(twin, press[0]), 2)
    for image in (pressed, twin.renderer(None, 3)):
        assert warnings_of(twin_sensor, reference, image) == ()
        require_plausible(twin_sensor, reference, image)
    if press[1] > 1.5:
        assert warnings_of(twin_sensor, pressed, reference) == (UNLIKE,)


def test_real_presses_are_plausible_and_exchanged_ones_are_not(
    sensor_a: SensorFolder, real_images: dict[str, CalibrationImages]
) -> None:
    sensor, images = sensor_a, real_images["a"]
    assert warnings_of(sensor, images.ball_reference, images.ball) == ()
    assert warnings_of(sensor, images.board_reference, images.board) == ()
    assert warnings_of(sensor, images.ball, images.ball_reference) == (UNLIKE,)
    check = load_reference_image_checker(sensor)
    check.require_faultless([Frame(images.ball_reference)])
    check.require_faultless([Frame(images.board_reference)])
    for wrong in (images.ball, images.board, images.ball_reference[:, ::-1].copy()):
        with pytest.raises(InputError, match="without contact"):
            check.require_faultless([Frame(wrong)])
    for letter in "ij":
        with pytest.raises(InputError, match="another sensor's gel"):
            check.require_faultless([Frame(real_images[letter].ball_reference)])


@pytest.mark.parametrize("letter", "ai")
def test_a_press_that_is_out_of_focus_is_refused_wherever_it_has_moved(
    letter: str, real_images: dict[str, CalibrationImages]
) -> None:
    """Noise, light, compression and motion take the detail of no sharp press away."""
    images, rng = real_images[letter], np.random.default_rng(0)
    known = (images.board_reference, images.ball_reference)
    jpeg = cv2.imdecode(cv2.imencode(".jpg", images.ball, [cv2.IMWRITE_JPEG_QUALITY, 70])[1], cv2.IMREAD_COLOR)
    noisy = np.clip(images.ball + rng.normal(0, 2, images.ball.shape), 0, 255).astype(np.uint8)
    for sharp in (
        images.ball,
        jpeg,
        noisy,
        np.roll(images.ball, (2, -3), (0, 1)),
        in_other_light(images.ball, 0.9, 1.1),
    ):
        assert not lacks_detail_of(known, images.ball_reference, sharp)
    soft = cv2.GaussianBlur(images.ball, (0, 0), 3)
    grainy = np.clip(cv2.GaussianBlur(images.ball, (0, 0), 5) + rng.normal(0, 0.6, soft.shape), 0, 255).astype(np.uint8)
    for blurred in (soft, grainy, cv2.blur(images.ball, (9, 9)), cv2.blur(images.ball, (17, 1))):
        assert lacks_detail_of(known, images.ball_reference, blurred)
        assert not lacks_detail_of(known, soft, blurred)  # nothing tells what a sharp image would show


def test_a_blurred_press_beside_a_sharp_reference_is_named(
    sensor_a: SensorFolder, real_images: dict[str, CalibrationImages]
) -> None:
    images, check = real_images["a"], load_reference_image_checker(sensor_a)
    for press, reference in ((images.ball, images.ball_reference), (images.board, images.board_reference)):
        depth_reader = sensor_a.shape.depth_reader(Frame(reference))
        sharp, blurred = (
            read_frame(Frame(image), sensor_a.shape, depth_reader)
            for image in (press, cv2.GaussianBlur(press, (0, 0), 6))
        )
        check.require_press("press.png", sharp, [Frame(reference)])
        with pytest.raises(
            ImageImplausible, match=r"press\.png: .* out of focus .*; switch the camera's autofocus off"
        ):
            check.require_press("press.png", blurred, [Frame(reference)])


def in_other_light(image: Image, gain: float, gamma: float) -> Image:
    """The image with another gain and gamma."""
    return np.clip(np.rint(gain * 255 * (image / 255) ** gamma), 0, 255).astype(np.uint8)


LIGHTS = (1.0, 1.0), (1.05, 1.0), (0.94, 1.0), (1.0, 0.9), (1.03, 1.08)


def test_an_image_of_another_real_sensor_is_refused(
    sensor_a: SensorFolder, real_images: dict[str, CalibrationImages]
) -> None:
    """Where the light tells little, the fine structure of the skin tells them apart."""
    sensor, own = sensor_a, real_images["a"]
    for reference in (own.ball_reference, own.board_reference):
        for image in (own.ball, own.board, own.ball_reference, own.board_reference):
            require_plausible(sensor, reference, image)
        for letter in "ij":
            other = real_images[letter]
            for image in (other.ball, other.ball_reference, other.board_reference):
                with pytest.raises(ImageImplausible, match="of one sensor"):
                    require_plausible(sensor, reference, image)


def test_an_image_that_is_more_compressed_than_its_reference_is_refused_and_says_so(
    sensor_a: SensorFolder, real_images: dict[str, CalibrationImages]
) -> None:
    own = real_images["a"]

    def compressed(image: Image, quality: int) -> Image:
        return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)

    for image, quality in ((own.ball_reference, 40), (own.board_reference, 20)):
        with pytest.raises(ImageImplausible, match="or more compressed; give images of one sensor, exposure and compr"):
            require_plausible(sensor_a, own.ball_reference, compressed(image, quality))
        require_plausible(sensor_a, own.ball_reference, compressed(image, 85))


def test_a_dragged_press_is_no_change_of_the_light(twin_sensor: SensorFolder) -> None:
    """A key that is dragged by 3 mm and turned by 30° sinks the skin on one side, over most of the view."""
    twin, key = default_twin(), indenter_from_name("key_01")
    reader = twin_sensor.shape.depth_reader(Frame(twin.renderer(None, 1)))
    for depth_mm in (0.7, 0.9):
        press = None
        for part in np.linspace(0, 1, 7):
            press = twin.press(press, key, Pose(3 * part, 0, depth_mm, np.deg2rad(30 * part)))
        assert press is not None
        reading = read_frame(Frame(twin.renderer(press.corrected, 7)), twin_sensor.shape, reader)
        assert reading.light.level < 0.993 and reading.light.gain == 1 and not reading.light.warnings


def test_no_correction_of_the_light_makes_another_sensor_plausible(
    sensor_a: SensorFolder, real_images: dict[str, CalibrationImages]
) -> None:
    """In a stream the light alone tells them apart: an own press in other light is read, most images of others are not."""
    own = real_images["a"]
    reader = sensor_a.shape.depth_reader(Frame(own.ball_reference))

    def is_plausible(image: Image, light: tuple[float, float]) -> bool:
        return not read_frame(Frame(in_other_light(image, *light)), sensor_a.shape, reader).image_warnings

    foreign = [image for letter in "ij" for image in vars(real_images[letter]).values() if image is not None]
    passed = [is_plausible(image, light) for image in foreign for light in LIGHTS]
    assert np.mean(passed) <= 0.3  # wide objects near the border change its light as much as some sensors differ
    for image in (own.ball, own.ball_reference, own.board_reference):
        assert all(is_plausible(image, light) for light in LIGHTS)


def test_a_skin_is_the_same_under_other_light_noise_and_compression(real_images: dict[str, CalibrationImages]) -> None:
    noise = np.random.default_rng(0).normal(0, 1.5, real_images["a"].ball.shape)
    for letter in "aij":
        own = real_images[letter]
        reference, press = own.ball_reference, own.ball
        jpeg = cv2.imdecode(cv2.imencode(".jpg", press, [cv2.IMWRITE_JPEG_QUALITY, 85])[1], cv2.IMREAD_COLOR)
        for image in (press, jpeg, 0.9 * press, press + noise):
            seen = np.clip(image, 0, 255).astype(np.uint8)
            assert not shows_another_skin(to_grey_float(seen), to_grey_float(reference))

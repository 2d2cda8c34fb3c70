"""A check is quiet about skin that is as it was, and names what has changed, on real images and on drawn ones."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from upstream_folder import UpstreamFolder

from ninedtact.calibration.brightness_change import different_skin_warnings, find_exposure_fault, overexposed_share
from ninedtact.calibration.drift.diagnosis import diagnose_drift
from ninedtact.calibration.drift.measurement import CalibratedReference, load_calibrated_reference, measure_drift
from ninedtact.calibration.drift.reference_check import find_reference_image_fault
from ninedtact.calibration.original_9dtact.import_export import import_original_calibration
from ninedtact.calibration.sensor_folder import SensorFolder, SensorFolderDamaged
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.cli.check import CheckCommand
from ninedtact.errors import CalibrationError, FileFormatError, InputError
from ninedtact.quantities import BgrImage

SENSORS = ("sensor_a", "sensor_i", "sensor_j")


def diagnoses(known: CalibratedReference, today: BgrImage) -> list[str]:
    return [finding.diagnosis for finding in diagnose_drift(measure_drift(known, today))]


def moved(image: BgrImage, x: float = 0.0, y: float = 0.0, clockwise_deg: float = 0.0) -> BgrImage:
    """The image from a camera that moved, with noise of its own: else rounding twice holds the image in place."""
    rows, cols = image.shape[:2]
    matrix = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), -clockwise_deg, 1)
    matrix[:, 2] += x, y
    way = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_REFLECT}
    there = cv2.warpAffine(image.astype(np.float32), matrix, (cols, rows), **way)
    return times(there + np.random.default_rng(1).normal(0, 0.5, image.shape), 1)


def times(image: BgrImage, factor: object) -> BgrImage:
    """The image in another light."""
    return np.clip(np.rint(image * np.asarray(factor)), 0, 255).astype(np.uint8)


def spotted(image: BgrImage, change: float, radius_px: float, x: float = 250, y: float = 300) -> BgrImage:
    """The image with a soft round spot."""
    rows, cols = np.indices(image.shape[:2])
    inside = 1 / (1 + np.exp((np.hypot(cols - x, rows - y) - radius_px) / 2))
    return times(image, 1 + change * inside[..., None])


@pytest.fixture(scope="module")
def images(real_data: Path) -> dict[str, dict[str, BgrImage]]:
    names = ("board_reference", "board", "ball_reference", "ball")
    return {sensor: {name: read_image(real_data / sensor / f"{name}.png") for name in names} for sensor in SENSORS}


@pytest.fixture(scope="module")
def known(sensor_a: SensorFolder, images: dict[str, dict[str, BgrImage]]) -> dict[str, CalibratedReference]:
    """All three skins; the others seen as through the first one's lens, which is much like theirs."""
    first = load_calibrated_reference(sensor_a)
    return {
        name: replace(first, lens_image=found["board_reference"], depth_image=found["ball_reference"])
        for name, found in images.items()
    }


@pytest.mark.parametrize("name", SENSORS)
def test_untouched_skin_of_another_time_is_fine(name: str, known: dict, images: dict) -> None:
    measured = measure_drift(known[name], images[name]["board_reference"])
    assert diagnose_drift(measured) == []
    assert measured.moved.is_same_skin
    assert measured.moved.correlation > 0.6
    assert np.hypot(*measured.moved.shift_px) < 0.5


def test_a_ball_image_without_contact_is_fine(known: dict, images: dict) -> None:
    assert diagnoses(known["sensor_j"], images["sensor_j"]["ball"]) == []


@pytest.mark.parametrize(("name", "press"), [("sensor_a", "ball"), ("sensor_i", "ball"), ("sensor_j", "board")])
def test_whatever_touches_is_noticed(name: str, press: str, known: dict, images: dict) -> None:
    assert diagnoses(known[name], images[name][press]) == ["something touches the gel"]


def test_the_contact_is_where_the_ball_is(known: dict, images: dict) -> None:
    contact = measure_drift(known["sensor_a"], images["sensor_a"]["ball"]).change.contact
    assert contact is not None
    assert (contact.x_mm, contact.y_mm) == pytest.approx((0.7, 0.7), abs=0.4)
    assert contact.area_mm2 == pytest.approx(np.pi * 3.4**2, rel=0.25)


CHANGES: dict[str, tuple[Callable[[BgrImage], BgrImage], str]] = {
    "dimmer by 5 %": (lambda image: times(image, 0.95), "gain changed"),
    "brighter by 5 %": (lambda image: times(image, 1.05), "gain changed"),
    "warmer": (lambda image: times(image, (0.95, 1.0, 1.04)), "light colour changed"),
    "an LED out": (
        lambda image: times(image, 1 - 0.2 * np.exp(-np.arange(640) / 60)[None, :, None]),
        "light uneven",
    ),
    "moved by 1 px": (lambda image: moved(image, 1), "camera moved"),
    "moved by 47 px": (lambda image: moved(image, 40, -25), "camera moved"),
    "turned by 1°": (lambda image: moved(image, clockwise_deg=1), "camera moved"),
    "turned by 180°": (lambda image: cv2.flip(image, -1), "image mirrored"),
    "mirrored": (lambda image: cv2.flip(image, 1), "image mirrored"),
    "faint stain": (lambda image: spotted(image, -0.04, 10), "dirt or damage"),
    "stain, and a bubble far from it": (
        lambda image: spotted(spotted(image, -0.1, 20), 0.08, 20, 450, 120),
        "dirt or damage",
    ),
    "bubble": (lambda image: spotted(image, 0.05, 12, 400, 200), "dirt or damage"),
}


@pytest.mark.parametrize(("spoil", "diagnosis"), CHANGES.values(), ids=CHANGES)
def test_every_change_has_its_name(
    spoil: Callable[[BgrImage], BgrImage], diagnosis: str, known: dict, images: dict
) -> None:
    assert diagnoses(known["sensor_a"], spoil(images["sensor_a"]["board_reference"])) == [diagnosis]


def test_noise_slight_blur_compression_and_half_a_pixel_are_no_change(known: dict, images: dict) -> None:
    image = images["sensor_a"]["board_reference"]
    noise = np.random.default_rng(0).normal(0, 3, image.shape)
    jpeg = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 50])[1], cv2.IMREAD_COLOR)
    for today in (times(image + noise, 1), jpeg, cv2.GaussianBlur(image, (0, 0), 1.2), moved(image, 0.3, -0.3)):
        assert diagnoses(known["sensor_a"], today) == []


def test_a_blurred_image_is_out_of_focus_and_neither_moved_nor_another_sensor(known: dict, images: dict) -> None:
    noise = np.random.default_rng(0).normal(0, 0.6, (480, 640, 3))
    for name, sigma_px in (("sensor_a", 3), ("sensor_i", 6), ("sensor_j", 10)):
        for image, added in ((images[name]["ball_reference"], 0), (images[name]["board_reference"], noise)):
            blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px) + added
            (finding,) = diagnose_drift(measure_drift(known[name], times(blurred, 1)))
            assert finding.diagnosis == "out of focus" and "fine detail" in finding.because


@pytest.mark.parametrize("exponent", [0.6, 0.8, 1.25])
def test_a_gamma_is_told_from_a_gain_and_makes_a_reference_image_unusable(
    exponent: float, known: dict, images: dict
) -> None:
    for name in SENSORS:
        image = images[name]["board_reference"]
        curved = times(255 * (image / 255) ** exponent, 1)
        fault = find_reference_image_fault(measure_drift(known[name], curved))
        assert fault is not None and fault.diagnosis == diagnoses(known[name], curved)[0] == "gamma changed"
        brighter = times(image, 1.3 - 0.3 * exponent)
        assert diagnoses(known[name], brighter)[0] == "gain changed"
        assert find_reference_image_fault(measure_drift(known[name], brighter)) is None


def test_what_the_skin_was_like_before_the_board_is_no_contact(known: dict, images: dict) -> None:
    """A skin that recovers slowly is pressed in one reference image of its calibration, compared with the other."""
    before = images["sensor_a"]["board_reference"]
    rows, cols = np.indices(before.shape[:2])
    apart = np.hypot(cols - 300, rows - 240)
    swollen = 1 + 0.04 * np.exp(-((apart / 25) ** 2)) - 0.02 * np.exp(-(((apart - 45) / 15) ** 2))
    slow = replace(known["sensor_a"], depth_image=times(before, swollen[..., None]))
    assert diagnoses(replace(slow, lens_image=slow.depth_image), before) == ["something touches the gel"]
    assert diagnoses(slow, before) == []


def test_another_sensor_is_another_skin(known: dict, images: dict) -> None:
    for mine, other in (("sensor_a", "sensor_i"), ("sensor_i", "sensor_j"), ("sensor_j", "sensor_a")):
        assert diagnoses(known[mine], images[other]["board_reference"]) == ["another sensor's gel"]


def test_figures_are_right(known: dict, images: dict) -> None:
    found = measure_drift(
        known["sensor_a"], times(moved(spotted(images["sensor_a"]["ball_reference"], -0.1, 20), 2, -1), 0.9)
    )
    assert found.moved.shift_px == pytest.approx((2, -1), abs=0.2)
    assert found.known.mm_per_raw_px == pytest.approx(0.0518, rel=0.03)
    assert found.change.gain == pytest.approx(0.9, abs=0.003)
    (mark,) = found.change.marks
    assert mark.change == pytest.approx(-0.1, abs=0.01)
    assert mark.area_mm2 == pytest.approx(np.pi * (21 * 0.0518) ** 2, rel=0.35)
    assert found.height_mm > found.known.height_mm(np.array(0.08), np.array(160.0))


def test_an_image_that_cannot_be_compared_is_refused(known: dict[str, CalibratedReference]) -> None:
    with pytest.raises(FileFormatError, match="640 x 480 pixels, got 320 x 240"):
        measure_drift(known["sensor_a"], np.full((240, 320, 3), 160, np.uint8))
    with pytest.raises(CalibrationError, match="switch the sensor's light on"):
        measure_drift(known["sensor_a"], np.zeros((480, 640, 3), np.uint8))


def test_the_command_ends_with_the_diagnosis(
    sensor_a: SensorFolder, images: dict, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fine, dim = tmp_path / "fine.png", tmp_path / "dim.png"
    cv2.imwrite(str(fine), images["sensor_a"]["board_reference"])
    cv2.imwrite(str(dim), times(images["sensor_a"]["ball_reference"], 0.8))
    assert CheckCommand(sensor_a.path, (fine,), json=True).run() == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["diagnosis"], found["findings"]) == ("fine", [])
    assert CheckCommand(sensor_a.path, (fine, dim), json=True).run() == 1
    found = json.loads(capsys.readouterr().out)
    assert [image["diagnosis"] for image in found["images"]] == ["fine", "gain changed"]
    assert found["findings"][0]["height_mm"] > 0.3
    assert found["images"][1]["brightness_percent"] == pytest.approx(-20, abs=0.2)
    assert CheckCommand(sensor_a.path, (dim,)).run() == 1
    said = capsys.readouterr().out
    assert "20.0% dimmer" in said and "on 99 % of the view; with today's they are not" in said


def test_an_image_of_a_press_is_not_said_to_be_a_good_reference(
    sensor_a: SensorFolder, images: dict, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pressed = tmp_path / "pressed.png"
    cv2.imwrite(str(pressed), images["sensor_a"]["ball"])
    assert CheckCommand(sensor_a.path, (pressed,)).run() == 1
    said = capsys.readouterr().out
    assert "something touches the gel" in said and said.endswith("mm on 99 % of the view\n")


def test_a_command_without_images_says_so(sensor_a: SensorFolder) -> None:
    with pytest.raises(InputError, match="at least one reference image"):
        CheckCommand(sensor_a.path, ()).run()


def test_an_imported_sensor_has_nothing_to_compare_with(tmp_path: Path) -> None:
    imported = import_original_calibration(UpstreamFolder().write(tmp_path / "sensor_2"), tmp_path / "ours")
    with pytest.raises(SensorFolderDamaged, match="imported"):
        load_calibrated_reference(imported)


def test_one_full_channel_is_overexposed(images: dict[str, dict[str, BgrImage]]) -> None:
    """The grey level of a picture of which one channel is full may be that of a good one."""
    reference = images["sensor_a"]["ball_reference"]
    assert overexposed_share(reference) == 0 and find_exposure_fault(reference) is None
    for channel, name in enumerate(("blue", "green", "red")):
        gains = np.full(3, 0.8)
        gains[channel] = 1.75
        fault = find_exposure_fault(times(reference, gains))
        assert fault is not None and fault.kind == "overexposed" and f"in {name} alone" in fault.sentence
    white = find_exposure_fault(times(reference, 1.75))
    assert white is not None and "alone" not in white.sentence


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("light", [0.35, 0.55, (0.0, 0.0, 1.0)], ids=str)
def test_a_dim_sensor_is_called_dim_and_neither_moved_nor_another(
    sensor: str, light: float | tuple[float, ...], known: dict, images: dict
) -> None:
    pair = [times(images[sensor][name], light) for name in ("board_reference", "ball_reference")]
    assert all(sentence.startswith("dim: ") for sentence in different_skin_warnings(*pair))
    assert set(diagnoses(known[sensor], pair[1])) <= {"dim"}

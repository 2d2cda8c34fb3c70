"""Light that changes is taken out and named; an image whose light has not changed is returned as it is."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact import ScriptedPress, default_twin
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.mechanics.indenter import LyingCylinder
from ninedtact.quantities import EstimateWarning, Frame, Rectified
from ninedtact.reading import read_frame
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.shape.light_change import LightCorrection
from ninedtact.shape.light_gradient import _fit_gradient, find_light_gradient

ROWS, COLS, MM_PER_PX = 345, 460, 0.052
RAW_ROWS, RAW_COLS = 480, 640
ALONG, ACROSS = (axis.astype(np.float32) for axis in np.mgrid[:ROWS, :COLS])
RECTIFY = Rectification(
    np.stack([20 + 1.3 * ACROSS, 15 + 1.3 * ALONG], axis=-1).astype(np.float32),
    MM_PER_PX,
    (RAW_ROWS, RAW_COLS),
    (-12.0, 12.0, -9.0, 9.0),
)
UNTOUCHED = (150 - 30 * (np.hypot(ALONG - 172, ACROSS - 230) / 290) ** 2).astype(np.float32)
DENT = np.exp(-((ALONG - 150) ** 2 + (ACROSS - 260) ** 2) / (2 * 22**2)).astype(np.float32)
PRESSED = UNTOUCHED * (1 - 0.15 * DENT)
CORRECT = LightCorrection(RECTIFY)
REFERENCE = Rectified(UNTOUCHED, MM_PER_PX)


def noisy(grey: np.ndarray, seed: int = 0) -> Rectified:
    return Rectified((grey + np.random.default_rng(seed).normal(0, 0.4, grey.shape)).astype(np.float32), MM_PER_PX)


def largest_error(corrected: Rectified) -> float:
    """The largest relative difference from the press unchanged, over a millimetre."""
    return float(np.abs(cv2.GaussianBlur(corrected.grey / PRESSED - 1, (0, 0), 10)).max())


@given(st.integers(0, 99), st.sampled_from([UNTOUCHED, PRESSED]))
@settings(max_examples=10, deadline=None)
def test_unchanged_light_leaves_the_image_as_it_is(seed: int, grey: np.ndarray) -> None:
    image = noisy(grey, seed)
    corrected, change = CORRECT(image, REFERENCE)
    assert corrected is image and not change.warnings and not change.sentences


@given(st.floats(0.82, 1.2))
@settings(max_examples=20, deadline=None)
def test_a_gain_is_taken_out_and_named_from_one_per_cent(gain: float) -> None:
    corrected, change = CORRECT(noisy(PRESSED * np.float32(gain)), REFERENCE)
    assert largest_error(corrected) < 0.008
    if abs(gain - 1) > 0.013:
        assert EstimateWarning.LIGHT_CHANGED in change.warnings and change.gain == pytest.approx(gain, abs=0.006)
    np.testing.assert_allclose(change.restore(corrected.grey).mean(), (PRESSED * gain).mean(), rtol=2e-3)


@given(st.floats(0.003, 0.05), st.floats(60, 280), st.floats(0, 1), st.booleans())
@settings(max_examples=30, deadline=None)
def test_bands_are_taken_out_and_named_with_their_period(
    amplitude: float, period_px: float, phase: float, along_rows: bool
) -> None:
    line = RECTIFY.source_px[..., 1 if along_rows else 0]
    bands = (1 + amplitude * np.sin(2 * np.pi * (line / period_px + phase))).astype(np.float32)
    corrected, change = CORRECT(noisy(UNTOUCHED * bands), REFERENCE)
    assert change.bands is not None and change.bands.along_rows == along_rows
    assert change.bands.period_px == pytest.approx(period_px, rel=0.05)
    left = cv2.GaussianBlur(corrected.grey / UNTOUCHED - 1, (0, 0), 20)
    assert np.abs(left).max() < 0.0005 + 0.02 * amplitude
    assert change.warnings == (EstimateWarning.LIGHT_BANDED,)


@given(st.floats(0.005, 0.05), st.floats(0.9, 1.6), st.floats(0, 1), st.booleans())
@settings(max_examples=20, deadline=None)
def test_about_one_cycle_over_the_view_is_taken_out_where_nothing_touches(
    amplitude: float, cycles: float, phase: float, along_rows: bool
) -> None:
    """As bands or as a gradient, and said; without it, the skin would be pressed in by some tenths of a millimetre."""
    part = RECTIFY.source_px[..., 1 if along_rows else 0] / (RAW_ROWS if along_rows else RAW_COLS)
    bands = (1 + amplitude * np.sin(2 * np.pi * (cycles * part + phase))).astype(np.float32)
    corrected, change = CORRECT(noisy(UNTOUCHED * bands), REFERENCE)
    left = cv2.GaussianBlur(corrected.grey / UNTOUCHED, (0, 0), 20)
    assert np.ptp(left) < 0.001 + 0.05 * amplitude and change.warnings


@pytest.mark.parametrize(("radius_mm", "depth_mm"), [(4.0, 0.4), (8.0, 0.4), (15.0, 0.2)])
def test_a_rod_across_the_view_is_no_band(radius_mm: float, depth_mm: float, twin_sensor: SensorFolder) -> None:
    twin, shape = default_twin(), twin_sensor.shape
    rod = LyingCylinder(radius_mm, 25.0)
    pressed = twin.renderer(ScriptedPress(depth_mm).simulate(twin, rod), 2)
    reading = read_frame(Frame(pressed), shape, shape.depth_reader(Frame(twin.renderer(None, 1))))
    assert reading.light.bands is None and reading.max_indentation_mm > 0.5 * depth_mm


@given(st.floats(0.013, 0.05), st.floats(0, 2 * np.pi), st.sampled_from([UNTOUCHED, PRESSED]))
@settings(max_examples=20, deadline=None)
def test_a_gradient_is_taken_out_beside_a_press_and_named(amplitude: float, towards: float, grey: np.ndarray) -> None:
    x, y = ACROSS / (COLS / 2) - 1, ALONG / (ROWS / 2) - 1
    slope = np.exp(amplitude * (np.cos(towards) * x + np.sin(towards) * y)).astype(np.float32)
    image = noisy(grey * slope)
    corrected, change = CORRECT(image, REFERENCE)
    assert np.abs(cv2.GaussianBlur(corrected.grey / grey - 1, (0, 0), 10)).max() < 0.004
    assert change.warnings == (EstimateWarning.LIGHT_CHANGED,) and "unevenly" in change.sentences[0]
    np.testing.assert_allclose(change.restore(corrected.grey), image.grey, rtol=1e-5)


@given(st.floats(0.013, 0.04), *3 * [st.floats(-1, 1)], st.booleans(), st.sampled_from([UNTOUCHED, PRESSED]))
@settings(max_examples=30, deadline=None)
def test_light_of_second_order_is_even_again_also_beside_a_press(
    amplitude: float, along: float, skew: float, across: float, dimmer: bool, grey: np.ndarray
) -> None:
    """By a gradient, or by the gamma that does the same to a skin whose brightness is of second order, but not to a dent in it."""
    x, y = ACROSS / (COLS / 2) - 1, ALONG / (ROWS / 2) - 1
    light = x**2 + along * y**2 + skew * x * y + across * x
    light *= (-1 if dimmer else 1) * 2 * amplitude / np.ptp(light)
    corrected, change = CORRECT(noisy(grey * np.exp(light).astype(np.float32)), REFERENCE)
    compared = DENT < 0.01 if change.gradient is None else np.full(grey.shape, True)
    left = float(np.abs(cv2.GaussianBlur(corrected.grey / grey - 1, (0, 0), 10))[compared].max())
    assert left < 0.012 and change.warnings == (EstimateWarning.LIGHT_CHANGED,)
    assert change.gamma != 1 if change.gradient is None else left < 4 * change.gradient.error


@pytest.mark.filterwarnings("error")
def test_a_gradient_that_the_skin_does_not_determine_is_not_known() -> None:
    steps = np.ones((44, 36), np.float32)
    steps[:, 18:] = 1.05
    in_view = np.zeros(steps.shape, bool)
    in_view[1::2] = True
    assert find_light_gradient(steps, 100 * steps, in_view, 0.4) is None, "every second row is used"
    logarithm, skin = np.zeros((44, 36), np.float32), np.zeros((44, 36), bool)
    skin[20] = skin[5:35:10, 3] = True
    logarithm[5:35:10, 3] = 1.0, -1.0, 1.0
    assert _fit_gradient(logarithm, skin, 3) is None, "all but outliers lie on a line"


@given(st.floats(3, 16), st.floats(0.15, 0.7), st.integers(40, 420), st.integers(40, 300), st.booleans())
@settings(max_examples=30, deadline=None)
def test_a_sharp_spot_is_dirt_and_what_is_beneath_it_stays(
    radius_px: float, contrast: float, x: int, y: int, pressed: bool
) -> None:
    spot = cv2.GaussianBlur((np.hypot(ALONG - y, ACROSS - x) < radius_px).astype(np.float32), (0, 0), 0.8)
    grey = PRESSED if pressed else UNTOUCHED
    corrected, change = CORRECT(noisy(grey * (1 - np.float32(contrast) * spot)), REFERENCE)
    assert change.warnings == (EstimateWarning.DIRT,) and change.dirt_spots == 1
    assert change.dirt_mm2 > np.pi * (radius_px * MM_PER_PX) ** 2
    beneath = (grey / UNTOUCHED)[np.hypot(ALONG - y, ACROSS - x) < radius_px + 8]
    hidden = float(beneath.max() - beneath.min())  # nothing tells what is only seen through the spot
    assert np.abs(cv2.GaussianBlur(corrected.grey / grey - 1, (0, 0), 4)).max() < max(0.02, hidden)


def test_nothing_touches_a_real_sensor_whose_light_has_become_uneven(sensor_a: SensorFolder, real_data: object) -> None:
    """The two reference images of its calibration were taken at other times; one of each is measured against the other."""
    references = [read_image(real_data / "sensor_a" / f"{press}_reference.png") for press in ("board", "ball")]  # type: ignore[operator]
    physics = sensor_a.estimator("physics")
    for before, after in (references, references[::-1]):
        reading = read_frame(Frame(after), sensor_a.shape, sensor_a.shape.depth_reader(Frame(before)))
        assert EstimateWarning.LIGHT_CHANGED in reading.light.warnings
        estimate = physics.estimate(reading)
        assert not estimate.touching and not estimate.wrench.six.any()


def test_presses_of_real_sensors_are_neither_dirt_nor_bands(sensor_a: SensorFolder, real_data: object) -> None:
    """A ball is read as before, and a board, under which no skin is flat, is not corrected."""
    folder = real_data / "sensor_a"  # type: ignore[operator]
    for press in ("ball", "board"):
        reader = sensor_a.shape.depth_reader(Frame(read_image(folder / f"{press}_reference.png")))
        frame = Frame(read_image(folder / f"{press}.png"))
        read = read_frame(frame, sensor_a.shape, reader)
        np.testing.assert_array_equal(read.rectified.grey, sensor_a.shape.rectify(frame).grey)
        assert not read.light.warnings


def test_a_hair_across_the_view_of_a_real_press_is_dirt(sensor_a: SensorFolder, real_data: object) -> None:
    """It is taken out, however long it is."""
    folder = real_data / "sensor_a"  # type: ignore[operator]
    reader = sensor_a.shape.depth_reader(Frame(read_image(folder / "ball_reference.png")))
    ball = read_image(folder / "ball.png")
    hair = cv2.polylines(
        np.zeros(ball.shape[:2], np.float32), [np.array([[60, 90], [330, 240], [580, 420]])], False, 1, 2
    )
    hairy = np.rint(ball * (1 - 0.4 * cv2.GaussianBlur(hair, (0, 0), 0.8))[..., None]).astype(np.uint8)
    before, after = (read_frame(Frame(image), sensor_a.shape, reader) for image in (ball, hairy))
    assert EstimateWarning.DIRT in after.light.warnings and not before.light.warnings
    assert after.max_indentation_mm == pytest.approx(before.max_indentation_mm, rel=0.03)


@pytest.mark.parametrize("gain", [0.95, 1.02, 1.05])
def test_a_real_press_in_other_light_has_its_depth_and_says_why(
    gain: float, sensor_a: SensorFolder, real_data: object
) -> None:
    folder = real_data / "sensor_a"  # type: ignore[operator]
    reader = sensor_a.shape.depth_reader(Frame(read_image(folder / "ball_reference.png")))
    ball = read_image(folder / "ball.png")
    before, after = (
        read_frame(Frame(cv2.convertScaleAbs(ball, alpha=alpha)), sensor_a.shape, reader) for alpha in (1.0, gain)
    )
    assert after.max_indentation_mm == pytest.approx(before.max_indentation_mm, rel=0.02)
    assert EstimateWarning.LIGHT_CHANGED in after.warnings and not before.light.warnings

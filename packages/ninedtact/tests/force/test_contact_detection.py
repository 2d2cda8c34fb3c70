"""The gate: noise and lamps are no touch, whatever the image's size; a shallow dent is one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.force.contact_detection import (
    ContactRegionSettings,
    detect_contact,
    find_contact_region,
    measure_darkening_and_limit,
    measure_even_noise,
    measure_smooth_noise,
    pressure_reaches_unseen,
)
from ninedtact.force.traction.estimator import build_traction_force
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, HeightMap, HeightSource, Rectified
from ninedtact.reading import Reading, StreamMemory, read_frame
from ninedtact.simulation.objects.catalogue import indenter_from_name

FULL = (345, 460), 0.0522


def reading(
    shape: tuple[int, int],
    mm_per_px: float,
    seed: int,
    *,
    lamp: float = 1.0,
    noise: float = 1.0,
    dent: float = 0.0,
    at: tuple[float, float] = (0.0, 0.0),
) -> Reading:
    """An image that is dimmer at its rim, with noise in grey levels, another brightness of the lamp, a dent that darkens."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
    untouched = 150 * (1 - 0.4 * (x**2 + y**2) / 2)
    dark = dent * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 0.02)
    seen = untouched * lamp * (1 - dark) + rng.normal(0, noise, shape)
    reference = untouched + rng.normal(0, noise / 3, shape)
    height = HeightMap(
        (-dark + rng.normal(0, 0.005, shape)).astype(np.float32),
        np.full(shape, HeightSource.MEASURED, np.uint8), mm_per_px, 0.005,
    )  # fmt: skip
    images = (Rectified(one.astype(np.float32), mm_per_px) for one in (seen, reference))
    rectified, kept = images
    return Reading(Frame(np.zeros((1, 1, 3), np.uint8)), rectified, height, reference=kept)


@pytest.mark.parametrize("gain", [0.95, 0.985, 1.08])
@pytest.mark.parametrize("learnt_s", [0.0, 60.0])
def test_a_gain_of_whole_grey_levels_is_no_touch(gain: float, learnt_s: float, physical_sensor: SensorFolder) -> None:
    """Levels are rounded a second time, alike over wide regions, as cameras and programs do; also late in a quiet stream."""
    renderer, shape = physical_sensor.twin().renderer, physical_sensor.shape
    reader = shape.depth_reader(*(Frame(renderer.noise.add_to(renderer.reference, seed)) for seed in range(10)))
    image = np.rint(renderer.noise.add_to(renderer.reference, 10) * gain).astype(np.uint8)
    quiet = StreamMemory(noise=5e-4, darkening=1e-3, learnt_s=learnt_s)
    assert not detect_contact(replace(read_frame(Frame(image), shape, reader), stream=quiet))


@pytest.mark.parametrize(
    ("shape", "mm_per_px", "noise", "lamp"),
    [(*FULL, 0.2, 0.95), (*FULL, 3.0, 1.06), ((180, 240), 0.1, 1.0, 1.0), ((180, 240), 0.1, 3.0, 0.95)],
)
def test_noise_and_lamps_are_no_touch(shape: tuple[int, int], mm_per_px: float, noise: float, lamp: float) -> None:
    assert not any(detect_contact(reading(shape, mm_per_px, seed, lamp=lamp, noise=noise)) for seed in range(20))


@pytest.mark.parametrize("lamp", [0.95, 1.06])
def test_a_dent_of_a_hundredth_is_a_touch(lamp: float) -> None:
    assert all(detect_contact(reading(*FULL, seed, lamp=lamp, dent=0.01)) for seed in range(10))


@pytest.mark.parametrize("at", [(1.0, 1.0), (-1.0, 0.3), (0.2, -1.0)])
def test_an_led_at_the_border_that_is_a_little_dimmer_is_no_touch_and_a_press_there_is(at: tuple[float, float]) -> None:
    assert not detect_contact(reading(*FULL, 0, dent=0.006, at=at))
    assert detect_contact(reading(*FULL, 0, dent=0.03, at=at))
    assert detect_contact(reading(*FULL, 0, dent=0.006, at=(0.7 * at[0], 0.7 * at[1])))


def test_bulges_beside_a_wide_object_that_is_dragged_are_no_noise(physical_sensor: SensorFolder) -> None:
    """They brighten most of the view, so that a key that was held was taken for noise, and then for the untouched skin."""
    twin, shape = physical_sensor.twin(), physical_sensor.shape
    reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(4)))
    for name in ("key_01", "coin_01"):
        press = None
        for drag_mm in (0.0, 0.9):
            press = twin.press(press, indenter_from_name(name), Pose(drag_mm, 0.2, 0.6, 0.2 * drag_mm))
        pressed = read_frame(Frame(twin.renderer(press.corrected, 1)), shape, reader)
        assert measure_darkening_and_limit(pressed)[0] > 3 * measure_even_noise(pressed)
    noise = reading(*FULL, 1, noise=6.0)
    assert measure_even_noise(noise) == pytest.approx(measure_smooth_noise(noise), rel=0.3)


@pytest.mark.parametrize("wave_mm", [5.0, 8.0, 12.0])
def test_a_wide_ring_and_its_bulges_are_no_noise(wave_mm: float) -> None:
    """They brighten and darken all parts of the view: rings of 11 N were taken for noise, and then for untouched skin."""
    untouched = reading(*FULL, 1)
    y, x = (np.mgrid[: FULL[0][0], : FULL[0][1]] - np.array([172, 230])[:, None, None]) * FULL[1]
    grey = untouched.rectified.grey * (1 - 0.04 * np.cos(2 * np.pi * np.hypot(x, y) / wave_mm)).astype(np.float32)
    pressed = replace(untouched, rectified=Rectified(grey.astype(np.float32), FULL[1]))
    assert measure_darkening_and_limit(pressed)[0] > 4 * measure_even_noise(pressed)


def test_pins_all_over_the_view_are_a_touch_and_not_noise() -> None:
    untouched = reading(*FULL, 1)
    y, x = np.mgrid[: FULL[0][0], : FULL[0][1]] * FULL[1]
    pins = np.exp((np.cos(2 * np.pi * x / 2.5) + np.cos(2 * np.pi * y / 2.5) - 2) / 0.25)
    grey = untouched.rectified.grey * (1.03 - 0.2 * pins).astype(np.float32)
    assert detect_contact(replace(untouched, rectified=Rectified(grey.astype(np.float32), FULL[1])))


@pytest.mark.parametrize("reference", ["board_reference", "ball_reference"])
def test_the_board_of_a_real_sensor_touches(reference: str, sensor_a: SensorFolder, real_data: Path) -> None:
    folder = real_data / "sensor_a"
    depth_reader = sensor_a.shape.depth_reader(Frame(read_image(folder / f"{reference}.png")))
    frame = Frame(read_image(folder / "board.png"))
    rectified = sensor_a.shape.rectify(frame)
    read = Reading(frame, rectified, depth_reader(rectified), reference=depth_reader.reference)
    assert detect_contact(read)
    assert build_traction_force(sensor_a.shape, sensor_a.gel).estimate(read).wrench.force_n[2] < -1


SETTINGS = ContactRegionSettings()
BLOCK, ASIDE, FAR = np.s_[6:11, 6:11], np.s_[6:9, 11:14], np.s_[14:16, 18:21]


def region_of(
    *dents: tuple[tuple[slice, slice], float], noise: float = 1e-3, margin_mm: float = 0.0, far_change: float = -0.1
) -> np.ndarray | None:
    """The contact region of square dents, of which the first and the far one are dark."""
    z_mm, change = np.zeros((2, 20, 26), np.float32)
    for place, depth_mm in dents:
        z_mm[place] = -depth_mm
    change[FAR] = far_change
    change[dents[0][0]] = -0.2
    z_mm[0] = -margin_mm
    return find_contact_region(change, z_mm, np.ones_like(z_mm), noise, 1, SETTINGS)


@pytest.mark.parametrize(("deepest_mm", "shallow_mm", "deep_mm"), [(2.0, 0.06, 0.2), (0.4, 0.02, 0.05)])
def test_a_contact_takes_in_what_is_deep_and_what_is_joined_to_it(
    deepest_mm: float, shallow_mm: float, deep_mm: float
) -> None:
    expected = np.zeros((20, 26), np.float32)
    expected[5:12, 6:11] = expected[6:11, 5:12] = 1  # the block and its rim
    alone = region_of((BLOCK, deepest_mm), (ASIDE, 0.9 * shallow_mm), (FAR, 0.9 * deep_mm))
    assert alone is not None
    np.testing.assert_array_equal(alone, expected)
    joined = region_of((BLOCK, deepest_mm), (ASIDE, 1.1 * shallow_mm), (FAR, 1.1 * deep_mm))
    assert joined is not None and joined[ASIDE].all() and joined[FAR].all()
    assert joined[:, 16:].sum() == 6 + 10  # with its rim
    sunk = region_of((BLOCK, deepest_mm), (FAR, 1.1 * deep_mm), far_change=-0.002)  # with the base below
    np.testing.assert_array_equal(sunk, expected)


def test_cells_that_are_half_as_dark_as_the_darkest_are_in_contact_at_any_height() -> None:
    """Deep presses saturate the depth curve, and a depth reader may then give heights that are too shallow."""
    z_mm, change = np.zeros((2, 20, 26), np.float32)
    change[BLOCK], change[FAR] = -0.2, -0.05  # the smaller patch is a quarter as dark at most
    region = find_contact_region(change, z_mm, np.ones_like(z_mm), 1e-4, 1, SETTINGS)
    assert region is not None and region[BLOCK].all() and not region[FAR].any()


def test_pressure_beside_what_is_unseen_reaches_it() -> None:
    in_view, pressure = np.ones((8, 9), np.float32), np.zeros((8, 9), np.float32)
    in_view[:, 0], pressure[4, 5] = 0, 2.0
    for col, part, reaches in ((1, 0.12, True), (1, 0.08, False), (2, 1.0, False)):
        beside = pressure.copy()
        beside[4, col] = part
        assert pressure_reaches_unseen(beside, in_view) == reaches

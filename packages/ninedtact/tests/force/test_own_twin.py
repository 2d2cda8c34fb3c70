"""A calibrated sensor reads the presses of its own twin, from light ones to those as deep as its calibration ball."""

import numpy as np
import pytest

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import read_frame
from ninedtact.simulation.objects.catalogue import indenter_from_name


@pytest.mark.parametrize("radius_mm", [2.0, 4.0, 8.0])
def test_loads_are_right_from_light_presses_to_deep_ones(radius_mm: float, physical_sensor: SensorFolder) -> None:
    twin, shape = physical_sensor.twin(), physical_sensor.shape
    estimator = physical_sensor.estimator("physics", with_force_scale=False)
    depth_reader = shape.depth_reader(*(Frame(twin.renderer(None, -number)) for number in range(1, 9)))
    last = None
    for depth_mm in (0.5, 0.8, 1.1, 1.4, 1.8):
        last = twin.press(last, Ball(radius_mm), Pose(0.7, -0.4, depth_mm))
        estimator.forget()
        found = estimator.estimate(read_frame(Frame(twin.renderer(last.corrected, 1)), shape, depth_reader))
        assert found.wrench.six[2] == pytest.approx(last.wrench.six[2], rel=0.08)
        assert not found.warnings


@pytest.mark.parametrize("item", ["key_05", "letter_03"])
def test_gel_that_a_wide_press_displaces_is_no_change_of_the_light(item: str, physical_sensor: SensorFolder) -> None:
    twin, shape = physical_sensor.twin(), physical_sensor.shape
    estimator = physical_sensor.estimator("physics", with_force_scale=False)
    depth_reader = shape.depth_reader(*(Frame(twin.renderer(None, -number)) for number in range(1, 9)))
    press = twin.press(None, indenter_from_name(item), Pose(0.7, -0.4, 0.8))
    image, rounding = twin.renderer(press.corrected, 1), np.random.default_rng(1).uniform(-0.5, 0.5, (480, 640, 3))
    for gain in (0.96, 0.985, 1.0, 1.01, 1.03):
        dimmed = np.clip(np.round(image * gain + rounding), 0, 255).astype(np.uint8)
        estimator.forget()
        reading = read_frame(Frame(dimmed), shape, depth_reader)
        if abs(gain - 1) < 0.005:
            assert reading.light.gain == 1
        found = estimator.estimate(reading)
        assert found.wrench.six[2] == pytest.approx(press.wrench.six[2], rel=0.06), gain
        assert not found.warnings


def test_a_wide_object_at_the_border_is_a_plausible_press(physical_sensor: SensorFolder) -> None:
    twin, shape = physical_sensor.twin(), physical_sensor.shape
    depth_reader = shape.depth_reader(*(Frame(twin.renderer(None, -number)) for number in range(1, 9)))
    for item, depth_mm in (("gear_07", 0.5), ("key_05", 0.9)):
        press = twin.press(None, indenter_from_name(item), Pose(1.2, 0.5, depth_mm))
        assert not read_frame(Frame(twin.renderer(press.corrected, 1)), shape, depth_reader).image_warnings

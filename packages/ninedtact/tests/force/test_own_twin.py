"""A calibrated sensor reads the presses of its own twin, from light ones to those as deep as its calibration ball."""

import pytest

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import read_frame


@pytest.mark.parametrize("radius_mm", [2.0, 4.0, 8.0])
def test_loads_are_right_from_light_presses_to_deep_ones(radius_mm: float, physical_sensor: SensorFolder) -> None:
    twin, shape = physical_sensor.twin(), physical_sensor.shape
    estimator = physical_sensor.estimator("physics", with_force_scale=False)
    depth_reader = shape.depth_reader(*(Frame(twin.renderer(None, -number)) for number in range(1, 9)))
    last = None
    for depth_mm in (0.5, 0.8, 1.1, 1.4):
        last = twin.press(last, Ball(radius_mm), Pose(0.7, -0.4, depth_mm))
        estimator.forget()
        found = estimator.estimate(read_frame(Frame(twin.renderer(last.corrected, 1)), shape, depth_reader))
        assert found.wrench.six[2] == pytest.approx(last.wrench.six[2], rel=0.08)
        assert not found.warnings

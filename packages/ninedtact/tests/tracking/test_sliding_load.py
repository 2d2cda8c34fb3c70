"""The load of a contact that slides: closed forms of thin and thick gel, and a gear on a twin."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import Gel
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, Traction
from ninedtact.reading import read_frame
from ninedtact.simulation.object_motions import MotionSettings, play_motion
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.tracking import ContactTracker, SlipState
from ninedtact.tracking.sliding_load import overread_of_sliding

PITCH_MM, RADIUS_MM = 0.2, 6.0
X, Y = np.meshgrid(*(2 * [(np.arange(100) - 49.5) * PITCH_MM]))
PRESSURE = np.clip(1 - (X**2 + Y**2) / RADIUS_MM**2, 0, None) ** 2


def sticking(thickness_mm: float, base: float = 0.0) -> Traction:
    """Pressure, and the shear that holds the skin of a thin layer in place: half its thickness times the pressure's gradient."""
    down, right = np.gradient(PRESSURE, PITCH_MM)
    shear = thickness_mm / 2 * np.stack([right, down]).astype(np.float32)
    gel = Gel(thickness_mm=thickness_mm, gel_to_base_modulus_ratio=base)
    return Traction(PRESSURE.astype(np.float32), shear, PITCH_MM, gel=gel)


def test_a_thin_layer_between_two_walls_bears_four_times_the_load_and_a_half_space_no_more() -> None:
    overread = [overread_of_sliding(sticking(thickness_mm)) for thickness_mm in (0.3, 1.0, 2.0, 20.0)]
    assert overread[0] == pytest.approx(4, rel=0.06) and overread[3] == pytest.approx(1, abs=0.01)
    assert np.diff(overread).max() < 0


@pytest.mark.parametrize("base", [0.0, 0.1])
def test_shear_that_is_spread_as_the_pressure_slides_already(base: float) -> None:
    slides = replace(sticking(2.0, base), shear_mpa=np.stack([0.4 * PRESSURE, -0.1 * PRESSURE]).astype(np.float32))
    assert overread_of_sliding(slides) == pytest.approx(1, abs=1e-6)
    assert overread_of_sliding(replace(slides, pressure_mpa=0 * slides.pressure_mpa)) == 1


def test_load_and_friction_of_a_gear_that_slides_are_those_of_the_twin(physical_sensor: SensorFolder) -> None:
    friction = 0.2
    twin, shape = replace(physical_sensor.twin(), friction=friction), physical_sensor.shape
    estimator, tracker = physical_sensor.estimator("physics"), ContactTracker()
    reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(4)))
    motion = MotionSettings(Pose(-0.8, -0.2, 0.3), 12.0, friction).motion("slide")
    loads_n, frictions = list[tuple[float, float, float]](), list[float]()
    for number, step in enumerate(play_motion(twin, indenter_from_name("gear_07"), motion)):
        if number < 18 or number > 34:  # it is pressed before, and held after
            continue
        frame = Frame(twin.renderer(step.press.corrected, number), round((number + 1) * 1e9 / 60), number)
        alone = estimator.add_force(read_frame(frame, shape, reader))
        found = tracker.update(alone)
        if found.slip.state == SlipState.GROSS and step.slip.state == SlipState.GROSS:
            assert found.reading.wrench is not None and alone.wrench is not None
            each = found.reading.wrench, alone.wrench, step.press.wrench
            loads_n.append(tuple(-float(wrench.force_n[2]) for wrench in each))
            frictions.append(found.slip.friction)
    followed_n, of_images_n, true_n = np.mean(loads_n, axis=0)
    assert followed_n == pytest.approx(true_n, rel=0.04) and abs(of_images_n / true_n - 1) > 0.08
    assert frictions[-1] == pytest.approx(friction, rel=0.08)

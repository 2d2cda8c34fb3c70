"""The twin's force/torque sensor: the truth, its errors as they were asked for, and their removal by a tare."""

import numpy as np
import pytest
from small_press_simulation import small_press_simulation

from ninedtact.simulation.simulated_sources import (
    NO_FORCE_TORQUE_ERRORS,
    ForceTorqueSensorNoise,
    SimulatedForceTorque,
)

BIAS = (0.3, -0.2, 1.0, 0.01, -0.02, 0.005)


def test_without_errors_it_tells_the_truth_about_its_own_origin() -> None:
    stage = small_press_simulation()
    with SimulatedForceTorque(stage, hz=10.0, errors=NO_FORCE_TORQUE_ERRORS) as sensor:
        told = [sensor.read() for _ in range(14)]
    true = stage.contact(13).wrench()
    assert told[13].about_mm == pytest.approx([0, 0, -35])
    assert told[13].force_n == pytest.approx(true.force_n, abs=1e-9) and true.force_n[2] < -1
    assert told[13].about(np.zeros(3)).torque_nm == pytest.approx(true.torque_nm, abs=1e-9)
    assert told[13].torque_nm == pytest.approx(true.torque_nm + np.cross([0, 0, 0.035], true.force_n), abs=1e-9)


def test_noise_and_bias_are_as_asked_and_a_tare_takes_the_bias_off() -> None:
    with SimulatedForceTorque(
        small_press_simulation(), hz=20_000.0, errors=ForceTorqueSensorNoise(bias=BIAS)
    ) as sensor:
        untouched = np.array([sensor.read().six for _ in range(4000)])
    assert np.allclose(untouched.std(axis=0), ForceTorqueSensorNoise().noise, rtol=0.06)
    tare = untouched.mean(axis=0)
    assert (np.abs(tare - BIAS) < 4 * np.array(ForceTorqueSensorNoise().noise) / np.sqrt(4000)).all()
    assert np.abs(np.corrcoef(untouched.T) - np.eye(6)).max() < 0.07

"""The sum of tractions is the wrench; errors of a wrench move with its torques; the scale of a sensor is common to all axes."""

import numpy as np
import pytest

from ninedtact.force.estimator_and_scale import UNCALIBRATED, ForceScale
from ninedtact.quantities import Traction, Wrench, WrenchEstimate, centred_axis_mm, diagonal_covariance

SIX = np.array([1.0, -0.5, -6.0, 0.01, 0.02, 0.003])
STD = np.array([0.1, 0.2, 0.3, 1e-3, 2e-3, 1e-4])
BELOW_MM = np.array([0.0, 0.0, -35.0])


def estimate(std: np.ndarray = STD) -> WrenchEstimate:
    return WrenchEstimate(Wrench(SIX[:3], SIX[3:]), diagonal_covariance(std), touching=True)


@pytest.mark.parametrize("shape", [(5, 7), (4, 6)])
def test_a_wrench_is_the_sum_of_its_tractions_on_the_pressed_skin(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    pressure, height_mm = rng.random((2, *shape)).astype(np.float32)
    shear = rng.normal(size=(2, *shape)).astype(np.float32)
    x, y = np.meshgrid(*(centred_axis_mm(side, 0.5) for side in shape[::-1]))
    force = np.stack([*shear, -pressure], axis=-1).reshape(-1, 3).astype(float) * 0.25
    torque = np.cross(np.stack([x, y, height_mm], axis=-1).reshape(-1, 3), force).sum(0) / 1e3
    found = Traction(pressure, shear, 0.5, height_mm=height_mm).wrench()
    assert found.six == pytest.approx(np.concatenate([force.sum(0), torque]), rel=1e-5, abs=1e-9)


def test_a_torque_about_another_point_is_the_cross_product_of_the_arm_and_the_force() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        force_n, torque_nm, old_mm, new_mm = rng.normal(0, 5, (4, 3))
        moved = Wrench(force_n, torque_nm, old_mm, stamp_ns=7).about(new_mm)
        np.testing.assert_allclose(moved.torque_nm, torque_nm + np.cross((old_mm - new_mm) / 1e3, force_n), atol=1e-12)
        np.testing.assert_array_equal(moved.force_n, force_n)
        np.testing.assert_array_equal(moved.about_mm, new_mm)
        assert not np.shares_memory(moved.about_mm, new_mm) and moved.stamp_ns == 7
        six = np.arange(1.0, 7.0)
        one = WrenchEstimate(Wrench(force_n, torque_nm, old_mm), np.outer(six, six), touching=True)
        shifted = np.concatenate([six[:3], six[3:] + np.cross((old_mm - new_mm) / 1e3, six[:3])])
        np.testing.assert_allclose(one.about(new_mm).covariance, np.outer(shifted, shifted), atol=1e-12)


def test_unknown_errors_stay_unknown() -> None:
    moved = estimate(np.full(6, np.inf)).about(BELOW_MM)
    assert np.isinf(moved.std).all()
    assert np.isinf(ForceScale(2.0, error=0.1)(estimate(np.full(6, np.inf))).std).all()


def test_the_errors_of_modulus_and_base_are_stated_until_the_sensor_is_calibrated_for_force() -> None:
    scaled = UNCALIBRATED(estimate())
    np.testing.assert_array_equal(scaled.wrench.six, SIX)
    np.testing.assert_allclose(scaled.std, np.hypot(STD, np.hypot(0.25, 0.1) * np.abs(SIX)))
    # It is one factor: the error of a lever arm, the ratio of torque to force, does not grow.
    arm = np.array([0, 0, SIX[3] / SIX[2] ** 2, -1 / SIX[2], 0, 0])
    assert arm @ scaled.covariance @ arm < 1.01 * (arm @ estimate().covariance @ arm)

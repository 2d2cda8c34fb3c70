"""The sum of tractions is the wrench, torque by arms and all."""

import numpy as np
import pytest

from ninedtact.quantities import Traction, centred_axis_mm


@pytest.mark.parametrize("shape", [(5, 7), (4, 6)])
def test_a_wrench_is_the_sum_of_its_tractions(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    pressure, shear = rng.random(shape).astype(np.float32), rng.normal(size=(2, *shape)).astype(np.float32)
    x, y = np.meshgrid(*(centred_axis_mm(side, 0.5) for side in shape[::-1]))
    force = np.stack([*shear, -pressure], axis=-1).reshape(-1, 3).astype(float) * 0.25
    torque = np.cross(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), force).sum(0) / 1e3
    found = Traction(pressure, shear, 0.5).wrench()
    assert found.six == pytest.approx(np.concatenate([force.sum(0), torque]), rel=1e-5, abs=1e-9)

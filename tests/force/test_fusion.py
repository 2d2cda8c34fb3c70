"""Network and physics together: nothing without contact, between the two with it, nearer to the surer one."""

import numpy as np
import pytest

from ninedtact.force.fusion import inverse_variance_mean


def test_the_surer_one_counts_more_axis_by_axis() -> None:
    one, other = np.arange(6.0), np.arange(6.0) + 3
    found = inverse_variance_mean(one, np.array([1, 1, 1, 1, 3, 1e-9]), other, np.array([1, 2, 1e-9, np.inf, 1, 1]))
    np.testing.assert_allclose(found - one, [1.5, 0.6, 3, 0, 2.7, 0], atol=1e-6)
    assert np.isfinite(found).all()


def test_alike_estimates_stay_as_they_are() -> None:
    six, rng = np.linspace(-3, 2, 6), np.random.default_rng(0)
    assert inverse_variance_mean(six, rng.uniform(0.1, 2, 6), six, rng.uniform(0.1, 2, 6)) == pytest.approx(six)

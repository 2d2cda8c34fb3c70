"""Two estimates of one contact: weighed by their errors, and honest where they differ."""

import numpy as np
import pytest

from ninedtact.force.fusion import fuse_estimates
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate

STD = np.array([0.1, 0.1, 0.2, 1e-3, 1e-3, 1e-4])


def estimate(six: np.ndarray, std: np.ndarray = STD, warnings: tuple[EstimateWarning, ...] = ()) -> WrenchEstimate:
    return WrenchEstimate(Wrench(six[:3], six[3:]), np.diag(std**2), True, warnings)


def test_equal_estimates_stay_and_their_error_does_not_shrink() -> None:
    six = np.array([1.0, 0, -5, 0.01, 0, 0])
    fused = fuse_estimates(estimate(six), estimate(six))
    np.testing.assert_allclose(fused.wrench.six, six)
    np.testing.assert_allclose(fused.std, STD)
    assert fused.warnings == ()


def test_the_more_certain_estimate_weighs_more_and_one_with_a_warning_less() -> None:
    low, high = np.zeros(6), STD
    certain = fuse_estimates(estimate(low, STD / 2), estimate(high))
    assert (certain.wrench.six < STD / 2).all()
    warned = fuse_estimates(estimate(low, warnings=(EstimateWarning.UNLIKE_TRAINING,)), estimate(high))
    np.testing.assert_allclose(warned.wrench.six, 0.9 * STD)
    assert warned.warnings == (EstimateWarning.UNLIKE_TRAINING,)


@pytest.mark.parametrize(("apart", "warns"), [(2.0, False), (4.0, True)])
def test_a_disagreement_is_covered_by_the_stated_error_and_said_beyond_three_deviations(
    apart: float, warns: bool
) -> None:
    apart_by = apart * np.sqrt(2) * STD
    fused = fuse_estimates(estimate(np.zeros(6)), estimate(apart_by))
    assert (fused.std >= apart_by / np.sqrt(2) - 1e-12).all()
    assert (EstimateWarning.ESTIMATORS_DISAGREE in fused.warnings) is warns

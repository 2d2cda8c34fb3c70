"""Network and physics fused: nothing without contact, between the two with it, nearer to the more certain one."""

import numpy as np
import pytest
from linear_model import a_card, linear_model

from ninedtact.design import Gel
from ninedtact.force.contact_detection import detect_contact
from ninedtact.force.fusion import FusedForceEstimator, inverse_variance_mean
from ninedtact.force.network_force import NetworkForce
from ninedtact.force.onnx_model import parse_force_model
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.force.traction.observation import HeightObservationModel
from ninedtact.quantities import Frame, HeightMap, HeightSource, Rectified
from ninedtact.reading import Reading


def test_the_surer_one_counts_more_axis_by_axis() -> None:
    one, other = np.arange(6.0), np.arange(6.0) + 3
    found = inverse_variance_mean(one, np.array([1, 1, 1, 1, 3, 1e-9]), other, np.array([1, 2, 1e-9, np.inf, 1, 1]))
    np.testing.assert_allclose(found - one, [1.5, 0.6, 3, 0, 2.7, 0], atol=1e-6)
    assert np.isfinite(found).all()


def test_alike_estimates_stay_as_they_are() -> None:
    six, rng = np.linspace(-3, 2, 6), np.random.default_rng(0)
    assert inverse_variance_mean(six, rng.uniform(0.1, 2, 6), six, rng.uniform(0.1, 2, 6)) == pytest.approx(six)


def reading(depth_mm: float) -> Reading:
    """A smooth dent, and noise."""
    x, y = np.meshgrid(np.linspace(-12, 12, 120), np.linspace(-9, 9, 90))
    z_mm = -depth_mm * np.exp(-(x**2 + y**2) / 4) + np.random.default_rng(0).normal(0, 0.003, x.shape)
    height = HeightMap(z_mm.astype(np.float32), np.full(x.shape, HeightSource.MEASURED, np.uint8), 0.2, 0.003)
    return Reading(Frame(np.zeros((1, 1, 3), np.uint8)), Rectified(np.full(x.shape, 128, np.float32), 0.2), height)


@pytest.mark.parametrize(("depth_mm", "touching"), [(0.0, False), (0.8, True)])
def test_contact_is_detected_once_a_frame(depth_mm: float, touching: bool) -> None:
    calls = []

    def counted(one: Reading) -> bool:
        calls.append(one)
        return detect_contact(one)

    model = parse_force_model(linear_model(a_card()).SerializeToString(), "linear.onnx")
    network, physics = NetworkForce(model, Gel(), counted), TractionForce(HeightObservationModel(), Gel())
    found = FusedForceEstimator(network, physics).estimate(reading(depth_mm))
    assert found.touching == touching and len(calls) == 1
    assert found.wrench.six.any() == touching
    assert (physics.last is not None) == touching

"""A model as an estimator: zero exactly without contact, scaled to the gel, doubted where training did not reach."""

import numpy as np
import pytest
from linear_model import SMALL, a_card, linear_model

from ninedtact.design import Gel
from ninedtact.errors import ForceEstimationError
from ninedtact.force.network_force import NetworkForce
from ninedtact.force.network_input import (
    TYPICAL_FEATURES,
    InputChannels,
    NetworkInputSettings,
)
from ninedtact.force.onnx_model import parse_force_model
from ninedtact.quantities import EstimateWarning, Frame, HeightMap, HeightSource, Rectified
from ninedtact.reading import Reading

ROWS, COLS, MM_PER_PX = 60, 80, 0.3


def reading(depth_mm: float, noise_mm: float = 0.003) -> Reading:
    """A dent in the middle, and noise."""
    z_mm = np.random.default_rng(0).normal(0, noise_mm, (ROWS, COLS)).astype(np.float32)
    z_mm[25:35, 35:45] -= np.float32(depth_mm)
    height = HeightMap(z_mm, np.full(z_mm.shape, HeightSource.MEASURED, np.uint8), MM_PER_PX, noise_mm, stamp_ns=7)
    frame = Frame(np.zeros((4, 4, 3), np.uint8), stamp_ns=7)
    grey = np.float32(128) * (1 + np.float32(0.1) * z_mm)
    return Reading(frame, Rectified(grey, MM_PER_PX, 7), height, Rectified(np.full_like(z_mm, 128), MM_PER_PX))


def estimator(about_mm: tuple[float, float, float] = (0.0, 0.0, 0.0), gel: Gel = Gel()) -> NetworkForce:
    """Each pixel's height in gel thicknesses presses by as many N, and shears by half."""
    per_input = np.tile([0.5, 0.25, 1.0, 0.0, 0.0, 0.0], (SMALL.rows * SMALL.cols, 1))
    content = linear_model(a_card(about_mm=about_mm), per_input, np.arange(1, 7)).SerializeToString()
    return NetworkForce(parse_force_model(content, "linear.onnx"), gel)


def test_without_contact_the_wrench_is_zero_exactly() -> None:
    found = estimator().estimate(reading(0.0))
    assert not found.touching and not found.wrench.six.any() and found.wrench.stamp_ns == 7 and found.warnings == ()
    assert np.isfinite(found.std).all() and (found.std > 0).all()


def test_error_is_the_deviation_of_the_scale_and_all_grows_with_the_modulus() -> None:
    found = estimator().estimate(reading(0.5))
    assert found.touching and found.wrench.stamp_ns == 7
    assert found.wrench.force_n[2] == pytest.approx(-0.5 / 2.5 * 100 * (MM_PER_PX / SMALL.mm_per_px) ** 2, rel=0.2)
    np.testing.assert_allclose(found.std, np.sqrt(2) * np.arange(1, 7))
    stiff = estimator(gel=Gel(shear_modulus_mpa=2 * 0.093)).estimate(reading(0.5))
    np.testing.assert_allclose(stiff.wrench.six, 2 * found.wrench.six)
    np.testing.assert_allclose(stiff.std, 2 * found.std)


def test_the_twist_that_no_image_shows_is_in_the_error_of_a_network_that_is_sure() -> None:
    sure = estimator()
    per_input = np.tile([0.5, 0.25, 1.0, 0.0, 0.0, 0.0], (SMALL.rows * SMALL.cols, 1))
    content = linear_model(a_card(), per_input, np.full(6, 1e-9)).SerializeToString()
    sure.model = parse_force_model(content, "sure.onnx")
    found = sure.estimate(reading(0.5))
    radius_m = 10 * MM_PER_PX / np.sqrt(12) / 1e3  # of the square dent of 10 pixels
    assert found.std[5] == pytest.approx(np.hypot(0.08, 0.3) * abs(found.wrench.force_n[2]) * radius_m, rel=0.1)
    assert (found.std[:5] < 1e-8).all()


def test_what_training_did_not_see_is_doubted() -> None:
    assert estimator().estimate(reading(0.5)).warnings == ()
    unlike = reading(2.4)
    assert EstimateWarning.UNLIKE_TRAINING in estimator().estimate(unlike).warnings
    stiff = estimator()
    per_input = np.full((SMALL.rows * SMALL.cols, 6), 100.0)
    stiff.model = parse_force_model(linear_model(a_card(), per_input).SerializeToString(), "linear.onnx")
    assert EstimateWarning.OUT_OF_RANGE in stiff.estimate(reading(0.5)).warnings


def test_a_model_with_sensor_features_refuses_to_run_without_them() -> None:
    card = a_card(settings=NetworkInputSettings(InputChannels.HEIGHTS_AND_SENSOR, rows=6, cols=8, mm_per_px=3.0))
    model = parse_force_model(linear_model(card).SerializeToString(), "linear.onnx")
    with pytest.raises(ForceEstimationError, match=r"expected the features of the sensor .*\.estimator\("):
        NetworkForce(model, Gel())
    assert NetworkForce(model, Gel(), features=TYPICAL_FEATURES).estimate(reading(0.5)).touching

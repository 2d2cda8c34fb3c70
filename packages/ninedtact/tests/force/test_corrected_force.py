"""Physics that a network corrects: where the network knows the image it counts, where not the answer is that of physics."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_model import a_card, linear_model

from ninedtact.design import Gel
from ninedtact.force.corrected_force import NetworkCorrectedForce, apply_network_correction
from ninedtact.force.estimator_and_scale import zero_wrench
from ninedtact.force.network_input import (
    TYPICAL_FEATURES,
    InputChannels,
    NetworkInputSettings,
    tractions_over_shear_modulus,
)
from ninedtact.force.onnx_model import ForceModel, parse_force_model
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.quantities import (
    EstimateWarning,
    Frame,
    HeightMap,
    HeightSource,
    Rectified,
    Traction,
    Wrench,
    WrenchEstimate,
    diagonal_covariance,
)
from ninedtact.reading import Reading
from ninedtact.shape.orthorectification import SkinGrid

STD = np.array([0.1, 0.1, 0.2, 1e-3, 1e-3, 1e-4])
SIX = np.array([0.5, -0.2, -5.0, 0.01, -0.02, 1e-4])
SETTINGS = NetworkInputSettings(InputChannels.PHYSICS, rows=12, cols=16, mm_per_px=1.5)
MPA = 0.12


def by_physics(**changes: object) -> WrenchEstimate:
    pressure = np.zeros((26, 34), np.float32)
    pressure[10:14, 15:19] = 0.05
    traction = Traction(pressure, np.zeros((2, 26, 34), np.float32), 0.7)
    kept = {"covariance": correlated(), "touching": True, "traction": traction, **changes}
    return WrenchEstimate(Wrench(SIX[:3], SIX[3:], stamp_ns=7), **kept)  # type: ignore[arg-type]


def correlated() -> np.ndarray:
    covariance = np.diag(STD**2)
    covariance[2, 3] = covariance[3, 2] = 0.5 * STD[2] * STD[3]
    return covariance


@given(st.floats(0, 1), st.floats(0.1, 3), st.floats(-10, 10))
def test_a_correction_counts_as_far_as_it_is_trusted(trust: float, relative_std: float, in_stds: float) -> None:
    corrected = apply_network_correction(by_physics(), in_stds * STD, relative_std * STD, trust)
    np.testing.assert_allclose(corrected.wrench.six - SIX, trust * np.clip(in_stds, -4, 4) * STD, atol=1e-12)
    np.testing.assert_allclose((corrected.std / STD) ** 2, trust * relative_std**2 + (1 - trust) * 1.5**2)
    assert corrected.covariance[2, 3] == pytest.approx(0.5 * corrected.std[2] * corrected.std[3])
    assert (EstimateWarning.UNLIKE_TRAINING in corrected.warnings) is (trust == 0)
    assert corrected.traction is not None and corrected.wrench.stamp_ns == 7


@pytest.mark.parametrize("trust", [0.0, 0.5, 1.0])
def test_a_network_that_states_no_error_leaves_that_of_physics(trust: float) -> None:
    corrected = apply_network_correction(by_physics(), STD, np.full(6, np.inf), trust)
    np.testing.assert_allclose((corrected.std / STD) ** 2, trust + (1 - trust) * 1.5**2)


class KnownPhysics(TractionForce):
    """An estimator by physics whose answer is given."""

    def __init__(self, answer: WrenchEstimate) -> None:
        self.name, self.gel = "physics", Gel(2.5, MPA)
        self.answer, self.forgets = answer, 0

    def estimate(self, reading: Reading) -> WrenchEstimate:
        return self.answer

    def forget(self) -> None:
        self.forgets += 1


def model(known: bool = True, about_mm: tuple[float, float, float] = (0.0, 0.0, 0.0), axis: int = 2) -> ForceModel:
    """Corrects F_z, or the force on another axis, by the pressure summed over the input, in the model's unit of modulus."""
    per_input = np.zeros((*SETTINGS.shape, 6))
    per_input[1, ..., axis] = -0.01
    card = msgspec.structs.replace(
        a_card(SETTINGS, about_mm), input_ranges={"max_indentation": (0.0, 0.5) if known else (-1.0, -0.9)}
    )
    written = linear_model(card, per_input.reshape(-1, 6), STD / 2)
    return parse_force_model(written.SerializeToString(), "small")


def reading() -> Reading:
    z_mm = np.full((69, 92), -0.3, np.float32)
    height = HeightMap(z_mm, np.full(z_mm.shape, HeightSource.MEASURED, np.uint8), 0.26, 0.01)
    grey = Rectified(np.full(z_mm.shape, 120, np.float32), 0.26)
    return Reading(Frame(np.zeros((1, 1, 3), np.uint8)), grey, height, reference=grey)


def test_the_network_is_asked_about_tractions_over_the_modulus_and_answers_in_units_of_it() -> None:
    estimator = NetworkCorrectedForce(KnownPhysics(by_physics()), model(), TYPICAL_FEATURES)
    corrected = estimator.estimate(reading())
    summed = tractions_over_shear_modulus(by_physics().traction, MPA, SETTINGS.grid)[0].sum()  # type: ignore[arg-type]
    assert summed > 0.3
    assert corrected.wrench.six[2] - SIX[2] == pytest.approx(-0.01 * summed * MPA / 0.093, rel=1e-4)
    np.testing.assert_allclose(corrected.std, np.sqrt(2) * STD / 2 * MPA / 0.093, rtol=1e-5)
    assert corrected.warnings == ()
    estimator.forget()
    assert estimator.physics.forgets == 1  # type: ignore[attr-defined]


def test_torques_of_a_correction_about_another_point_are_moved_to_the_centre_of_the_skin() -> None:
    below_mm = (0.0, 0.0, -35.0)
    physics = KnownPhysics(by_physics())
    corrected = NetworkCorrectedForce(physics, model(about_mm=below_mm, axis=1), TYPICAL_FEATURES).estimate(reading())
    change = corrected.wrench.six - SIX
    assert change[1] < -0.003
    expected = Wrench(change[:3], np.zeros(3), np.array(below_mm)).about(np.zeros(3))
    np.testing.assert_allclose(change[3:], expected.torque_nm, atol=1e-12)
    at_centre = NetworkCorrectedForce(physics, model(axis=1), TYPICAL_FEATURES).estimate(reading())
    np.testing.assert_array_equal(corrected.std > at_centre.std + 1e-9, [False] * 3 + [True, True, False])


@pytest.mark.parametrize("doubt", ["another image", "not converged", "beyond the training"])
def test_where_the_network_knows_nothing_the_answer_is_that_of_physics(doubt: str) -> None:
    warnings = (EstimateWarning.NOT_CONVERGED,) if doubt == "not converged" else ()
    answer = by_physics(warnings=warnings)
    six = SIX * (3 if doubt == "beyond the training" else 1)
    physics = KnownPhysics(replace(answer, wrench=Wrench(six[:3], six[3:])))
    known = model(known=doubt != "another image")
    estimate = NetworkCorrectedForce(physics, known, TYPICAL_FEATURES).estimate(reading())
    np.testing.assert_allclose(estimate.wrench.six, six)
    np.testing.assert_allclose(estimate.std, 1.5 * STD)
    assert EstimateWarning.UNLIKE_TRAINING in estimate.warnings


def test_without_contact_the_answer_is_zero_and_the_network_is_not_asked() -> None:
    nothing = WrenchEstimate(zero_wrench(), diagonal_covariance(STD), touching=False)
    estimator = NetworkCorrectedForce(KnownPhysics(nothing), model(), TYPICAL_FEATURES)
    assert estimator.estimate(reading()) is nothing


def test_tractions_are_sampled_at_their_places() -> None:
    x = np.linspace(-1, 1, 34, dtype=np.float32)
    pressure = np.broadcast_to(x, (26, 34)).copy()
    traction = Traction(pressure, np.stack([pressure, -pressure]), 0.7)
    found = tractions_over_shear_modulus(traction, 2.0, SkinGrid(10, 11, 1.0))
    assert found.shape == (3, 10, 11)
    wanted = np.arange(-5, 6) / (0.7 * 33 / 2) / 2
    np.testing.assert_allclose(found[0], np.broadcast_to(wanted, (10, 11)), atol=1e-5)
    np.testing.assert_allclose(found[1], -found[2])
    outside = tractions_over_shear_modulus(traction, 2.0, SkinGrid(3, 101, 1.0))
    assert not outside[0][:, :10].any()

"""Weighed presses: the factor they hold is found, a curve only where there is one, and zero stays zero."""

from pathlib import Path

import numpy as np
import pytest

from ninedtact.calibration.force_calibration import (
    ForceScaleImpossible,
    KnownLoadPress,
    fit_force_scale,
)
from ninedtact.errors import FileFormatError
from ninedtact.force.estimator_and_scale import (
    FORCE_SCALE_FILE,
    UNCALIBRATED,
    ForceEstimator,
    ForceScale,
    ScaledForceEstimator,
    apply_sensor_force_scale,
    read_force_scales,
    write_force_scale,
)
from ninedtact.quantities import Frame, HeightMap, Rectified, Traction, Wrench, WrenchEstimate
from ninedtact.reading import Reading

NOTHING = np.zeros(6)
ESTIMATED_N = np.array([0.8, 1.5, 3.0, 5.0, 8.0])


def presses(true_factor: float, curve: float = 0.0, noise: float = 0.02) -> list[KnownLoadPress]:
    scatter = 1 + noise * np.random.default_rng(3).standard_normal(len(ESTIMATED_N))
    weighed = true_factor * ESTIMATED_N * (ESTIMATED_N / 3) ** curve * scatter
    return [KnownLoadPress(float(a), float(b)) for a, b in zip(ESTIMATED_N, weighed, strict=True)]


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.3])
def test_a_soft_or_stiff_gel_is_found_within_its_error(factor: float) -> None:
    judged = fit_force_scale(presses(factor))
    found = judged.adaptation
    assert found.curve == 0 and (factor == 1 or judged.by_factor < 0.2 * judged.unadapted)
    assert abs(found.factor / factor - 1) < 2 * found.error + 0.01


def test_a_gel_that_stiffens_gets_its_curve_and_one_that_does_not_gets_none() -> None:
    bent = fit_force_scale(presses(1.2, curve=0.25))
    assert bent.adaptation.curve == pytest.approx(0.25, abs=0.05)
    assert bent.by_curve is not None and bent.by_curve < bent.by_factor
    assert [bent.adaptation.at(load) for load in (1.0, 8.0)] == pytest.approx(
        [1.2 * 3**-0.25, 1.2 * (8 / 3) ** 0.25], rel=0.05
    )


class Constant(ForceEstimator):
    def __init__(self, six: np.ndarray = NOTHING, name: str = "constant", model_sha256: str = "") -> None:
        self.six, self.name, self.model_sha256 = six, name, model_sha256

    def estimate(self, reading: Reading) -> WrenchEstimate:
        pressed = np.full((4, 6), 0.1, np.float32)
        traction = Traction(pressed, np.zeros((2, 4, 6), np.float32), 0.5)
        return WrenchEstimate(
            Wrench(self.six[:3], self.six[3:]), 0.01 * np.eye(6), bool(self.six.any()), traction=traction
        )

    def forget(self) -> None:
        pass


def reading() -> Reading:
    flat = np.zeros((4, 6), np.float32)
    return Reading(
        Frame(np.zeros((4, 6, 3), np.uint8)),
        Rectified(flat, 0.5),
        HeightMap(flat, np.zeros((4, 6), np.uint8), 0.5),
        Rectified(flat, 0.5),
    )


def test_all_six_axes_their_errors_and_the_tractions_are_scaled_together() -> None:
    six = np.array([0.5, -0.3, -4.0, 0.01, 0.02, -0.003])
    found = ScaledForceEstimator(Constant(six), ForceScale(1.5, error=0.04)).estimate(reading())
    assert found.wrench.six == pytest.approx(1.5 * six)
    assert found.std == pytest.approx(np.hypot(0.15, 0.04 * 1.5 * np.abs(six)))
    assert found.traction is not None and found.traction.pressure_mpa == pytest.approx(0.15)


@pytest.mark.parametrize("load_n", [1.2, 4.0, 40.0])
def test_the_errors_of_a_power_law_are_those_of_its_derivative(load_n: float) -> None:
    scale = ForceScale(1.2, curve=0.3, about_n=3.0)
    six = np.array([0.5, -0.3, -load_n, 0.01, 0.02, -0.003])

    def scaled(at: np.ndarray) -> WrenchEstimate:
        return scale(WrenchEstimate(Wrench(at[:3], at[3:]), covariance, touching=True))

    root = np.random.default_rng(3).normal(size=(6, 6)) * np.array([0.1, 0.1, 0.2, 1e-3, 1e-3, 1e-3])
    covariance = root.T @ root
    steps = 1e-5 * np.eye(6)
    jacobian = np.array([scaled(six + step).wrench.six - scaled(six - step).wrench.six for step in steps]).T / 2e-5
    assert scaled(six).covariance == pytest.approx(jacobian @ covariance @ jacobian.T, rel=1e-5, abs=1e-12)


def test_zero_stays_zero() -> None:
    found = ScaledForceEstimator(Constant(), ForceScale(1.5, curve=0.2, about_n=3)).estimate(reading())
    assert not found.wrench.six.any() and not found.touching


def test_the_file_keeps_one_table_for_each_estimator(tmp_path: Path) -> None:
    one, other = fit_force_scale(presses(1.2)).adaptation, ForceScale(0.9, presses=2)
    write_force_scale(tmp_path, Constant(name="physics"), one)
    write_force_scale(tmp_path, Constant(name="network"), other)
    assert read_force_scales(tmp_path).scales == {"physics": one, "network": other}
    assert apply_sensor_force_scale(Constant(), tmp_path).adaptation == UNCALIBRATED


def test_an_edited_file_is_used_with_a_notice(tmp_path: Path) -> None:
    path = write_force_scale(tmp_path, Constant(), ForceScale(1.25, presses=5))
    assert apply_sensor_force_scale(Constant(), tmp_path).notices == ()
    path.write_text(path.read_text().replace("1.25", "1.35"))
    edited = apply_sensor_force_scale(Constant(), tmp_path)
    assert edited.adaptation.factor == 1.35 and "force.toml was edited" in " ".join(edited.notices)
    path.write_text("\n".join(line for line in path.read_text().splitlines() if not line.startswith("checksum")))
    assert apply_sensor_force_scale(Constant(), tmp_path).notices == edited.notices
    write_force_scale(tmp_path, Constant(name="another"), ForceScale(1.1, presses=5))
    assert apply_sensor_force_scale(Constant(), tmp_path).notices == edited.notices, "adapt does not vouch for an edit"


def test_a_scale_is_not_used_for_another_model_of_the_same_name(tmp_path: Path) -> None:
    trained, trained_again = Constant(model_sha256="a" * 64), Constant(model_sha256="b" * 64)
    write_force_scale(tmp_path, trained, ForceScale(1.25, presses=5))
    assert apply_sensor_force_scale(trained, tmp_path).adaptation.factor == 1.25
    other = apply_sensor_force_scale(trained_again, tmp_path)
    assert other.adaptation == UNCALIBRATED and "belongs to another model named 'constant'" in " ".join(other.notices)
    write_force_scale(tmp_path, trained_again, ForceScale(1.5, presses=5))
    assert apply_sensor_force_scale(trained_again, tmp_path).adaptation.factor == 1.5


@pytest.mark.parametrize(
    "text", ["[physics]\nfactor = 'two'", "[physics]\nerror = nan", "[physics\n", "physics = 3", "\x00"]
)
def test_a_damaged_file_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / FORCE_SCALE_FILE).write_text(text)
    with pytest.raises(FileFormatError, match="'ninedtact adapt' again"):
        read_force_scales(tmp_path)


@pytest.mark.parametrize(
    ("estimated_n", "weighed_n", "said"),
    [(0.0, 1.0, "image shows"), (2.0, 0.0, "above zero"), (2.0, 200.0, "grams"), (2.0, np.nan, "above zero")],
)
def test_a_press_that_cannot_be_is_refused(estimated_n: float, weighed_n: float, said: str) -> None:
    with pytest.raises(ForceScaleImpossible, match=said):
        KnownLoadPress(estimated_n, weighed_n)
    with pytest.raises(ForceScaleImpossible, match="at least 2"):
        fit_force_scale([KnownLoadPress(1.0, 1.0)])


def test_presses_that_contradict_each_other_are_refused() -> None:
    presses = [KnownLoadPress(1.0, 0.5), KnownLoadPress(2.0, 6.0), KnownLoadPress(4.0, 1.5), KnownLoadPress(3.0, 9.0)]
    with pytest.raises(ForceScaleImpossible, match="agree on one force scale"):
        fit_force_scale(presses)


def test_a_scale_that_could_not_be_read_again_is_refused() -> None:
    """The power 4.5 of the load fits these presses, and the bounds of force.toml would refuse it."""
    estimated_and_weighed_n = ((1.0, 0.21), (1.01, 0.215), (2.02, 9.9), (2.05, 10.0))
    with pytest.raises(ForceScaleImpossible, match=r"got the power 4\.5; check that each image belongs to its weight"):
        fit_force_scale([KnownLoadPress(*press) for press in estimated_and_weighed_n])

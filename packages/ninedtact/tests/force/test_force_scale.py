"""Known loads: the gel that explains them is found within its error, contradictions are named, and zero stays zero."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ninedtact.calibration.gel_fit_to_known_loads import (
    AssumedBases,
    ForceScaleImpossible,
    KnownLoadPress,
    fit_known_loads,
)
from ninedtact.errors import FileFormatError
from ninedtact.force.estimator_and_scale import (
    FORCE_SCALE_FILE,
    UNCALIBRATED,
    ForceEstimator,
    ForceScale,
    ScaledForceEstimator,
    apply_sensor_force_scale,
    force_error_of_base,
    force_scale_of_ball,
    read_force_scales,
    write_force_scale,
)
from ninedtact.quantities import Frame, HeightMap, Rectified, Traction, Wrench, WrenchEstimate
from ninedtact.reading import Reading

NOTHING = np.zeros(6)
BASES = AssumedBases((0.001, 0.05, 0.13), 0.05, 0.04)
LIGHT, DEEP = 4.0, 9.0
"""How much faster the load of a light and of a deep press falls with the ratio of the moduli, per unit of it."""


def press(number: int, factor: float, ratio: float, error: float = 0.0, std: float = 0.07) -> KnownLoadPress:
    """A press whose true load is that of a gel of this modulus on this base, estimated with an error on the assumed ones."""
    load_n = (0.5, 2.0, 5.0, 9.0)[number % 4]
    slope = np.interp(load_n, (0.5, 9.0), (LIGHT, DEEP))
    estimated = load_n / factor * np.exp(-slope * (np.array(BASES.ratios) - ratio) + error)
    return KnownLoadPress(f"press {number}", load_n, tuple(estimated.tolist()), std, calibrated=1)


@pytest.mark.parametrize("presses", [1, 4])
def test_modulus_and_base_are_found_within_their_errors(presses: int) -> None:
    """For gels drawn from what the fit assumes of them, so that the stated errors must be those that occur."""
    rng, off, off_load = np.random.default_rng(3), [], []
    for _ in range(200):
        factor, ratio = np.exp(0.25 * rng.standard_normal()), np.clip(0.05 + 0.04 * rng.standard_normal(), 0.001, 0.13)
        known = [press(number, factor, ratio, 0.07 * rng.standard_normal()) for number in range(1, 1 + presses)]
        found, true = fit_known_loads(known, BASES), press(1, factor, ratio)
        off.append([np.log(found.factor / factor) / found.modulus_std, (found.ratio - ratio) / found.ratio_std])
        estimate = fit_known_loads([*known, replace(true, relative_std=1e3)], BASES).estimated_n[-1]
        off_load.append(np.log(estimate / true.weighed_n) / found.error)
    for each in (*np.array(off).T, np.array(off_load)):
        assert 0.55 < (np.abs(each) < 1).mean() < 0.9 and (np.abs(each) < 2).mean() > 0.9
    assert found.error < (0.09 if presses == 1 else 0.05) and found.ratio_std < 0.04


def test_without_a_base_to_search_the_loads_give_a_factor() -> None:
    known = [KnownLoadPress(f"press {n}", 1.2 * n, (n,), 0.05) for n in (1.0, 3.0, 8.0)]
    found = fit_known_loads(known)
    assert found.factor == pytest.approx(1.2, rel=0.01) and found.ratio_std == 0 and found.error < 0.04
    assert found.unadapted == pytest.approx(np.log(1.2)) and found.left_out is not None and found.left_out < 0.02


def test_a_load_that_contradicts_the_others_is_named() -> None:
    known = [press(number, 1.1, 0.06) for number in range(4)]
    wrong = [*known[:2], replace(known[2], name="hook.png", weighed_n=2 * known[2].weighed_n), known[3]]
    with pytest.raises(
        ForceScaleImpossible, match=r"got hook\.png with 10\.00 N, [4-9]\.\d standard deviations above what the"
    ):
        fit_known_loads(wrong, BASES)
    assert fit_known_loads([replace(one, relative_std=0.5) for one in wrong], BASES).factor > 0
    with pytest.raises(ForceScaleImpossible, match=r"hook\.png with a weight near the estimated"):
        fit_known_loads([*known, replace(known[0], name="hook.png", weighed_n=300.0)], BASES)


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


def test_what_the_ball_leaves_open_of_the_base_adds_to_the_error_of_the_modulus() -> None:
    known, open_, wide = (force_scale_of_ball(std).error for std in (0.0, 0.05, 1.0))
    assert known == pytest.approx(0.25) and known < open_ < wide == 1.0
    assert open_**2 - known**2 == pytest.approx(force_error_of_base(0.05) ** 2)
    scaled = ScaledForceEstimator(Constant(), force_scale_of_ball(0.05))
    assert f"all forces ±{open_:.0%}" in scaled.notices[0]


def test_zero_stays_zero() -> None:
    found = ScaledForceEstimator(Constant(), ForceScale(1.5)).estimate(reading())
    assert not found.wrench.six.any() and not found.touching


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
    [(0.0, 1.0, "to show a press"), (2.0, 0.0, "above zero"), (2.0, np.nan, "above zero")],
)
def test_a_press_that_cannot_be_is_refused(estimated_n: float, weighed_n: float, said: str) -> None:
    with pytest.raises(ForceScaleImpossible, match=said):
        KnownLoadPress("a.png", weighed_n, (estimated_n,), 0.1)
    with pytest.raises(ForceScaleImpossible, match="at least one press"):
        fit_known_loads([])

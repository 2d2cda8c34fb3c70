"""What the figures mean, by laws that hold for every set of predictions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ninedtact.errors import FileFormatError
from ninedtact.quantities import Wrench
from ninedtact_train.evaluation import ErrorDistribution, WrenchPredictions, evaluate_predictions

SCALE = np.array([1, 1, 4, 0.03, 0.03, 0.004])


def wrenches(pairs: int = 500, seed: int = 0) -> np.ndarray:
    """Presses of 0.5 to 11.5 N."""
    draw = np.random.default_rng(seed)
    six = SCALE * draw.normal(size=(pairs, 6))
    six[:, 2] = -draw.uniform(0.5, 11.5, pairs)
    return six


def test_a_perfect_answer_and_the_median_are_the_ends_of_the_scale() -> None:
    truth = wrenches()
    perfect = evaluate_predictions(WrenchPredictions(truth, truth.copy())).scores
    assert not perfect.mae.any() and not perfect.bias.any()
    for figure in (perfect.skill, perfect.r2, perfect.slope, perfect.slope_with_offset):
        assert figure == pytest.approx(1)
    median = evaluate_predictions(
        WrenchPredictions(truth, np.broadcast_to(np.median(truth, axis=0), truth.shape).copy())
    ).scores
    assert median.skill == pytest.approx(0) and median.mae == pytest.approx(median.median_mae)
    assert median.slope_with_offset == pytest.approx(0, abs=1e-9)


@given(st.floats(0.1, 3), st.lists(st.floats(-2, 2), min_size=6, max_size=6))
def test_slope_is_of_the_prediction_on_the_truth_and_bias_is_predicted_minus_true(slope: float, shift: list) -> None:
    truth = wrenches(50)
    scaled = evaluate_predictions(WrenchPredictions(truth, slope * truth)).scores
    assert scaled.slope == pytest.approx(slope) and scaled.slope_with_offset == pytest.approx(slope)
    moved = evaluate_predictions(WrenchPredictions(truth, truth + shift)).scores
    assert moved.bias == pytest.approx(shift, abs=1e-9) and moved.slope_with_offset == pytest.approx(1)
    assert moved.mae == pytest.approx(np.abs(shift)) and moved.std == pytest.approx(0, abs=1e-9)


def test_the_figures_are_those_of_their_formulas() -> None:
    truth = np.zeros((4, 6))
    predicted = np.zeros((4, 6))
    truth[:, 2], predicted[:, 2] = [-1, -2, -3, -6], [-2, -2, -2, -5]
    found = evaluate_predictions(WrenchPredictions(truth, predicted)).scores
    for figure, expected in {
        "mae": 0.75,
        "std": np.sqrt(3) / 4,
        "rmse": np.sqrt(0.75),
        "bias": 0.25,
        "median_mae": 1.5,
        "skill": 0.5,
        "r2": 1 - 3 / 14,
        "slope": 42 / 50,
        "slope_with_offset": 9 / 14,
    }.items():
        assert getattr(found, figure)[2] == pytest.approx(expected), figure
    assert np.isnan(found.skill[0]) and np.isnan(found.r2[0]) and np.isnan(found.slope[0]) and found.mae[0] == 0


@pytest.mark.parametrize("distribution", ErrorDistribution)
def test_honest_errors_cover_what_they_say_and_small_ones_less(distribution: ErrorDistribution) -> None:
    truth, draw = wrenches(20_000), np.random.default_rng(1)
    std = SCALE * draw.uniform(0.1, 0.5, truth.shape)
    shaped = {ErrorDistribution.GAUSSIAN: draw.normal, ErrorDistribution.LAPLACE: draw.laplace}[distribution](
        size=truth.shape
    )
    off = std * shaped / (1 if distribution is ErrorDistribution.GAUSSIAN else np.sqrt(2))
    found = evaluate_predictions(WrenchPredictions(truth, truth + off, std, distribution)).coverage
    assert found[0.5] == pytest.approx(0.5, abs=0.015) and found[0.9] == pytest.approx(0.9, abs=0.01)
    halved = evaluate_predictions(WrenchPredictions(truth, truth + off, std / 2, distribution)).coverage
    assert all((covered < share - 0.1).all() for share, covered in halved.items())
    other = next(one for one in ErrorDistribution if one is not distribution)
    wrong = evaluate_predictions(WrenchPredictions(truth, truth + off, std, other)).coverage
    assert abs(wrong[0.5] - 0.5).min() > 0.05


def test_parts_make_up_the_whole_and_an_untouched_skin_is_apart() -> None:
    truth, draw = wrenches(300), np.random.default_rng(2)
    truth[:30] = 0
    predicted = truth + 0.1 * SCALE * draw.normal(size=truth.shape)
    predicted[:29, :3] = 0
    predicted[29, :3] = (0.3, 0, -0.4)
    names = [*["none"] * 30, *draw.choice(["ball", "gear"], 270).tolist()]
    found = evaluate_predictions(
        WrenchPredictions(truth, predicted, objects=names, sensors=draw.choice([*"abc"], 300).tolist())
    )
    for parts, pairs in ((found.by_load, 270), (found.by_object, 270), (found.by_sensor, 300)):
        assert sum(part.pairs for part in parts) == pairs
    weighted = sum(part.pairs * part.mae for part in found.by_sensor) / 300
    assert weighted == pytest.approx(found.scores.mae)
    assert [part.name for part in found.by_object] == ["ball", "gear"] and found.by_load[0].name == "below 1 N"
    light = (np.abs(truth[:, 2]) < 1) & truth.any(1)
    assert found.by_load[0].bias == pytest.approx((predicted - truth)[light].mean(0))
    assert found.no_contact is not None
    assert (found.no_contact.pairs, found.no_contact.largest_force_n) == (30, pytest.approx(0.5))
    assert found.no_contact.mean_force_n == pytest.approx(0.5 / 30)


def test_pairs_without_contact_are_known_by_their_object_where_a_sensor_measured_noise() -> None:
    truth = wrenches(300)
    truth[:30] = 0
    predicted, names = 1.1 * truth, [*["none"] * 30, *["ball"] * 270]
    exact = evaluate_predictions(WrenchPredictions(truth, predicted, 0.1 * np.abs(truth) + 1e-3, objects=names))
    noisy = truth.copy()
    noisy[:30] = 0.01 * np.random.default_rng(1).normal(size=(30, 6))
    found = evaluate_predictions(WrenchPredictions(noisy, predicted, 0.1 * np.abs(truth) + 1e-3, objects=names))
    assert found.no_contact == exact.no_contact and found.no_contact is not None and found.no_contact.pairs == 30
    assert [(part.name, part.pairs) for part in found.by_load] == [(part.name, part.pairs) for part in exact.by_load]
    np.testing.assert_array_equal([*found.coverage.values()], [*exact.coverage.values()])


def test_torques_move_as_a_wrench_does_and_mixed_errors_are_claimed_no_longer() -> None:
    truth, predicted = wrenches(20), wrenches(20, seed=1)
    given_about = WrenchPredictions(truth, predicted, np.ones((20, 6)), about_mm=(0.0, 0.0, -35.0))
    moved = given_about.about((0.0, 0.0, 0.0))
    for six, there in ((truth, moved.truth), (predicted, moved.predicted)):
        for before, after in zip(six, there, strict=True):
            wrench = Wrench(before[:3], before[3:], np.array([0.0, 0, -35]))
            assert after == pytest.approx(wrench.about(np.zeros(3)).six)
    covered = evaluate_predictions(moved).coverage[0.5]
    assert np.isnan(covered).tolist() == [False] * 3 + [True, True, False]
    there, before = (evaluate_predictions(one) for one in (given_about.about((0.0, 0.0, -35.0)), given_about))
    np.testing.assert_allclose(there.coverage[0.5], before.coverage[0.5])
    with pytest.raises(FileFormatError, match=r"name it .--predictions-about-mm"):
        replace(given_about, about_mm=None).about((0.0, 0.0, 0.0))
    with pytest.raises(FileFormatError, match=r"finite numbers, got .*nan"):
        given_about.about((0.0, float("nan"), 0.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"truth": wrenches(1), "predicted": wrenches(1)}, "at least 2 pairs to evaluate, got 1"),
        (
            {"predicted": np.where(np.eye(10, 6) > 0, np.nan, 0.0)},
            "finite numbers, got nan as predicted Fx of pair 1 .6 such",
        ),
        ({"truth": np.full((10, 6), np.inf)}, "finite numbers, got inf as truth Fx of pair 1 .10 such"),
        ({"std": np.full((10, 6), -1.0)}, r"no standard deviation below zero, got -1\.0 as std Fx of pair 1"),
        ({"objects": ["ball"] * 9}, "objects of 10 pairs, got 9"),
    ],
)
def test_what_cannot_be_judged_is_refused(change: dict, words: str) -> None:
    whole = {"truth": wrenches(10), "predicted": wrenches(10), "std": None, "objects": None}
    with pytest.raises(FileFormatError, match=words):
        WrenchPredictions(**{**whole, **change})

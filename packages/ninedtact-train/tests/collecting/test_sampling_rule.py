"""The paper's rule for what is worth collecting."""

import numpy as np
import pytest

from ninedtact.errors import InputError
from ninedtact.quantities import Wrench
from ninedtact_train.collecting.training_pair_rule import SamplingRule, SamplingRuleSettings


def wrench(fx: float = 0, fy: float = 0, fz: float = 0, tx: float = 0, ty: float = 0, tz: float = 0) -> Wrench:
    return Wrench(np.array([fx, fy, fz], float), np.array([tx, ty, tz], float))


def at_once() -> SamplingRule:
    """A rule that keeps the first wrench of every contact."""
    return SamplingRule(SamplingRuleSettings(first_below_n=(-0.3, -0.3)), np.random.default_rng(0))


def test_nothing_is_kept_without_contact() -> None:
    rule = at_once()
    assert not rule.keeps(wrench(fz=-0.2))
    assert not rule.keeps(wrench(fx=3, fz=-0.3))
    assert rule.contact_count == 0 and not rule.touching
    assert rule.keeps(wrench(fz=-0.301))
    assert rule.contact_count == 1 and rule.touching
    later = SamplingRule(SamplingRuleSettings(first_below_n=(-1.0, -1.0)))
    assert [later.keeps(wrench(fz=load)) for load in (-1.0, -1.001)] == [False, True]


@pytest.mark.parametrize(
    ("axis", "far"), [("fx", 1.5), ("fy", 1.5), ("fz", 3.0), ("tz", 0.025)], ids=["fx", "fy", "fz", "tz"]
)
def test_a_quarter_of_the_range_on_one_axis_is_enough(axis: str, far: float) -> None:
    """Σ s|Δ| > 12 with s = 12/(range/4), and ranges of 6, 6 and 12 N and 0.1 N·m."""
    start = {"fx": 0.0, "fy": 0.0, "fz": -5.0, "tz": 0.0}
    for part, kept in ((1.0, False), (1.001, True)):
        rule = at_once()
        assert rule.keeps(wrench(**start))
        assert rule.keeps(wrench(**{**start, axis: start[axis] - part * far})) is kept


def test_differences_add_up_and_tilting_torques_do_not_count() -> None:
    rule = at_once()
    assert rule.keeps(wrench(fz=-5))
    assert not rule.keeps(wrench(fz=-5, tx=0.3, ty=-0.3))
    assert rule.keeps(wrench(fx=0.8, fz=-6.5))


def test_one_must_differ_from_all_that_were_kept_in_this_contact() -> None:
    rule = at_once()
    assert rule.keeps(wrench(fz=-2))
    assert rule.keeps(wrench(fz=-6))
    assert not rule.keeps(wrench(fz=-2.5))
    assert not rule.keeps(wrench(fz=0))
    assert rule.keeps(wrench(fz=-2.5))
    assert rule.contact_count == 2


@pytest.mark.parametrize(
    "wrong",
    [
        {"contact_below_n": 0.3},
        {"contact_below_n": 0.0},
        {"first_below_n": (-0.3, -3.3)},
        {"min_difference": 0.0},
        {"ranges": (6, 6, 12, 0, 1, 1)},
        {"ranges": (6, np.nan, 12, 1, 1, 1)},
        {"weights": (1, 1, np.nan, 0, 0, 1)},
        {"first_below_n": (-np.inf, -0.3)},
        {"min_difference": np.inf},
        {"first_below_n": (-1.0, 0.0)},
        {"weights": (0,) * 6},
        {"weights": (1, 1, 1, 1, 1, -1)},
    ],
    ids=str,
)
def test_rules_that_make_no_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match="expected"):
        SamplingRuleSettings(**wrong)

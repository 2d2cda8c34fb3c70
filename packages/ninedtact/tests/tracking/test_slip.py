"""Slip from displacement and loads: the law of Mindlin is read back, and noise alone slides nothing."""

import numpy as np
import pytest

from ninedtact.errors import InputError
from ninedtact.tracking import SlipEstimate, SlipEstimator, SlipSample, SlipState

FRICTION, LOAD_N, STIFFNESS_N_PER_MM, RATE_HZ = 0.5, 2.0, 1.6, 60.0
SLIDES_AT_MM = 1.5 * FRICTION * LOAD_N / STIFFNESS_N_PER_MM
"""Displacement at which the whole ball slides (Mindlin)."""


def tangential_load_n(drag_mm: np.ndarray) -> np.ndarray:
    """The load of a ball that is dragged from rest (Mindlin 1949)."""
    return FRICTION * LOAD_N * (1 - np.maximum(1 - drag_mm / SLIDES_AT_MM, 0) ** 1.5)


def sticking_share(drag_mm: np.ndarray) -> np.ndarray:
    return np.maximum(1 - drag_mm / SLIDES_AT_MM, 0)


def follow(
    estimator: SlipEstimator,
    drag_mm: np.ndarray,
    load_n: np.ndarray,
    normal_n: np.ndarray | float = LOAD_N,
    start_s: float = 0.0,
    noise: float = 1.0,
    scale: tuple[float, float] = (1.0, 1.0),
) -> list[SlipEstimate]:
    """Estimates along a direction of 30°, with noise of 0.01 mm and 0.01 N; scale: units of length and load."""
    rng, along = np.random.default_rng(0), np.array([np.cos(0.5), np.sin(0.5)])
    length, force = scale
    found = []
    for step, (moved, load, normal) in enumerate(
        zip(drag_mm, load_n, np.broadcast_to(normal_n, len(drag_mm)), strict=True)
    ):
        place_mm = moved * along + noise * 0.01 * rng.standard_normal(2)
        tangential_n = load * along + noise * 0.01 * rng.standard_normal(2)
        normal = normal + noise * 0.01 * rng.standard_normal()
        time_s = start_s + step / RATE_HZ
        found.append(
            estimator.update(
                SlipSample(time_s, length * place_mm, force * tangential_n, force * normal, length * 0.01, force * 0.01)
            )
        )
    return found


DRAG_MM = np.concatenate([np.zeros(20), np.arange(1, 61) * 0.05, np.full(20, 3.0)])


@pytest.mark.parametrize("scale", [(1.0, 1.0), (13.0, 1.0), (1.0, 250.0)])
def test_a_dragged_ball_sticks_then_slips_at_its_rim_then_slides_in_any_units(scale: tuple[float, float]) -> None:
    found = follow(SlipEstimator(), DRAG_MM, tangential_load_n(DRAG_MM), scale=scale)
    share, states = sticking_share(DRAG_MM), [one.state for one in found]
    slides_from = int(np.argmax(share <= 0))
    assert states[:22] == [SlipState.STATIC] * 22
    assert states[(21 + slides_from) // 2 + 2] == SlipState.INCIPIENT
    assert abs(states.index(SlipState.GROSS) - slides_from) <= 2
    assert states[slides_from + 2 : 80].count(SlipState.GROSS) >= 0.9 * (78 - slides_from)
    assert set(states[88:]) == {SlipState.INCIPIENT}, "it is held at the limit of friction"
    sliding = found[70]
    assert sliding.friction == pytest.approx(FRICTION, rel=0.03) and sliding.friction_std < 0.15 * FRICTION
    assert sliding.speed == pytest.approx(scale[0] * 0.05 * RATE_HZ, rel=0.2)
    assert sliding.direction @ [np.cos(0.5), np.sin(0.5)] > 0.95
    assert sliding.onset_s == pytest.approx(slides_from / RATE_HZ, abs=2.5 / RATE_HZ)
    assert np.isnan(found[20].friction) and np.isnan(found[20].onset_s)


def test_noise_alone_slides_nothing_in_a_minute_and_neither_does_creep() -> None:
    seconds = np.arange(0, 60, 1 / RATE_HZ)
    held_mm, held_n = 0.3 * np.minimum(seconds, 1), 0.45 * np.minimum(seconds, 1)
    creep = 1 - 0.1 * (1 - np.exp(-seconds / 60))
    found = follow(SlipEstimator(), held_mm, held_n * creep, LOAD_N * creep)
    assert not [one for one in found if one.state == SlipState.GROSS]


def test_an_object_that_rolls_under_next_to_no_load_does_not_slide() -> None:
    rolled_mm = np.concatenate([np.zeros(20), 0.04 * np.arange(30), 1.2 - 0.04 * np.arange(60)])
    found = follow(SlipEstimator(least_friction=0.1), rolled_mm, 0.01 * LOAD_N * rolled_mm)
    assert {one.state for one in found} == {SlipState.STATIC}


def test_what_is_known_of_friction_stays_when_the_object_is_lifted_and_time_must_pass() -> None:
    estimator = SlipEstimator()
    before = follow(estimator, DRAG_MM, tangential_load_n(DRAG_MM))[-1]
    lifted = estimator.release()
    assert lifted.state == SlipState.UNKNOWN and lifted.friction == before.friction
    assert np.isnan([lifted.p_gross, lifted.sticking_share, lifted.speed]).all()
    again = follow(estimator, DRAG_MM[:30], tangential_load_n(DRAG_MM[:30]), start_s=10.0)
    assert again[0].state == SlipState.STATIC
    # Known friction tells the share that sticks before anything slides.
    assert again[-1].sticking_share == pytest.approx(sticking_share(DRAG_MM)[29], abs=0.15)
    with pytest.raises(InputError, match="later than the last one"):
        estimator.update(SlipSample(10.0, np.zeros(2), np.zeros(2), 1.0, 0.01, 0.01))


@pytest.mark.parametrize("number", range(5))
def test_a_number_that_is_missing_gives_an_unknown_slip_and_a_gap_in_time_no_false_one(number: int) -> None:
    estimator = SlipEstimator()
    found = follow(estimator, DRAG_MM[:30], tangential_load_n(DRAG_MM[:30]))
    values = [np.array([0.5, 0.0]), np.array([0.5, 0.0]), LOAD_N, 0.01, 0.01]
    values[number] = values[number] * np.nan
    assert estimator.update(SlipSample(0.5, *values)).state == SlipState.UNKNOWN
    later = follow(estimator, DRAG_MM[29:30], tangential_load_n(DRAG_MM[29:30]), start_s=30.0)
    assert later[0].state == found[-1].state

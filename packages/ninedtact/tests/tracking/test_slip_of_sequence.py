"""Slip in a sequence as a whole: the law of a spring with a slider, in any unit of load, under noise that nobody states."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.tracking import SlipSample, SlipState, slip_of_sequence

FRICTION, STIFFNESS, NORMAL = 0.5, 1.5, 2.0
STEP, HELD, IMAGES = 0.03, 20, 90
SLIDES_FROM = HELD + round(FRICTION * NORMAL / STIFFNESS / STEP)


def dragged(noise: float, seed: int = 0) -> list[SlipSample]:
    """Samples of a contact that rests, then is dragged at one speed until the load is that of friction."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([np.zeros(HELD), STEP * np.arange(1, IMAGES - HELD + 1)])
    load = np.minimum(STIFFNESS * x, FRICTION * NORMAL)
    wrong = noise * rng.standard_normal((IMAGES, 5)) * [1, 1, 1, 1, 1]
    return [
        SlipSample(number / 30, np.array([at, 0.0]) + off[:2], np.array([push, 0.0]) + off[2:4], NORMAL + off[4])
        for number, (at, push, off) in enumerate(zip(x, load, wrong, strict=True))
    ]


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_a_dragged_contact_sticks_and_then_slides(noise: float) -> None:
    states = [one.state for one in slip_of_sequence(dragged(noise))]
    assert set(states[: HELD - 4]) == {SlipState.STATIC}
    # An image or two on each side may be smoothed into each other.
    assert np.mean([state == SlipState.GROSS for state in states[SLIDES_FROM + 6 :]]) > 0.95
    assert SlipState.GROSS not in states[: SLIDES_FROM - 6]


def test_the_unit_of_load_does_not_matter() -> None:
    samples = dragged(0.01)
    scaled = [replace(one, tangential=7.3 * one.tangential, normal=7.3 * one.normal) for one in samples]
    assert [one.state for one in slip_of_sequence(scaled)] == [one.state for one in slip_of_sequence(samples)]


def test_images_without_contact_and_images_that_say_nothing_are_unknown_and_only_the_former_end_a_contact() -> None:
    samples, nothing = dragged(0.0), np.full(2, np.nan)
    lost = SlipSample(0.0, nothing, nothing, float("nan"))
    samples[70] = replace(lost, time_s=samples[70].time_s)
    samples[85:] = [replace(lost, time_s=one.time_s, normal=0.0) for one in samples[85:]]
    found = slip_of_sequence(samples)
    assert [number for number, one in enumerate(found) if one.state == SlipState.UNKNOWN] == [70, *range(85, IMAGES)]
    assert found[71].state == SlipState.GROSS
    assert [one.state for one in slip_of_sequence([lost])] == [SlipState.UNKNOWN] and slip_of_sequence([]) == []


def test_what_slides_later_tells_how_little_a_slippery_ball_stuck_before() -> None:
    """By Mindlin's law 0.4 of the contact sticks at three quarters of the load at which it slides."""
    friction, rng = 0.15, np.random.default_rng(0)
    held = np.concatenate([np.zeros(15), np.linspace(0, 0.6, 10), np.full(25, 0.6)])
    x = np.concatenate([held, np.zeros(10), np.linspace(0, 2.5, 40)])
    load = friction * NORMAL * (1 - np.clip(1 - x, 0, 1) ** 1.5)
    off = 0.02 * rng.standard_normal((len(x), 4))
    samples = [
        SlipSample(number / 30, np.array([at, 0.0]) + wrong[:2], np.array([push, 0.0]) + wrong[2:], NORMAL)
        for number, (at, push, wrong) in enumerate(zip(x, load, off, strict=True))
    ]
    samples[50] = SlipSample(50 / 30, np.full(2, np.nan), np.full(2, np.nan), 0.0)
    unknown, known = (slip_of_sequence(some) for some in (samples[:50], samples))
    assert {one.state for one in unknown[30:45]} == {SlipState.STATIC}
    assert {one.state for one in known[30:45]} == {SlipState.INCIPIENT}
    assert known[-5].state == SlipState.GROSS

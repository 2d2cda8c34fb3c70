"""What a stream teaches: flicker with its period, and noise that a contact must exceed; a light contact teaches nothing."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.force.contact_detection import (
    ContactThreshold,
    correlated_noise_limit,
    detect_contact,
    find_faint_contact,
    measure_smooth_noise,
)
from ninedtact.quantities import Frame, HeightMap, HeightSource, Rectified
from ninedtact.reading import Reading, StreamMemory
from ninedtact.shape.light_change import LightChange
from ninedtact.stream_memory import StreamLearner, find_flicker

SKIN = np.full((345, 460), 150, np.float32)
DOWN, ACROSS = np.mgrid[:345, :460]


def reading_of(grey: np.ndarray, second: float = 0.0) -> Reading:
    flat = HeightMap(np.zeros_like(SKIN), np.full(SKIN.shape, HeightSource.MEASURED, np.uint8), 0.052, 0.005)
    frame = Frame(np.zeros((1, 1, 3), np.uint8), round(second * 1e9))
    return Reading(frame, Rectified(grey.astype(np.float32), 0.052), flat, Rectified(SKIN, 0.052))


@given(st.floats(0.003, 0.05), st.floats(0.6, 12.0), st.floats(0, 6))
@settings(max_examples=30, deadline=None)
def test_flicker_is_named_with_amplitude_and_period(amplitude: float, frequency_hz: float, phase: float) -> None:
    at_s = np.arange(0, 8, 1 / 30)
    level = 150 * (1 + 0.001 * at_s + amplitude * np.sin(2 * np.pi * frequency_hz * at_s + phase))
    found = find_flicker(np.stack([at_s * 1e9, level], axis=1))
    assert found is not None
    assert 1 / found.period_s == pytest.approx(frequency_hz, abs=0.04)
    assert found.amplitude == pytest.approx(amplitude, rel=0.15)


def test_noise_and_drift_are_no_flicker() -> None:
    at_s = np.arange(0, 8, 1 / 30)
    noise = np.random.default_rng(0).normal(0, 0.3, at_s.shape)
    assert find_flicker(np.stack([at_s * 1e9, 150 + noise + 2 * at_s], axis=1)) is None


def test_noise_is_learnt_anew_after_a_step_of_the_gain_and_kept_while_the_light_drifts() -> None:
    learner = StreamLearner(StreamMemory(noise=1e-3, learnt_s=60.0))
    for number in range(100):
        learner.learn_light(replace(reading_of(SKIN, number), light=LightChange(gain=1 + 0.001 * number)))
        assert learner.memory.learnt_s == 60
    stepped = replace(reading_of(SKIN, 100), light=LightChange(gain=1.15))
    assert not learner.memory.knows_light(1.15)
    learner.learn_light(stepped)
    assert learner.memory.learnt_s == 0 and learner.memory.knows_light(1.15)


def test_noise_over_the_view_is_learnt_and_a_light_contact_is_not() -> None:
    waves, *others = (SKIN * (1 + 0.004 * np.sin(DOWN / 15 + at) * np.sin(ACROSS / 15)) for at in range(12))
    dent = SKIN * (1 - 0.004 * np.exp(-((DOWN - 170) ** 2 + (ACROSS - 230) ** 2) / 800))
    assert measure_smooth_noise(reading_of(waves)) > 8e-4
    assert measure_smooth_noise(reading_of(dent)) < 2e-4
    learner = StreamLearner()
    for second in range(12):
        learner.learn_noise(reading_of(waves, second))
    assert learner.memory.learnt_s == 0, "a codec that repeats an image says nothing of the next one"
    for second, image in enumerate(others, 12):
        learner.learn_noise(reading_of(image, second))
    assert learner.memory.learnt_s == pytest.approx(11)
    threshold = ContactThreshold()
    learnt = replace(reading_of(SKIN), stream=learner.memory)
    memory = learner.memory
    assert 1.5 * memory.noise < memory.darkening < 4 * memory.noise
    assert correlated_noise_limit(learnt, threshold) == pytest.approx(threshold.learnt_darkenings * memory.darkening)


def test_a_faint_contact_is_found_at_the_third_image_where_every_image_has_new_noise() -> None:
    """The noise is that of blocks of motion JPEG, and five times as much of it where contacts cannot be told."""
    rng, learner = np.random.default_rng(3), StreamLearner()
    strength = np.where(ACROSS > 300, 0.01, 0.002)

    def blocks() -> np.ndarray:
        return np.kron(rng.normal(0, 1, (44, 58)), np.ones((8, 8)))[:345, :460] * strength

    def found(second: float, change: np.ndarray) -> tuple[bool, bool]:
        reading = replace(reading_of(SKIN * (1 + change), second), stream=learner.memory)
        faint, any_found = find_faint_contact(reading) is not None, detect_contact(reading)
        learner.remember(reading)
        if not any_found and second < 100:
            learner.learn_noise(reading)
        return faint, any_found

    assert not any(one for second in range(100) for one in found(second, blocks()))
    cells = learner.memory.cell_noise
    assert cells is not None and cells.is_known and cells.images > 90
    dent = -0.008 * np.exp(-((DOWN - 170) ** 2 + (ACROSS - 150) ** 2) / 600)
    assert [found(100 + at, blocks() + dent)[0] for at in range(5)] == [False, False, True, True, True]
    assert found(105, blocks()) == (False, False), "a contact that ended is not seen any longer"
    assert not any(found(106 + at, blocks() + np.roll(dent, 230, axis=1) / 2)[0] for at in range(5))


def test_noise_that_images_share_tells_nothing_of_the_next_group_of_pictures() -> None:
    rng, learner = np.random.default_rng(0), StreamLearner()
    for second in range(60):
        if second % 12 == 0:
            of_group = np.kron(rng.normal(0, 0.002, (44, 58)), np.ones((8, 8)))[:345, :460]
        reading = reading_of(SKIN * (1 + of_group + 1e-4 * rng.normal(0, 1, SKIN.shape)), second)
        learner.remember(reading)
        learner.learn_noise(reading)
    assert learner.memory.cell_noise is not None and learner.memory.cell_noise.images > 50
    assert not learner.memory.cell_noise.is_known

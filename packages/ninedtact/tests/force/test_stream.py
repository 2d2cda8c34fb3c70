"""The answer does not depend on the order of images: single images, and a stream that jumps between contacts."""

from functools import lru_cache

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from test_traction import GEL, dragged, noisy, reading

from ninedtact.force.traction.estimator import TractionForce
from ninedtact.force.traction.observation import HeightObservationModel
from ninedtact.quantities import WrenchEstimate

PLACES = ((1.0, -0.6, 0.5), (-3.0, 2.0, -0.7), (0.0, 0.0, 0.0), (1.6, -0.4, -0.6))
"""Contacts that overlap, and one that does not."""


@lru_cache
def image(number: int):
    return reading(noisy(seed=number, contact=dragged(*PLACES[number])))


@lru_cache
def alone(number: int) -> WrenchEstimate:
    return estimator().estimate(image(number))


def estimator() -> TractionForce:
    return TractionForce(HeightObservationModel(), GEL)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, len(PLACES) - 1), min_size=2, max_size=5))
def test_separate_images_have_the_same_wrench_in_any_order(order: list[int]) -> None:
    shared = estimator()
    for number in order:
        shared.forget()
        np.testing.assert_array_equal(shared.estimate(image(number)).wrench.six, alone(number).wrench.six)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, len(PLACES) - 1), min_size=2, max_size=5))
def test_a_stream_that_jumps_between_contacts_reads_each_as_if_it_were_alone(order: list[int]) -> None:
    stream = estimator()
    for number in order:
        found = stream.estimate(image(number))
        assert found.warnings == alone(number).warnings
        off = np.abs(found.wrench.six - alone(number).wrench.six) / alone(number).std
        assert off.max() < 1.0


def test_a_start_from_the_last_image_saves_iterations_where_the_contact_moves_slowly() -> None:
    stream = estimator()
    stream.estimate(image(0))
    stream.estimate(reading(noisy(seed=9, contact=dragged(*PLACES[0]))))
    assert stream.last is not None and stream.last.iterations == 1

"""A gel that relaxes: the Prony series at a held depth, its inverse under a held load, and nothing where no time passes."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.design import DesignImpossible, Gel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.relaxation import GelMemory
from ninedtact.simulation.hand_moved_object import HandTarget
from ninedtact.simulation.press_sequence import PressSequence
from ninedtact.simulation.simulated_sources import demo_press_sequence
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import LOAD_TOLERANCE, Twin, default_twin

BALL, HELD, TIMES_S = Ball(4.0), Pose(0.3, 0.2, 0.6), (1.0, 4.0, 15.0, 40.0)
TERMS = tuple(zip(Gel().relaxing_shares, Gel().relaxation_times_s, strict=True))


def left_at(seconds: float) -> float:
    return 1 - sum(share * (1 - np.exp(-seconds / time_s)) for share, time_s in TERMS)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return replace(default_twin(), pitch_mm=0.4, friction=0.4)


def test_the_load_of_a_held_object_falls_by_the_prony_series_and_its_image_stays(twin: Twin) -> None:
    pressed = twin.press(twin.press(None, BALL, HELD), BALL, replace(HELD, x_mm=0.5))
    held = pressed
    for seconds in TIMES_S:
        held = twin.press(held, BALL, held.pose, after_s=seconds)
    left = left_at(sum(TIMES_S))
    assert 0.9 < left < 0.97
    assert held.wrench.force_n == pytest.approx(left * pressed.wrench.force_n, rel=1e-3, abs=1e-6)
    assert held.slip_share == pytest.approx(pressed.slip_share or 0.0, abs=0.02)
    assert held.corrected.thickness_change_mm == pytest.approx(pressed.corrected.thickness_change_mm, abs=1e-4)
    at_once = twin.press(pressed, BALL, pressed.pose, after_s=sum(TIMES_S))
    assert at_once.wrench.force_n == pytest.approx(held.wrench.force_n, rel=1e-3, abs=1e-6)
    contacts = [pressed.corrected, held.corrected]
    batch = Contact.stack(contacts)
    for contact, change_mm, part in zip(contacts, batch.thickness_change_mm, batch.unstack(), strict=True):
        assert change_mm == pytest.approx(contact.thickness_change_mm, abs=1e-6)
        assert part.left == contact.left


def test_an_object_sinks_in_under_a_held_load_until_the_modulus_that_is_left_bears_it(twin: Twin) -> None:
    pressed = held = twin.press(twin.press(None, BALL, HELD), BALL, HELD, 3.0)
    for _ in range(20):
        held = twin.press(held, BALL, held.pose, 3.0, after_s=60.0)
        assert held.load_n == pytest.approx(3.0, rel=1.1 * LOAD_TOLERANCE)
    soft = twin.press(pressed, BALL, HELD, 3.0 / (1 - sum(share for share, _ in TERMS)))
    assert pressed.pose.depth_mm + 0.01 < held.pose.depth_mm
    assert held.pose.depth_mm == pytest.approx(soft.pose.depth_mm, rel=LOAD_TOLERANCE)
    for part, scripted_s in ((held, 1e5), (pressed, 0.0)):
        contact = ScriptedPress(load_n=3.0, at_mm=(0.3, 0.2), hold_s=scripted_s).simulate(twin, BALL)
        assert contact.pose.depth_mm == pytest.approx(part.pose.depth_mm, rel=0.01)


def test_nothing_relaxes_without_time_or_terms_and_what_is_lifted_is_forgotten(twin: Twin) -> None:
    elastic = replace(twin, gel=replace(twin.gel, relaxing_shares=(), relaxation_times_s=()))
    for one, after_s in ((twin, 0.0), (elastic, 60.0)):
        press = one.press(one.press(None, BALL, HELD), BALL, HELD, after_s=after_s)
        assert press.memory is None and press.corrected.left == 1
    held = twin.press(twin.press(None, BALL, HELD), BALL, HELD, after_s=60.0)
    lifted = twin.press(held, BALL, replace(HELD, depth_mm=-0.5), after_s=1.0)
    again = twin.press(lifted, BALL, HELD, after_s=1e-9)
    assert lifted.load_n == 0 and not lifted.touches and lifted.corrected.left == 1
    assert again.load_n == pytest.approx(twin.press(None, BALL, HELD).load_n, rel=1e-3)
    memory = GelMemory(twin.gel, (2.0, 1.0))
    elastic_n = memory.elastic_load_n(2.5, 7.0)
    assert memory.after(7.0, elastic_n).left_of(elastic_n) * elastic_n == pytest.approx(2.5)
    with pytest.raises(DesignImpossible, match="below 1 in all"):
        Gel(relaxing_shares=(0.6, 0.5))


def test_an_object_held_by_the_hand_of_a_demo_loses_load(twin: Twin) -> None:
    demo = PressSequence(twin, demo_press_sequence(), hz=0.5, real_time=False)
    demo.hand.take(BALL)
    demo.hand.aim(HandTarget(HELD))
    loads = [demo.press(step).load_n for step in range(12)]
    deepest = int(np.argmax(loads))
    assert loads[-1] / loads[deepest] == pytest.approx(left_at(24.0) / left_at(2.0 * deepest), rel=0.02)
    assert np.diff(loads[deepest:]).max() < 0

"""Which moments are saved, which are not: limits, counts, faults by their times."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.errors import InputError
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.topics_and_messages import PairLabel
from ninedtact_train.collecting.collection_tare import TareInProgress
from ninedtact_train.collecting.collector import WrenchHistory
from ninedtact_train.collecting.pair_selection import (
    CollectSettings,
    ImageWrenchCandidate,
    PairSelector,
    SavedPairCounts,
    ZeroDriftMonitor,
)
from ninedtact_train.collecting.training_pair_rule import SamplingRule, SamplingRuleSettings

S, MS = 1_000_000_000, 1_000_000
SETTINGS = CollectSettings()
RULE = SamplingRuleSettings()


def wrench(*six: float, at_ns: int = 0) -> Wrench:
    full = np.array([*six, *[0.0] * (6 - len(six))])
    return Wrench(full[:3], full[3:], stamp_ns=at_ns)


def moment(at_s: float, load_n: float = 0.0, change: float = 0.0) -> ImageWrenchCandidate:
    return ImageWrenchCandidate(Frame(np.zeros((1, 1, 3), np.uint8), int(at_s * S)), wrench(0, 0, -load_n), change)


def label(six: Wrench, contact: str = "a", kind: str = "rule") -> PairLabel:
    return PairLabel(0, 0, 0, "cup", contact, kind, six)


def test_pairs_are_counted_in_twelve_bins_of_each_range() -> None:
    counts = SavedPairCounts(RULE.ranges)
    np.testing.assert_allclose(counts.limits, [[-3, -3, -12, -0.2, -0.2, -0.05], [3, 3, 0, 0.2, 0.2, 0.05]])
    counts.add(label(wrench(-2.9, 0.01, -11.1, 0.199, -0.5, 0.0)))
    assert [int(np.flatnonzero(row)[0]) for row in counts.counts] == [0, 6, 0, 11, 0, 6]
    counts.add(label(wrench(9.0, -2.49, -0.5), "b", "no_contact"))
    assert [np.flatnonzero(row).tolist() for row in counts.counts[:3]] == [[0, 11], [1, 6], [0, 11]]
    assert counts.last_contact == "a" and counts.objects["cup"] == 2
    assert counts.undo("a") == 1 and counts.undo("a") == 0
    assert counts.counts.sum() == 6 and counts.kinds == {"no_contact": 1} and counts.last_contact is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"tolerance_ms": 0},
        {"reference_images": 0},
        {"contact_levels": 0},
        {"rest": (0.1, 0.1, 0.1, 0.1, 0.1, 0.0)},
    ],
    ids=str,
)
def test_settings_with_which_nothing_could_be_saved_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match="expected"):
        replace(SETTINGS, **wrong)


def test_a_load_without_visible_contact_for_two_seconds_is_a_drifted_zero() -> None:
    watch = ZeroDriftMonitor(SETTINGS)
    assert watch.check(moment(1, load_n=0.2, change=0.99)) and not watch.has_drifted
    assert not watch.check(moment(2, load_n=0.21)) and not watch.check(moment(4.0, load_n=0.21))
    assert not watch.has_drifted
    assert not watch.check(moment(4.01, load_n=0.21)) and watch.has_drifted
    assert (
        not watch.check(moment(5, load_n=0.21, change=1.0)) and watch.has_drifted
    )  # a contact says nothing of the zero
    assert not watch.check(moment(6, load_n=0.21)) and watch.load_since_ns == 6 * S
    assert watch.check(moment(7)) and not watch.has_drifted and watch.load_since_ns is None


def selector() -> PairSelector:
    rule = replace(RULE, first_below_n=(-0.3, -0.3))
    return PairSelector(SETTINGS, SamplingRule(rule, np.random.default_rng(0)))


def test_light_touches_and_untouched_skin_are_few_and_apart() -> None:
    choose, counts = selector(), SavedPairCounts(RULE.ranges)
    assert choose.select(moment(0.5), counts) is None  # too soon after the beginning
    assert choose.select(moment(1.0), counts) == "no_contact"
    assert choose.select(moment(2.1), counts) == "no_contact"  # while none is counted
    counts.add(label(wrench(), "-", "no_contact"))
    assert choose.select(moment(4), counts) is None  # one is 3 % of up to 33 pairs
    assert choose.select(moment(5, 0.1, 2.1), counts) == "light_touch" and choose.touching and choose.contact == 1
    assert choose.select(moment(5.1, 0.1, 2.1), counts) is None
    assert choose.select(moment(5.2, 0.1, 2.0), counts) is None  # hardly visible
    assert choose.select(moment(5.3, 0.1, 2.1), counts) == "light_touch"
    counts.add(label(wrench(), "1", "light_touch"))
    for _ in range(17):
        counts.add(label(wrench()))
    assert len(counts.pairs) == 19 and choose.select(moment(6, 0.1, 2.1), counts) is None
    counts.add(label(wrench()))
    assert choose.select(moment(7, 0.1, 2.1), counts) == "light_touch"  # fewer than 5 % of 21


def test_wrenches_are_interpolated_between_their_neighbours() -> None:
    history = WrenchHistory()
    assert history.newest_ns == 0 and history.interpolate(5, S) is None
    for at_ms in (10, 20, 40):
        history.add(wrench(at_ms / 10, 0, -1, 0, 0.1 * at_ms, at_ns=at_ms * MS))
    middle = history.interpolate(25 * MS, 15 * MS)
    assert middle is not None and middle.stamp_ns == 25 * MS
    np.testing.assert_allclose(middle.six, [2.5, 0, -1, 0, 2.5, 0])
    for at_ms, far_ms in ((20, 0), (22, 18), (35, 15), (40, 0)):
        assert history.interpolate(at_ms * MS, far_ms * MS) and history.interpolate(at_ms * MS, far_ms * MS - 1) is None
    exact = history.interpolate(20 * MS, 0)
    assert exact is not None and exact.force_n[0] == 2
    assert history.interpolate(9 * MS, S) is history.interpolate(41 * MS, S) is None
    history.add(wrench(at_ns=5_010 * MS))
    assert [one.stamp_ns // MS for one in history.samples] == [10, 20, 40, 5010]
    history.add(wrench(at_ns=5_011 * MS))
    assert len(history.samples) == 4 and history.newest_ns == 5_011 * MS


def grey_frame(level: int, number: int = 0) -> Frame:
    return Frame(np.full((48, 64, 3), level, np.uint8), number * MS, number)


def test_a_tare_has_ten_images_and_samples_over_its_whole_time() -> None:
    tare = TareInProgress(3, SETTINGS)
    for number in range(9):
        tare.add_frame(grey_frame(100, number))
    assert tare.advice == "no samples from the force/torque sensor yet"
    for at_ms in range(0, 1001, 10):
        tare.add_wrench(wrench(0.5, 0, 2.0, at_ns=at_ms * MS))
    assert tare.advice == "do not touch the gel" and tare.finish() is None and len(tare.wrenches) == 101
    tare.add_frame(grey_frame(100, 9))
    found = tare.finish()
    assert found is not None and found.number == 3 and [each.index for each in found.frames] == list(range(10))
    np.testing.assert_allclose(found.zero, [0.5, 0, 2.0, 0, 0, 0])
    np.testing.assert_allclose(found.remove_zero(wrench(0.5, 1.0, 0.0, at_ns=5)).six, [0, 1.0, -2.0, 0, 0, 0])
    tare.wrenches.pop()
    assert tare.finish() is None and len(tare.frames) == 10  # a sample too few: it waits
    tare.add_frame(grey_frame(103, 10))  # three levels brighter all over is the light, one corner is a contact
    tare.add_wrench(wrench(0.5, 0, 2.0, at_ns=1000 * MS))
    assert tare.finish() is not None and [each.index for each in tare.frames] == list(range(1, 11))
    corner = grey_frame(100, 11)
    corner.image[:8, :8] = 103
    tare.add_frame(corner)
    assert tare.finish() is None and "it moves" in tare.advice and not tare.frames and not tare.wrenches

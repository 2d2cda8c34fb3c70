"""Which moments are saved, which are not: limits, counts, faults by their times."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.errors import InputError
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.topics_and_messages import PairLabel
from ninedtact_train.collecting.collection_tare import ReferenceImageDifference, TareInProgress, TareResult
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


def test_ranges_without_pairs_are_named_from_border_to_border() -> None:
    counts = SavedPairCounts(RULE.ranges)
    assert counts.missing_ranges()[0] == "Fx -3 to 3 N" and counts.missing_ranges()[5] == "Tz -50 to 50 N·mm"
    for bin_number in (0, 1, 5, 11):
        counts.add(label(wrench(0, 0, -12 + bin_number + 0.5)))
    in_z = [text for text in counts.missing_ranges() if text.startswith("Fz")]
    assert in_z == ["Fz -10 to -7 N", "Fz -6 to -1 N"]
    for _ in range(96):
        counts.add(label(wrench(0, 0, -0.5)))
    counts.add(label(wrench(0, 0, -11.5)))  # two of 101 are hardly any, as is one
    assert [text for text in counts.missing_ranges() if text.startswith("Fz")] == ["Fz -12 to -1 N"]
    counts.add(label(wrench(0, 0, -11.5)))
    assert [text for text in counts.missing_ranges() if text.startswith("Fz")] == ["Fz -11 to -1 N"]


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


def test_a_visible_contact_lasts_until_the_image_shows_none() -> None:
    choose, counts = selector(), SavedPairCounts(RULE.ranges)
    numbers = []
    for at_s, change in enumerate((0.0, 1.9, 2.1, 1.1, 0.9, 1.1, 2.1)):
        choose.select(moment(at_s, 0.25, change), counts)
        numbers.append((choose.contact, choose.touching))
    assert numbers == [(0, False), (0, False), (1, True), (1, True), (2, False), (2, False), (3, True)]
    assert choose.select(moment(8, 1.0), counts) == "rule" and choose.touching and choose.contact == 3
    choose.begin_contact()
    assert choose.contact == 4 and choose.select(moment(9, 1.0), counts) == "rule"


def test_a_load_is_neither_untouched_skin_nor_a_light_touch() -> None:
    choose, counts = selector(), SavedPairCounts(RULE.ranges)
    assert choose.select(moment(3, 0.21), counts) is None
    assert choose.select(moment(4, 0.1, 1.0), counts) is None
    counts.add(label(wrench(0, 0, -1.0)))
    assert choose.select(moment(5, 1.0, 3.0), counts) == "rule"
    assert choose.select(moment(6, 1.01, 3.0), counts) is None  # pressed, and no news


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


def tare_of(image: np.ndarray, zero_n: float, last: TareResult | None = None) -> TareResult | str:
    """The result of a tare of ten such images with this reading, or the advice where it is none."""
    tare = TareInProgress(1, SETTINGS, last)
    for number in range(10):
        tare.add_frame(Frame(image, number))
    for at_ms in range(0, 1001, 10):
        tare.add_wrench(wrench(0, 0, zero_n, at_ns=at_ms * MS))
    return tare.finish() or tare.advice


def test_a_tare_is_refused_where_both_the_skin_and_the_zero_have_changed() -> None:
    untouched, pressed = grey_frame(100).image, grey_frame(100).image.copy()
    pressed[16:32, 24:40] = 90
    first = tare_of(untouched, 0.0)
    assert isinstance(first, TareResult)
    assert isinstance(tare_of(pressed, 0.19, first), TareResult)  # a stain, and a zero within what counts as at rest
    assert isinstance(tare_of(untouched, 0.5, first), TareResult)  # the sensor has warmed up
    assert tare_of(pressed, 0.21, first) == "do not touch the gel: something presses on it"


def test_an_image_differs_by_its_most_changed_block_and_not_by_its_light() -> None:
    reference = ReferenceImageDifference([grey_frame(99).image, grey_frame(101).image])
    assert reference.change_levels(grey_frame(120).image) == pytest.approx(0, abs=1e-4)
    changed = grey_frame(100).image.copy()
    changed[8:16, 16:24] -= 5
    changed[40:44, 0:8] += 8  # half a block
    assert reference.change_levels(changed) == pytest.approx(5, abs=1e-3)
    assert reference.change_levels(grey_frame(100).image[:40]) == float("inf")
